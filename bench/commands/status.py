"""``bench status [--watch] STUDY_DIR``: progress of a sweep, from any shell that can read its folder."""

import platform
import sys
import time
from itertools import islice

from calibench.bench.execution.in_progress import read_running
from calibench.bench.statistics.progress import SweepProgress, sweep_progress
from calibench.bench.store.columns import columns_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.remarks import remarks_on_rows
from calibench.bench.words import split_flags
from calibench.core.words import counted, plain, plural, print_plain as print, printable, span

_EVERY = 2.0  # seconds between two looks
_CELLS = 20  # of which what is left is listed
_LOOKED_AT = ("problem", "optimizer", "evaluations", "non_finite", "non_finite_slopes", "tampering", "process_changes")


def run(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--watch",))
    if len(words) != 1:
        raise ValueError("one STUDY_DIR is needed, such as results/adhoc")
    store = ResultStore(words[0])
    progress = sweep_progress(store)
    if "--watch" in flags:
        from rich.console import Console
        from rich.live import Live

        idle = 0  # looks at which nobody was at it
        with Live(console=Console(), transient=True, auto_refresh=False) as live:
            while progress.to_do and idle < 2:
                idle = 0 if progress.hosts else idle + 1
                live.update(printable("\n".join(lines_of(store, progress))), refresh=True)
                time.sleep(_EVERY)
                progress = sweep_progress(store)
    rows = {} if store.has_journals() else columns_of(store.rows(_LOOKED_AT))  # to read journals takes their time
    print("\n".join([*lines_of(store, progress), *(remarks_on_rows(rows) if rows else ())]))
    for path in progress.damaged:
        print(
            f"bench: {path}: has lines that are damaged; `bench collect` sets them aside, the same `bench run` does "
            "their runs again", file=sys.stderr,
        )  # fmt: skip
    return 2 if progress.damaged else 0


def lines_of(store: ResultStore, progress: SweepProgress) -> list[str]:
    late = f", {progress.timeouts} out of time" if progress.timeouts else ""
    lines = [f"{store.folder}: {progress.done} done ({progress.failed} failed{late}), {progress.to_do} left"]
    if progress.pace > 0:
        eta = f", {span(progress.eta_s)} left" if progress.eta_s is not None else ""
        lines[0] += f"; {plain(progress.pace, 3)} {plural('run', progress.pace)}/s{eta}"
    if progress.to_do and platform.node() not in progress.hosts:  # as far as this machine can tell
        others = ", ".join(sorted(progress.hosts))
        unseen = f"; whether {others} still {'is' if len(progress.hosts) == 1 else 'are'} cannot be seen from here"
        way = f"the same command goes on: {progress.command}" if progress.command else "the same call goes on"
        lines.append(f"nobody is at work on it here{unseen if others else ''}; {way}")
    if progress.mixed:
        lines.append(
            f"{counted(progress.mixed, 'cell')} {'holds' if progress.mixed == 1 else 'hold'} runs of more than one "
            "version of the code (column code_digest), kept with --keep or merged; the same command with --rerun does "
            "them again"
        )
    if progress.in_other_shards:
        lines.append(runs_of_other_shards(progress.in_other_shards))
    lines += [f"  {run.line()}" for run in read_running(store.folder)]
    if progress.reasons:  # most frequent first, each with one run to look at
        width = len(str(progress.reasons[0].count))
        lines.append("did not end well:")
        lines += [f"  {r.count:{width}d} {r.status}: {r.text}  (bench show {r.run_id})" for r in progress.reasons]
    cells = sorted(progress.left.items(), key=lambda item: -item[1])
    lines += [f"{count:4d} left  {label}" for label, count in islice(cells, _CELLS)]
    if len(cells) > _CELLS:
        lines.append(f"          and {counted(len(cells) - _CELLS, 'cell')} more")
    return lines


def runs_of_other_shards(count: int) -> str:
    """Return in words that runs of this sweep are in other shards.

    >>> runs_of_other_shards(1)
    '1 run of this sweep belongs to other shards and is not here'
    """
    verbs = ("belongs", "is") if count == 1 else ("belong", "are")
    return f"{counted(count, 'run')} of this sweep {verbs[0]} to other shards and {verbs[1]} not here"
