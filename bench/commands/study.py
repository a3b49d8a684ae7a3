"""The verbs of one study: ``bench status``, ``collect``, ``merge``, and ``show``, of one run."""

import platform
import sys
import time
from itertools import islice
from pathlib import Path

from calibench.bench.commands.console import print_json
from calibench.bench.execution.in_progress import read_running
from calibench.bench.statistics.cells import CELL, mixed_code
from calibench.bench.statistics.progress import SweepProgress, sweep_progress
from calibench.bench.store.columns import columns_of
from calibench.bench.store.runs import ResultStore, merge
from calibench.bench.sweep.remarks import remarks_on_rows
from calibench.bench.verbs import TrackingWords
from calibench.bench.words import read, split_flags, split_word
from calibench.core.words import counted, plain, plural, print_plain as print, printable, span


def collect(argv: list[str]) -> int:
    store = store_of(argv)
    aside = store.collect()
    print(f"{counted(len(store.collected()), 'run')} in {store.folder}/runs.parquet, traces.parquet")
    return tell_damaged(aside, "set aside here; nothing else is lost, the same `bench run` does its run again")


def merge_studies(argv: list[str]) -> int:
    to, words = split_word(argv, "--to")
    flags, folders = split_flags(words, ("--keep-first",))
    if not any(to) or not folders:
        raise ValueError("merge: folders and where to are needed: bench merge A B --to C")
    if pairs := [key for key, is_, _ in (word.partition("=") for word in folders) if is_ and key.isidentifier()]:
        raise ValueError(f"merge takes no {pairs[0]}=; it takes folders, --to and --keep-first")
    merged = merge([Path(folder) for folder in folders], Path(*to), keep_first="--keep-first" in flags)
    twice = f"; {counted(merged.twice, 'run')} stood in several folders" if merged.twice else ""
    to_do = f"; {merged.left} planned and not done" if merged.left else ""
    print(f"{counted(merged.runs, 'run')} in {to[0]}/runs.parquet, traces.parquet{twice}{to_do}")
    if merged.in_other_shards:
        print(f"{runs_of_other_shards(merged.in_other_shards)}: merge those shards too, or the study is not whole")
    if warning := mixed_code(ResultStore(to[0]).runs([*CELL, "code_digest"])):
        print(warning)
    return 0


def store_of(argv: list[str]) -> ResultStore:
    _, words = split_flags(argv, ())
    if len(words) != 1:
        raise ValueError("one STUDY_DIR is needed, such as results/adhoc")
    store = ResultStore(words[0])
    store.manifest()
    return store


def tell_damaged(paths: list[Path], what: str) -> int:
    for path in paths:
        print(f"bench: {path}: is damaged (not a whole part); {what}", file=sys.stderr)
    return 2 if paths else 0


def show(argv: list[str]) -> int:
    """Print the run whose id begins with the word of `argv`; a word that is a folder is where it is looked for."""
    from calibench.bench.report.one_run import find_run, show_run  # half a second to load

    flags, words = split_flags(argv, ("--json",))
    pairs = [word for word in words if "=" in word]
    given, plain = read(TrackingWords, "show", pairs), [word for word in words if "=" not in word]
    folders = [word for word in plain if len(plain) > 1 and Path(word).is_dir()]
    ids = [word for word in plain if word not in folders]
    if len(ids) != 1 or len(folders) + len(pairs) > 1:
        raise ValueError("show: one RUN_ID is needed, such as bench show 3f2a (the first digits suffice)")
    one = find_run(Path([*folders, given.results][0]), ids[0])
    if "--json" in flags:
        print_json(one.row)
    else:
        print(show_run(one))
    return 0


_EVERY = 2.0  # seconds between two looks
_CELLS = 20  # of which what is left is listed
_LOOKED_AT = ("problem", "optimizer", "evaluations", "non_finite", "non_finite_slopes", "tampering", "process_changes")


def status(argv: list[str]) -> int:
    store = store_of([word for word in argv if word != "--watch"])
    progress = sweep_progress(store)
    if "--watch" in argv:
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
