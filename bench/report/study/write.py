"""Write the report of a study: ``summary.csv``, the table of calibrated values, the figures, and the page.

`report_progress` tells how far it is: a bar on a terminal, plain lines elsewhere, and neither where it is done at once.
"""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.execution.answer import offered
from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.report.shared.drawing import drawn
from calibench.bench.report.shared.kept import ENDINGS, Kept, State, code, digest, files_named, state_of, state_of_file
from calibench.bench.report.study import figures
from calibench.bench.report.study.additions import Additions, FilledSection
from calibench.bench.report.study.explored import groups_of
from calibench.bench.report.study.figures import ecdf_figures
from calibench.bench.report.study.page import StudyPage
from calibench.bench.statistics import summary as stats, tables
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.fixed_target import Hits
from calibench.bench.statistics.optimum import ends_of
from calibench.bench.statistics.ranking import with_looks
from calibench.bench.statistics.targets import levels_of, with_lowest_seen
from calibench.bench.store.arrays import RUNS_SCHEMA, give_back
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.columns import numbered
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.tables import parquet_file
from calibench.bench.sweep.composition import study_preset
from calibench.core.words import print_plain as print

Tell = Callable[[int, int, str], None]
_SOON = 2.0  # seconds, within which nothing is told to a file
_EVERY = 5.0  # seconds between two lines
_STEPS = 4  # besides the figures
_DRAWN = 12  # problems with drawings as files: the page draws every problem, and a drawing takes a second
_FEW = 2  # of a study of more than `_MANY` problems, of which a dozen drawings show no more than these
_MANY = 100
_GROUPS = 12  # drawings of groups
_UNREAD = {
    "best_x", "at_bound", "hits", "traceback", "seed", "library", "library_version", "schema_version", "non_finite",
    "non_finite_slopes", "tampering", "process_changes",
}  # fmt: skip  # columns of which a report says nothing


@final
@dataclass(frozen=True, kw_only=True)
class FinishedRuns:
    """The runs of a study with their goals (`with_lowest_seen`), their traces, and their summary with costs; `files`
    are those that stood in its folder before they were read, or that the runs name; the `manifest` is without what was
    planned and is done."""

    manifest: Mapping[str, Any]
    files: State
    runs: pd.DataFrame
    traces: pd.DataFrame
    summary: pd.DataFrame


def finished_runs(store: ResultStore) -> FinishedRuns:
    """Return what a report is made of. Raises `StoreError` without runs."""
    columns = [name for name in RUNS_SCHEMA.names if name not in _UNREAD]
    files, runs = state_of(store.folder), offered(store.runs(columns))
    if runs.empty:
        raise StoreError(f"{store.folder}: holds no finished run yet")
    # those of a problem have one list of its parameters' names: of 1e5 runs they would be 50 MB
    number, there = numbered(runs[name] for name in PROBLEM), np.flatnonzero(runs["parameter_names"].notna())
    known, first = np.unique(number[there], return_index=True)
    for name in tables.OF_PARAMETERS:
        lists = np.full(len(runs), None, dtype=object)  # by the number of the problem
        for problem, one in zip(known, runs[name].iloc[there[first]], strict=True):
            lists[problem] = one if isinstance(one, list) else None
        runs[name] = lists[number]
    traces, manifest, done = store.courses(), store.manifest(), {*runs["run_id"]}
    manifest["planned"] = {run_id: label for run_id, label in manifest["planned"].items() if run_id not in done}
    named = files_named([*runs["problem_options"].unique(), *runs["optimizer_options"].unique()])
    files |= {name: state_of_file(Path(name)) for name in named}
    runs = with_lowest_seen(runs, traces)
    summary = stats.summary(runs, manifest.get("costs", []))
    give_back()
    return FinishedRuns(manifest=manifest, files=files, runs=runs, traces=traces, summary=summary)


def write_report(
    store: ResultStore, additions: Additions = (), tell: Tell = lambda done, of, what: None,
    finished: FinishedRuns | None = None,
) -> list[Path]:  # fmt: skip
    """Write tables, figures and page of `store` into its folder; return their paths, the page's last."""
    tell(0, _STEPS, "the runs")
    finished = finished_runs(store) if finished is None else finished
    runs, traces, summary, manifest = finished.runs, finished.traces, finished.summary, finished.manifest
    kept, about = Kept.read(store.folder), (study_preset(manifest["study"]) or {}).get("description", "")
    with tables.problems_made_once() as known, _of_problems(runs, additions, known) as asked:
        import_module("calibench.bench.report.shared.artists")  # with Matplotlib, while that process is at the levels
        tell(1, _STEPS, "when each run reached each target")
        looking, groups, ranked = with_looks(runs, summary), groups_of(runs), figures.ranked_over_tasks(runs)
        levels, stated = next(asked)  # found meanwhile
        known |= stated
        written = [store.write_hits(levels)]
        file = parquet_file(written[0], as_codes=("run_id", "quantity"))
        hits = Hits.of(file.read_row_group(i, Hits.COLUMNS) for i in range(file.num_row_groups))
        give_back()
        tell(2, _STEPS, "the tables")
        together = list(ecdf_figures(looking, hits, groups))[:_GROUPS]
        drawable = [(name, draw) for name, _, draw in together]
        many = len(runs[PROBLEM].drop_duplicates()) > _MANY
        drawable += figures.drawable(looking, traces, additions, _FEW if many else _DRAWN, ranked)
        steps = _STEPS + len(drawable)
        at = {name: 3 + i for i, (name, _) in enumerate(reversed(drawable))}  # the last is drawn first
        home, digests = store.folder / "figures", {name: digest(draw) for name, draw in drawable}
        files_of = {name: [home / f"{name}.{ending}" for ending in ENDINGS] for name, _ in drawable}
        new = [one for one in drawable if not kept.has_figure(one[0], digests[one[0]], files_of[one[0]])]
        give_back()  # before its processes, which would have it too
        with drawn(new, home, lambda name: tell(at.get(name, 3), steps, f"figure {name}")) as wait:
            identifiability, calibrated, built = next(asked)
            several = len(runs[METHOD].drop_duplicates()) > 1
            named = {
                "summary": summary, "calibrated": calibrated, "identifiability": identifiability,
                "overview": tables.overview(runs, manifest.get("costs", []), summary) if several else pd.DataFrame(),
            }  # fmt: skip
            filled = [
                (section, tuple(pair for pair in zip(section.tables, rows, strict=True) if not pair[1].empty))
                for section, rows in zip((s for one in additions for s in one.sections), built, strict=True)
            ]
            sections: list[FilledSection] = [one for one in filled if one[1]]
            printed = [(f"tables/{table.name}", rows) for _, pairs in sections for table, rows in pairs]
            for name, table in [*named.items(), *printed]:
                path = store.folder / f"{name}.csv"
                if table.empty:  # there is no file, nor one from an earlier report
                    path.unlink(missing_ok=True)
                    continue
                path.parent.mkdir(exist_ok=True)
                table.to_csv(path, index=False)
                written.append(path)
            page = StudyPage(
                folder=store.folder, runs=runs, sections=sections, identifiability=identifiability, summary=summary,
                drawings=lambda: files_of | wait(), manifest=manifest, about=about, traces=traces, hits=hits,
                beside={words: address for one in additions for words, address in one.links(store.folder).items()},
                captions={f.name: f.caption for one in additions for f in one.figures if f.name in files_of},
                together={name: caption for name, caption, _ in together}, ranked=ranked,
            ).html()  # fmt: skip
            written += [path for paths in (files_of | wait()).values() for path in paths]
    tell(steps - 1, steps, "the page")
    written.append(write_whole(store.folder / "report.html", page.encode()))
    ours = [path.relative_to(store.folder).as_posix() for path in written]
    for name in finished.files:  # of the last report, which this one has no more
        if name.startswith(("figures/", "tables/")) and name in kept.written and name not in ours:
            (store.folder / name).unlink(missing_ok=True)
    after = state_of(store.folder, finished.files)  # of which what others changed meanwhile is not in the report
    files = {name: after[name] if name in ours else finished.files.get(name, []) for name in after}
    Kept(code=code(), files=files, written=ours, figures=digests).write(store.folder)
    return written


@contextmanager
def _of_problems(
    runs: pd.DataFrame, additions: Additions, known: dict[tuple[str, ...], Any]
) -> Iterator[Iterator[Any]]:  # fmt: skip
    """Yield what needs the problems themselves: their levels, with their values at truth and start; then the tables.

    A process beside this one builds them, where all are of installed packages: compiled code takes 70 MB.
    """
    pairs = runs[PROBLEM[:2]].drop_duplicates()

    def levels() -> tuple[pd.DataFrame, dict[tuple[str, ...], Any]]:
        found = levels_of(runs)
        for name, options in pairs.itertuples(index=False):
            ends_of(name, options)
        for figure in (figure for addition in additions for figure in addition.figures):
            figure.applies(runs)  # which compares with problems of its own
        return found, {key: value for key, value in known.items() if key[0] != tables.MADE}

    def rest() -> tuple[pd.DataFrame, pd.DataFrame, list[list[pd.DataFrame]]]:
        built = [[table.build(runs) for table in section.tables] for one in additions for section in one.sections]
        return tables.identifiability(runs), tables.calibrated(runs), built

    jobs: Sequence[Callable[[], Any]] = (levels, rest)
    if not CAN_FORK or not {*pairs["problem"]} <= {*problems.registry.names()}:
        yield (job() for job in jobs)
        return
    with WorkerPool(lambda number: jobs[number](), 1) as pool:
        pool.begin(range(len(jobs)))
        yield (pool.take() for _ in jobs)


@contextmanager
def report_progress() -> Iterator[Tell]:
    """Yield a tell(done, of, what) to call before each step of a report."""
    if sys.stderr.isatty():
        from calibench.bench.sweep.carry_out import show_progress  # with what carries out runs

        with show_progress() as tell:
            yield tell
        return
    last = time.monotonic() + _SOON - _EVERY

    def tell_in_lines(done: int, of: int, what: str) -> None:
        nonlocal last
        if time.monotonic() - last >= _EVERY:
            last = time.monotonic()
            print(f"  report: step {done + 1} of {of}, {what}", file=sys.stderr, flush=True)

    yield tell_in_lines
