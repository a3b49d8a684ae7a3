"""``bench run``: a sweep, its summary, and a table of what failed and why."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING

import numpy as np

from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import best_of, print_summary, print_table
from calibench.bench.commands.status import runs_of_other_shards
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.gate.processes import leaving_nothing
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.names import method_titles, problem_titles
from calibench.bench.statistics.progress import without_numbers
from calibench.bench.store.arrays import kept, mask_of
from calibench.bench.store.columns import columns_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.schema import to_pandas
from calibench.bench.sweep.carry_out import Outcome, carry_out
from calibench.bench.sweep.progress import progress, seconds_left
from calibench.bench.sweep.remarks import points_outside, remarks_on_rows
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.stale import Way, find_stale
from calibench.core import process
from calibench.core.words import counted, plural, span
from calibench.core.words import print_plain as print

if TYPE_CHECKING:
    import pyarrow as pa

_AGAIN = ("--retry-failed", "--rerun", "--keep", "--drop-planned")  # of one call, not of the study
_LONG = 40  # rows of a summary that are still printed
_SHORT = 12  # rows that are printed of a longer one
_WIDE = 100  # letters of an error in the list of failures, at least: as many as the terminal has room for
_UNUSED = (
    "traceback", "best_x", "at_bound", "parameter_names", "parameter_values", "parameter_units", "parameter_starts",
    "parameter_truths",
)  # fmt: skip  # what no summary looks at
_USED = [column.name for column in COLUMNS if column.group != "origin" and column.name not in _UNUSED]


def run(argv: list[str]) -> int:
    """Carry out the sweep that `argv` asks for; 1 where a run failed or has no row."""
    with leaving_nothing():
        return _run(argv)


def _run(argv: list[str]) -> int:
    if any(word.partition("=")[0] in ("--config-dir", "-cd", "--config-name", "-cn") for word in argv):
        raise ValueError("--config-dir: is not built; words of your own stand in a study file, study=FILE.yaml")
    flags, words = split_flags(argv, ("-m", "--multirun", "--dry-run", *_AGAIN))
    if {"--rerun", "--keep"} <= flags:
        raise ValueError("--rerun and --keep: rows of other code are done again or kept; give one of the two")
    if any(word.partition("=")[0].partition(".")[0] == "tuner" for word in words):
        return _tune(argv, words, flags)
    request = read_request(words, multirun=bool({"-m", "--multirun"} & flags))
    process.resume()  # what it loaded stays
    for line in (*request.left_out, *request.copies, *request.remarks):
        print(line)
    command, way = _command(argv), _way(flags)
    if "--dry-run" in flags:
        return _dry_run(request, "--retry-failed" in flags, way)
    with _ended_by_sigterm(), progress(request.folder) as report:
        outcome = carry_out(request, report, "--retry-failed" in flags, "--drop-planned" in flags, command, way, _tell)
    return _print(request, outcome, way)


def _tune(argv: list[str], words: list[str], flags: set[str]) -> int:
    """Carry out a sweep whose settings are proposed one after the other."""
    from calibench.bench.commands.tune import tune

    process.resume()

    def carry(request: Request, command: str) -> Outcome:
        with progress(request.folder) as report:
            return carry_out(
                request, report, "--retry-failed" in flags, "--drop-planned" in flags, command, _way(flags), _tell
            )

    with _ended_by_sigterm():
        return tune(words, _command(argv), carry, "--dry-run" in flags)


def _command(argv: list[str]) -> str:
    return shlex.join(["bench", "run", *(word for word in argv if word not in _AGAIN)])


def _way(flags: set[str]) -> Way:
    return "rerun" if "--rerun" in flags else "keep" if "--keep" in flags else "ask"


def _print(request: Request, outcome: Outcome, way: Way) -> int:
    for path in outcome.aside:
        print(f"what is damaged was set aside as {path}")
    kept_rows = ResultStore(request.folder).rows(_USED)
    asked = set(outcome.asked)
    is_mine = np.array([run_id in asked for run_id in kept_rows["run_id"].to_pylist()], dtype=bool)
    mine = kept_rows if is_mine.all() else kept(kept_rows, mask_of(is_mine))  # of 1e5 runs a copy is 70 MB
    if len(mine):
        summary = stats.summary_columns(columns_of(mine))
        if (cells := len(summary["runs"])) <= _LONG:
            print_summary(summary, request.seeds > 1)
        else:
            best = best_of(summary, _SHORT)
            if best["runs"]:
                print_summary(best, request.seeds > 1)
            some = f", of which the best {len(best['runs'])} are printed" if best["runs"] else ", more than are printed"
            print(f"{counted(cells, 'cell')}{some}; the report has all")
            _print_answer(mine, request)
        columns = columns_of(mine)
        for line in (points_outside(columns), *remarks_on_rows(columns)):
            if line:
                print(line)
    if way == "keep" and outcome.stale.other:
        print(f"{outcome.stale.told()}; they were kept, and stand in the table above")
    lost = set(outcome.asked).difference(mine["run_id"].to_pylist())
    every = f"{len(mine)} of " if lost else ""
    done = f"{every}{counted(len(outcome.asked), 'run')} ({outcome.skipped} done before)"
    report = f"bench report {shlex.quote(str(request.folder))}"
    print(f"{done} in {request.folder}/runs.parquet, traces.parquet; `{report}` draws them")
    if outcome.printed:
        here = outcome.printed[0] if len(outcome.printed) == 1 else outcome.printed[0].parent
        print(f"what runs printed stands in {here}")
    if away := request.other_shards.difference(kept_rows["run_id"].to_pylist()):
        print(runs_of_other_shards(len(away)))
    ended = Counter(status for status in mine["status"].to_pylist() if status != "ok")
    if ended:
        _print_failures(mine, request, way)
    if outcome.unfinished:
        print(
            f"\nstopped after {counted(ended['failed'], 'failure')} "
            f"(stop_after={request.stop_after}): {len(lost)} of {counted(len(outcome.asked), 'run')} left; the same "
            "command goes on with them"
        )
        return 1
    if lost:
        _print_lost(lost, request)
        return 1
    return 1 if ended else 0


def _print_answer(mine: pa.Table, request: Request) -> None:
    """Print which method is best over all cells, and how sure that is, as the report says it."""
    from calibench.bench.report.study.answer import answer_of  # of a long sweep alone: it takes half a second to load

    traces = ResultStore(request.folder).traces()
    runs = to_pandas(mine)
    answer = answer_of(runs, traces[traces["run_id"].isin(runs["run_id"])])
    if answer.verdict != "alone":
        print(f"{answer.best}\n{answer.sure}")


def _print_lost(lost: Collection[str], request: Request) -> None:
    """Print which runs were done and have no row, a line for each cell, with one to look for."""
    says = "run has no row" if len(lost) == 1 else "runs have no row"
    print(f"\n{len(lost)} {says}: what was kept of them in {request.folder} was damaged or taken away as they ran:")
    cells: dict[str, list[str]] = {}
    for run_id in sorted(lost):
        cells.setdefault(request.labels[run_id], []).append(run_id)
    rows = [[str(len(ids)), ids[0], request.called.get(label, label)] for label, ids in cells.items()]
    print_table(["runs", "such as", "cell"], rows[:_LONG])
    if len(rows) > _LONG:
        print(f"and those of {counted(len(rows) - _LONG, 'cell')} more")
    print("see that no problem or method writes there, then give the same command again")


def _print_failures(rows: pa.Table, request: Request, way: Way) -> None:
    """Print why some of the `rows` did not end well, a line for each reason of a problem and a method, with one run."""
    mine = to_pandas(rows)
    lost = mine[mine["status"] != "ok"]
    counts = {"failed": (lost["status"] == "failed").sum(), "out of time": (lost["status"] == "timeout").sum()}
    print(f"\n{', '.join(f'{count} {what}' for what, count in counts.items() if count)}:")
    named = lost.assign(
        problem=problem_titles(mine)[lost.index],
        optimizer=method_titles(mine)[lost.index],
        error=[" ".join(str(text).split()) for text in lost["error"]],
        alike=[without_numbers(str(text)) for text in lost["error"]],
    )
    reasons = []
    columns = ["problem", "optimizer", "status", "error_type", "error"]
    for _, some in named.groupby([*columns[:-1], "alike"], sort=False, dropna=False):
        first = some.sort_values("repetition").iloc[0]
        reasons.append([str(len(some)), str(first["run_id"]), *map(str, first[columns])])
    reasons.sort(key=lambda row: -int(row[0]))
    heads, shown = ["runs", "such as", *columns], reasons[:_LONG]
    before = sum(2 + max(map(len, column)) for column in list(zip(heads, *shown, strict=True))[:-1])
    room = max(_WIDE, get_terminal_size((0, 0)).columns - before)
    short = [row[-1] if len(row[-1]) <= room else f"{row[-1][: room - 1]}…" for row in shown]
    print_table(heads, [[*row[:-1], text] for row, text in zip(shown, short, strict=True)])
    if len(reasons) > _LONG:
        print(f"and {len(reasons) - _LONG} more; `bench status {shlex.quote(str(request.folder))}` lists all reasons")
    others = ", and --rerun what other code made" if way == "rerun" else ""
    print(f"the same command with --retry-failed runs them again{others}")
    where = "" if request.folder.parent == Path("results") else f" results={shlex.quote(str(request.folder.parent))}"
    print(f"`bench show RUN_ID{where}` prints one of them, with the last frames of an error that Python has raised")


def _tell(line: str) -> None:
    print(f"bench: {line}", file=sys.stderr)


def _dry_run(request: Request, retry_failed: bool, way: Way) -> int:
    """Print cells, runs, those done and left, and what the rest takes as far as that is known.

    Returns 2 where the same command without --dry-run would stop: rows are of other code, and no flag says what to do.
    """
    store = ResultStore(request.folder)
    states = store.survey().states if store.folder.is_dir() else {}
    failed = {run_id for run_id, state in states.items() if state.status != "ok" and run_id in request.specs}
    done = set(states) - (failed if retry_failed else set())
    stale = find_stale(request, store) if done else None
    if stale is not None and way == "rerun":
        done -= {*stale.other, *stale.unknown}
    runs = Counter(request.labels.values())
    finished = Counter(label for run_id, label in request.labels.items() if run_id in done)
    for label, count in runs.items():
        print(f"{count:4d} {plural('run', count)}, {finished[label]} done  {request.called.get(label, label)}")
    ways = {
        "ask": "--rerun does them again, --keep goes on with them",
        "rerun": "they are done again",
        "keep": "they are kept",
    }
    for line in (stale.told(), stale.told_unknown()) if stale is not None else ():
        if line:
            print(f"{line}; {ways[way]}")
    if failed:
        again = "which are done again" if retry_failed else "which --retry-failed does again"
        print(f"{counted(len(failed), 'run')} failed or ran out of time, {again}")
    to_do = len(request.specs) - finished.total()
    print(f"{counted(len(runs), 'cell')}, {counted(len(request.specs), 'run')}, {finished.total()} done, {to_do} left")
    if to_do:
        seconds = seconds_left(request, done)
        known = "" if seconds is None else f"they take some {span(max(seconds, 1.0))} or more"
        print(known or "how long they take is not known")
    would = f"{counted(to_do, 'run')} would go to {request.folder}" if to_do else "nothing is left to run"
    print(f"{would}; nothing was written")
    return 2 if stale is not None and stale.other and way == "ask" else 0


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM, by which clusters end a job, end a sweep as Ctrl-C does: nothing is left running."""

    pid = os.getpid()

    def stop(number: int, _frame: object) -> None:
        if os.getpid() != pid:  # a process that a user's code has forked, such as a Pool's: it ends as it would alone
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        _tell("stopped by SIGTERM; finished runs are kept, the same command goes on from there")
        raise SystemExit(128 + number)

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        if os.getpid() == pid:
            signal.signal(signal.SIGTERM, before)
