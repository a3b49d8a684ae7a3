"""``bench status|collect|report STUDY_DIR``: what one folder of results holds."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_summary
from calibench.bench.papers.additions import ADDITIONS
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import mixed_code
from calibench.bench.statistics.labels import problem_titles
from calibench.bench.store.runs import ResultStore
from calibench.core.counted import counted


def status(argv: list[str]) -> int:
    """Print how many runs are done and what is left."""
    store = _store(argv)
    planned = store.manifest()["planned"]
    finished, damaged = store.finished(), store.damaged()
    runs = store.runs()
    failed = int((runs["status"] != "ok").sum())
    print(f"{store.folder}: {len(finished)} done ({failed} failed), {len(set(planned) - finished)} left")
    if said := mixed_code(runs):
        print(said)
    left: dict[str, int] = {}
    for run_id, label in planned.items():
        if run_id not in finished:
            left[label] = left.get(label, 0) + 1
    for label, count in left.items():
        print(f"{count:4d} left  {label}")
    return _tell_damaged(damaged, "`bench collect` sets it aside, the same `bench run` does its run again")


def collect(argv: list[str]) -> int:
    """Fold the parts into the tables."""
    store = _store(argv)
    aside = store.collect()
    print(f"{counted(len(store.collected()), 'run')} in {store.folder}/runs.parquet, traces.parquet")
    return _tell_damaged(aside, "set aside here; nothing else is lost, the same `bench run` does its run again")


def report(argv: list[str]) -> int:
    """Write tables, figures and the page, and print the summary."""
    store = _store(argv)
    damaged = store.damaged()
    written = write_report(store, ADDITIONS)
    runs = store.runs()
    print_summary(stats.summary(runs))
    if said := mixed_code(runs):
        print(said)
    for finding in _findings(store.folder / "identifiability.csv"):
        print(finding)
    for path in written:
        if path.suffix in (".csv", ".png", ".html"):
            print(path)
    return _tell_damaged(damaged, "`bench collect` sets it aside; it is not in the report")


def _store(argv: list[str]) -> ResultStore:
    _, words = split_flags(argv, ())
    if len(words) != 1:
        raise ValueError("one STUDY_DIR is needed, such as results/adhoc")
    store = ResultStore(words[0])
    store.manifest()
    return store


def _tell_damaged(paths: list[Path], what: str) -> int:
    for path in paths:
        print(f"bench: {path}: is damaged (not a whole part); {what}", file=sys.stderr)
    return 2 if paths else 0


def _findings(path: Path) -> list[str]:
    """Return, once a problem whatever its error function, what its data cannot tell."""
    if not path.exists():
        return []
    table = pd.read_csv(path, keep_default_na=False)
    lost = table[table["rank"] < table["dimension"]]
    titles = problem_titles(lost, but=("error",))
    first = ~titles.duplicated()
    return [f"{title}: {said}" for title, said in zip(titles[first], lost.loc[first, "finding"], strict=True)]
