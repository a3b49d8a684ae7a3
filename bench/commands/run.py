"""``bench run``: a sweep, its summary, and a table of what failed."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_summary, print_table
from calibench.bench.statistics import summary as stats
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import carry_out
from calibench.bench.sweep.progress import progress
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.stale import Way, find_stale
from calibench.core.counted import counted, plural

_AGAIN = ("--retry-failed", "--rerun", "--keep")  # of one call, not of the study
_LONG = 40  # rows of a summary that are still printed
_WIDE = 100  # letters of an error in the list of failures


def run(argv: list[str]) -> int:
    """Carry out the sweep that `argv` asks for; 1 where a run failed or has no row."""
    flags, words = split_flags(argv, ("-m", "--multirun", "--dry-run", *_AGAIN))
    if {"--rerun", "--keep"} <= flags:
        raise ValueError("--rerun and --keep: rows of other code are done again or kept; give one of the two")
    request = read_request(words, multirun=bool({"-m", "--multirun"} & flags))
    for line in request.left_out:
        print(line)
    if "--dry-run" in flags:
        return _dry_run(request)
    command = shlex.join(["bench", "run", *(word for word in argv if word not in _AGAIN)])
    way: Way = "rerun" if "--rerun" in flags else "keep" if "--keep" in flags else "ask"
    with progress() as report:
        outcome = carry_out(request, report, "--retry-failed" in flags, command, way, _tell)
    for path in outcome.aside:
        print(f"a damaged part was set aside as {path}")
    runs = ResultStore(request.folder).runs()
    mine = runs[runs["run_id"].isin(outcome.asked)]
    summary = stats.summary(mine)
    if len(summary) <= _LONG:
        print_summary(summary)
    else:
        print(f"{counted(len(summary), 'cell')}; `bench report {request.folder}` prints and draws them")
    if way == "keep" and outcome.stale.other:
        print(f"{outcome.stale.told()}; they were kept, and stand in the table above")
    done = f"{counted(len(outcome.asked), 'run')} ({outcome.skipped} done before)"
    print(f"{done} in {request.folder}/runs.parquet, traces.parquet")
    failed = mine[mine["status"] != "ok"]
    if len(mine) < len(outcome.asked):
        missing = len(outcome.asked) - len(mine)
        says = "run has no row: its" if missing == 1 else "runs have no row: their"
        print(f"\n{missing} {says} process ended; run the same command again")
        return 1
    if failed.empty:
        return 0
    print(f"\n{len(failed)} failed:")
    columns = ["run_id", "problem", "optimizer", "repetition", "error_type", "error"]
    named = failed.assign(
        problem=[stats.problem_name(*pair) for pair in zip(failed["problem"], failed["problem_options"], strict=True)],
        optimizer=[
            stats.method_name(*pair) for pair in zip(failed["optimizer"], failed["optimizer_options"], strict=True)
        ],
    )
    rows = named[columns].astype(str).to_numpy().tolist()
    print_table(columns, [[*row[:-1], _short(" ".join(row[-1].split()))] for row in rows])
    print(
        f"`bench show RUN_ID{'' if request.folder.parent == Path('results') else f' results={request.folder.parent}'}` "
        "prints the last frames of a failure"
    )
    return 1


def _tell(line: str) -> None:
    print(f"bench: {line}", file=sys.stderr)


def _short(text: str) -> str:
    return text if len(text) <= _WIDE else f"{text[: _WIDE - 1]}…"


def _dry_run(request: Request) -> int:
    store = ResultStore(request.folder)
    done = store.finished() if store.folder.is_dir() else set()
    cells: dict[str, list[bool]] = {}
    stale = find_stale(request, store) if done else None
    for run_id, label in request.labels.items():
        cells.setdefault(label, []).append(run_id in done)
    for label, finished in cells.items():
        print(f"{len(finished):4d} {plural('run', len(finished))}, {sum(finished)} done  {label}")
    for line in (stale.told(), stale.told_unknown()) if stale is not None else ():
        if line:
            print(line)
    print(f"{counted(len(request.specs), 'run')} would go to {request.folder}; nothing was written")
    return 0
