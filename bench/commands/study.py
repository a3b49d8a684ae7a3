"""``bench collect|report STUDY_DIR`` and ``bench merge``: tables, reports and merged studies from result folders."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_summary
from calibench.bench.commands.status import runs_of_other_shards
from calibench.bench.papers.additions import ADDITIONS
from calibench.bench.report.study.write import finished_runs, report_progress, write_report
from calibench.bench.statistics.cells import CELL, mixed_code
from calibench.bench.statistics.names import problem_titles
from calibench.bench.store.merge import merge
from calibench.bench.store.runs import ResultStore
from calibench.core.words import counted
from calibench.core.words import print_plain as print


def collect(argv: list[str]) -> int:
    """Fold the journals into the tables."""
    store = _store(argv)
    aside = store.collect()
    print(f"{counted(len(store.collected()), 'run')} in {store.folder}/runs.parquet, traces.parquet")
    return _tell_damaged(aside, "set aside here; nothing else is lost, the same `bench run` does its run again")


def report(argv: list[str]) -> int:
    """Write tables, figures and the page, and print the summary."""
    store = _store(argv)
    damaged, finished = store.damaged(), finished_runs(store)
    with report_progress() as tell:
        written = write_report(store, ADDITIONS, tell, finished)
    print_summary(finished.summary.to_dict("list"))
    if warning := mixed_code(finished.runs):
        print(warning)
    for finding in _findings(store.folder / "identifiability.csv"):
        print(finding)
    for path in written:
        if path.suffix in (".csv", ".png", ".html"):
            print(path)
    return _tell_damaged(damaged, "`bench collect` sets it aside; it is not in the report")


def merge_studies(argv: list[str]) -> int:
    """Make one study of several folders."""
    words, to = list(argv), ""
    if "--to" in words:
        at = words.index("--to")
        to = words[at + 1] if at + 1 < len(words) else ""
        del words[at : at + 2]
    flags, folders = split_flags(words, ("--keep-first",))
    if not to or not folders:
        raise ValueError("merge: folders and where to are needed: bench merge A B --to C")
    merged = merge([Path(folder) for folder in folders], Path(to), keep_first="--keep-first" in flags)
    twice = f"; {counted(merged.twice, 'run')} stood in several folders" if merged.twice else ""
    to_do = f"; {merged.left} planned and not done" if merged.left else ""
    print(f"{counted(merged.runs, 'run')} in {to}/runs.parquet, traces.parquet{twice}{to_do}")
    if merged.in_other_shards:
        print(f"{runs_of_other_shards(merged.in_other_shards)}: merge those shards too, or the study is not whole")
    if warning := mixed_code(ResultStore(to).runs([*CELL, "code_digest"])):
        print(warning)
    return 0


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
    """Return a sentence on what the data cannot determine, once for each problem whatever its error function."""
    if not path.exists():
        return []
    table = pd.read_csv(path, keep_default_na=False)
    lost = table[table["rank"] < table["dimension"]]
    titles = problem_titles(lost, but=("error",))
    first = ~titles.duplicated()
    return [f"{title}: {finding}" for title, finding in zip(titles[first], lost.loc[first, "finding"], strict=True)]
