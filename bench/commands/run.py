"""``bench run``: a sweep, its summary, what failed and why; ``bench identify``: what data of a problem determine."""

from __future__ import annotations

import math
import os
import shlex
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from shutil import get_terminal_size
from statistics import mean
from typing import TYPE_CHECKING

import numpy as np

from calibench import problems
from calibench.bench.commands.cells import best_of, print_summary
from calibench.bench.commands.console import print_json, print_table
from calibench.bench.commands.study import runs_of_other_shards
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.gate.processes import leaving_nothing
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.names import method_titles, problem_titles
from calibench.bench.statistics.progress import without_numbers
from calibench.bench.store.arrays import kept, mask_of, to_pandas
from calibench.bench.store.columns import columns_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs
from calibench.bench.sweep.carry_out import Outcome, Way, carry_out, find_stale, show_progress
from calibench.bench.sweep.composition import parse, refuse_lists
from calibench.bench.sweep.remarks import points_outside, remarks_on_rows
from calibench.bench.sweep.request import Request, members_of, read_request
from calibench.bench.sweep.words import read_execution
from calibench.bench.verbs import IdentifyWords
from calibench.bench.words import RequestError, read, split_flags
from calibench.core import process
from calibench.core.words import counted, plain, plural, print_plain as print, span

if TYPE_CHECKING:
    import pyarrow as pa


_AGAIN = ("--retry-failed", "--rerun", "--keep", "--drop-planned")  # of one call, not of the study
_LONG = 40  # rows of a summary that are still printed
_SHORT = 12  # rows that are printed of a longer one
_FIRST = 10  # cells that a dry run lists
_WIDE = 100  # letters of an error in the list of failures, at least: as many as the terminal has room for
_UNUSED = (
    "traceback", "best_x", "at_bound", "parameter_names", "parameter_values", "parameter_units", "parameter_starts",
    "parameter_truths",
)  # fmt: skip  # what no summary looks at
_OVERHEAD = 0.002  # seconds a run takes besides its evaluations
_USED = [column.name for column in COLUMNS if column.group != "origin" and column.name not in _UNUSED]


@leaving_nothing()
def run(argv: list[str]) -> int:
    """Carry out the sweep that `argv` asks for; 1 where a run failed or has no row."""
    if any(word.partition("=")[0] in ("--config-dir", "-cd", "--config-name", "-cn") for word in argv):
        raise ValueError("--config-dir: is not built; words of your own stand in a study file, study=FILE.yaml")
    flags, words = split_flags(argv, ("-m", "--multirun", "--dry-run", "--all", *_AGAIN))
    if "--all" in flags and "--dry-run" not in flags:
        raise ValueError("--all: lists every cell of a dry run; give it with --dry-run")
    if {"--rerun", "--keep"} <= flags:
        raise ValueError("--rerun and --keep: rows of other code are done again or kept; give one of the two")
    retry, drop = "--retry-failed" in flags, "--drop-planned" in flags
    way: Way = "rerun" if "--rerun" in flags else "keep" if "--keep" in flags else "ask"
    command = shlex.join(["bench", "run", *(word for word in argv if word not in _AGAIN)])

    def carry(request: Request, command: str) -> Outcome:
        with show_progress(request.folder) as report:
            return carry_out(
                request, report, retry, drop, command, way, lambda line: print(f"bench: {line}", file=sys.stderr)
            )

    if any(word.partition("=")[0].partition(".")[0] == "tuner" for word in words):
        process.resume()
        with _ended_by_sigterm():
            return tune(words, command, carry, "--dry-run" in flags)
    request = read_request(words, multirun=bool({"-m", "--multirun"} & flags))
    process.resume()  # what it loaded stays
    for line in (*request.left_out, *request.copies, *request.remarks):
        print(line)
    if "--dry-run" in flags:
        return _dry_run(request, retry, way, len(request.labels) if "--all" in flags else _FIRST)
    with _ended_by_sigterm():
        outcome = carry(request, command)
    return _print(request, outcome, way)


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
            from calibench.bench.report.study.answer import answer_of  # half a second to load

            traces, runs = ResultStore(request.folder).traces(), to_pandas(mine)
            answer = answer_of(runs, traces[traces["run_id"].isin(runs["run_id"])])
            if answer.verdict != "alone":  # which method is best over all cells, and how sure, as the report says it
                print(f"{answer.best}\n{answer.sure}")
        columns = columns_of(mine)
        for line in (points_outside(columns), *remarks_on_rows(columns)):
            if line:
                print(line)
    if way == "keep" and outcome.stale.other:
        print(f"{outcome.stale.lines()[0]}; they were kept, and stand in the table above")
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
        # which runs were done and have no row, a line for each cell, with one to look for
        says = "run has no row" if len(lost) == 1 else "runs have no row"
        print(f"\n{len(lost)} {says}: what was kept of them in {request.folder} was damaged or taken away as they ran:")
        of_cell: dict[str, list[str]] = {}
        for run_id in sorted(lost):
            of_cell.setdefault(request.labels[run_id], []).append(run_id)
        rows = [[str(len(ids)), ids[0], request.called.get(label, label)] for label, ids in of_cell.items()]
        print_table(["runs", "such as", "cell"], rows[:_LONG])
        if len(rows) > _LONG:
            print(f"and those of {counted(len(rows) - _LONG, 'cell')} more")
        print("see that no problem or method writes there, then give the same command again")
        return 1
    return 1 if ended else 0


def _print_failures(rows: pa.Table, request: Request, way: Way) -> None:
    mine = to_pandas(rows)
    lost = mine[mine["status"] != "ok"]
    counts = {"failed": (lost["status"] == "failed").sum(), "out of time": (lost["status"] == "timeout").sum()}
    print(f"\n{', '.join(f'{count} {what}' for what, count in counts.items() if count)}:")
    named = lost.assign(
        problem=problem_titles(mine)[lost.index], optimizer=method_titles(mine)[lost.index],
        error=[" ".join(str(text).split()) for text in lost["error"]],
        alike=[without_numbers(str(text)) for text in lost["error"]],
    )  # fmt: skip
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


def _dry_run(request: Request, retry_failed: bool, way: Way, most: int) -> int:
    """Print what would be done, of at most so many cells by name; return 2 where rows of other code forbid it."""
    store = ResultStore(request.folder)
    states = store.survey().states if store.folder.is_dir() else {}
    failed = {run_id for run_id, state in states.items() if state.status != "ok" and run_id in request.specs}
    done = set(states) - (failed if retry_failed else set())
    stale = find_stale(request, store) if done else None
    if stale is not None and way == "rerun":
        done -= {*stale.other, *stale.unknown}
    runs = Counter(request.labels.values())
    finished = Counter(label for run_id, label in request.labels.items() if run_id in done)
    for label, count in [*runs.items()][:most]:
        print(f"{count:4d} {plural('run', count)}, {finished[label]} done  {request.called.get(label, label)}")
    if len(runs) > most:
        print(f"and {counted(len(runs) - most, 'cell')} more; --dry-run --all lists them")
    asks = "--rerun does them again, --keep goes on with them"
    ways = {"ask": asks, "rerun": "they are done again", "keep": "they are kept"}
    for line in stale.lines() if stale is not None else ():
        print(f"{line}; {ways[way]}")
    if failed:
        again = "which are done again" if retry_failed else "which --retry-failed does again"
        print(f"{counted(len(failed), 'run')} failed or ran out of time, {again}")
    to_do = len(request.specs) - finished.total()
    print(f"{counted(len(runs), 'cell')}, {counted(len(request.specs), 'run')}, {finished.total()} done, {to_do} left")
    if to_do:
        # wall time by the finished runs of a cell; of one without, a lower limit: its budget times the cost of a call
        took: dict[str, list[float]] = {}
        if done:
            rows = store.runs(["run_id", "wall_s"])
            for run_id, wall in zip(rows["run_id"], rows["wall_s"], strict=True):
                if run_id in request.labels:
                    took.setdefault(request.labels[run_id], []).append(float(wall))
        usual = {label: mean(walls) + _OVERHEAD for label, walls in took.items()}
        known = store.manifest().get("costs", []) if store.folder.is_dir() else []
        left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
        unknown = [spec for run_id, spec in left.items() if request.labels[run_id] not in usual]
        calls = costs.seconds_a_call(unknown, known) if unknown else {}
        seconds = 0.0
        for run_id, spec in left.items():
            label = request.labels[run_id]
            cost = None if label in usual else calls.get(costs.problem_of(spec))
            if label not in usual and cost is None:
                print("how long they take is not known")
                break
            seconds += usual[label] if cost is None else spec.budget * cost + _OVERHEAD
        else:
            least = span(max(seconds / read_execution(request.execution).workers, 1.0))
            print(f"they take some {least} or more; code that never ran here is compiled first, for some seconds more")
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
        kept = "finished runs are kept, the same command goes on from there"
        print(f"bench: stopped by SIGTERM; {kept}", file=sys.stderr)
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


def tune(words: list[str], command: str, carry: Callable[[Request, str], Outcome], dry_run: bool) -> int:
    """Run the default and the trials that `words` ask for; 1 where a run failed or has no row."""
    from calibench.bench.commands.compare import print_chosen
    from calibench.bench.statistics.choosing import NEEDED, choose
    from calibench.bench.sweep.tuner import Trial, first_request, read_tuning, trials

    tuning = read_tuning(words)
    try:
        for package in ("optuna", "cmaes") if tuning.sampler == "cmaes" else ("optuna",):
            import_module(package)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"tuner=optuna: needs {error.name}; pip install 'calibench[optuna]'") from None
    first = first_request(tuning)
    if dry_run:
        runs = len(first.specs)
        print(
            f"the default and {counted(tuning.trials, 'trial')} of {counted(runs, 'run')} each, at most "
            f"{counted(runs * (tuning.trials + 1), 'run')}, would go to {first.folder}; nothing was written"
        )
        return 0
    done: list[Trial] = []
    for trial in trials(tuning, lambda request, number: carry(request, "" if number else command)):
        done.append(trial)
        texts = (f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in trial.values.items())
        name = f"trial {trial.number} of {tuning.trials}: {', '.join(texts)}" if trial.number else "the default"
        is_best = trial.number and all(not other.score < trial.score for other in done)
        score = f"score {trial.score:.3f}{' (best so far)' if is_best else ''}"
        if math.isnan(trial.score):
            score = "no score (a run without an answer, or none at the goal)"
        print(f"{name}: {score}", flush=True)
    store = ResultStore(first.folder)
    asked = {run_id for trial in done for run_id in trial.request.specs}
    rows = store.runs(NEEDED)
    mine = rows[rows["run_id"].isin(asked)]
    print()
    try:
        print_chosen(choose(mine, tuning.by))
    except ValueError as error:
        print(f"what choosing is worth is not told: {error}")
    else:
        if tuning.sampler != "random":
            print(
                f"trials were proposed ({tuning.sampler}) by their scores on all instances: the nested score leaves "
                "out that optimism; tuner.sampler=random has none, other instances test the choice"
            )
    skipped = sum(trial.outcome.skipped for trial in done)
    print(f"{counted(len(mine), 'run')} in {store.folder}/runs.parquet; {skipped} of those asked for were done before")
    failed, ended = (int((mine["status"] == status).sum()) for status in ("failed", "timeout"))
    if failed or ended or len(mine) < len(asked):
        counts = {"failed": failed, "ended by the time limit": ended, "have no row": len(asked) - len(mine)}
        reasons = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        print(f"{reasons}; `bench status {shlex.quote(str(store.folder))}` tells why")
        return 1
    return 0


def identify(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--json",))
    given = read(IdentifyWords, "identify", words)
    overrides = parse([word for word in words if word.startswith("problem")])
    refuse_lists(overrides)
    member = members_of("problem", overrides)[0]
    if member.broken is not None:
        raise RequestError(f"problem {member.name} cannot be built: {member.broken.error}")
    problem = member.built
    known = problems.identify(problem, noise=given.noise)
    if "--json" in flags:
        print_json(known.to_dict())
        return 0
    print(f"{getattr(problem, 'name', type(problem).__name__)}: {known.sentence()}\n")
    unit = known.noise_unit + ("/mm" if any(known.units) else "")
    print(f"singular values [{unit}]: {'  '.join(f'{plain(s, 3)}' for s in known.singular_values)}\n")
    rows = [
        [name, unit, f"{value:.6g}", f"{plain(error, 3)}" if error < float("inf") else "cannot be found"]
        for name, unit, value, error in zip(known.names, known.units, known.x, known.standard_errors, strict=True)
    ]
    print_table(["parameter", "unit", "value", f"standard error at {known.noise:g} {known.noise_unit}"], rows)
    return 0
