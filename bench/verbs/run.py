"""``bench run``: a sweep, its summary, and a table of what failed."""

from __future__ import annotations

import shlex

from bench import stats
from bench.progress import progress
from bench.request import Request, read_request
from bench.store import ResultStore
from bench.sweep import carry_out
from bench.verbs.terminal import print_summary, print_table
from bench.verbs.words import split_flags

_LONG = 40  # rows of a summary that are still printed


def run(argv: list[str]) -> int:
    """Carry out the sweep that `argv` asks for; 1 where a run failed or has no row."""
    flags, words = split_flags(argv, ("-m", "--multirun", "--dry-run", "--retry-failed"))
    request = read_request(words, multirun=bool({"-m", "--multirun"} & flags))
    for line in request.left_out:
        print(line)
    if "--dry-run" in flags:
        return _dry_run(request)
    command = shlex.join(["bench", "run", *(word for word in argv if word != "--retry-failed")])
    with progress() as report:
        outcome = carry_out(request, report, retry_failed="--retry-failed" in flags, command=command)
    for path in outcome.aside:
        print(f"a damaged part was set aside as {path}")
    runs = ResultStore(request.folder).runs()
    mine = runs[runs["run_id"].isin(outcome.asked)]
    summary = stats.summary(mine)
    if len(summary) <= _LONG:
        print_summary(summary)
    else:
        print(f"{len(summary)} cells; `bench report {request.folder}` prints and draws them")
    print(f"{len(outcome.asked)} runs ({outcome.skipped} done before) in {request.folder}/runs.parquet, traces.parquet")
    failed = mine[mine["status"] != "ok"]
    if len(mine) < len(outcome.asked):
        print(f"\n{len(outcome.asked) - len(mine)} runs have no row: their process ended; run the same command again")
        return 1
    if failed.empty:
        return 0
    print(f"\n{len(failed)} failed:")
    columns = ["run_id", "problem", "optimizer", "repetition", "error_type", "error"]
    rows = failed[columns].astype(str).to_numpy().tolist()
    print_table(columns, [[*row[:-1], " ".join(row[-1].split())[:100]] for row in rows])
    return 1


def _dry_run(request: Request) -> int:
    store = ResultStore(request.folder)
    done = store.finished() if store.folder.is_dir() else set()
    cells: dict[str, list[bool]] = {}
    for run_id, label in request.labels.items():
        cells.setdefault(label, []).append(run_id in done)
    for label, finished in cells.items():
        print(f"{len(finished):4d} runs, {sum(finished)} done  {label}")
    print(f"{len(request.specs)} runs would go to {request.folder}; nothing was written")
    return 0
