"""Runs in the standing process, and the rows of runs whose process was lost.

The standing process makes the runs that have a time limit; each thread that makes such runs has one. It is begun anew
where a run was cut or left something that cannot be put back (`core.own_state`), and where this process is no longer
what it was as it forked. Of a run whose process was lost, problem and optimiser are
built once more in a child with little time; else the classes are read; else only the `Spec`. So there is always a row.
"""

import os
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from math import inf
from typing import Any

from calibench import optimizers, problems
from calibench.bench.execution.answer import NO_MERIT, Answer
from calibench.bench.execution.costly import ReplayFolder
from calibench.bench.execution.kernels import is_own, load_new_kernels
from calibench.bench.execution.request import check_numbers, pair_of, preferred_start, read_asked
from calibench.bench.execution.run import Run, Spec, made_or_found, make_run, row_of
from calibench.bench.execution.run_row import SCHEMA_VERSION, RunRow
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.processes import Lost, apart, has_children
from calibench.bench.gate.time_limit import Cut, Ending, Mirror, Phase, Runner, Watch
from calibench.bench.provenance.code_digest import Library, code_digest, library_of
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical, chosen_options, options_as_asked, run_id
from calibench.core import own_state, user_file
from calibench.core.process_state import SLOW

_PATIENCE = 5.0  # seconds for building a problem and an optimiser once more, and again for looking at their classes


# a run to be made, in how many processes, its replay, how long building may take [s]; and how it was cut before, if so
_Request = tuple[Spec, int, ReplayFolder | None, float, Cut | None]
# a standing process, and the state of this one as it was begun; a process ends with the thread that began it
_STANDING: dict[threading.Thread, tuple[Runner, own_state.Kept]] = {}
os.register_at_fork(after_in_child=_STANDING.clear)


def run_apart(spec: Spec, inner: int, replay: ReplayFolder | None, known_id: str) -> Run:
    """Make the run in this thread's standing process, or its row where it is cut there (`known_id`: not built)."""
    check_numbers(spec.budget, spec.repetition, spec.target, spec.time_limit)
    limited = not (is_own(problems.registry, spec.problem) and is_own(optimizers.registry, spec.optimizer))
    building_s = spec.time_limit if limited and spec.time_limit is not None else inf
    run, found_id = made_or_found(lambda found, hear: _ask((spec, inner, replay, building_s, found), hear))
    if isinstance(run, Run):
        return run
    ending, patience = run.ending, _PATIENCE if spec.time_limit is None else min(spec.time_limit, _PATIENCE)
    return lost_run(
        spec, found_id or known_id, ending.error_type, ending.error, timed_out=run.timed_out,
        wall_s=ending.wall_s, cpu_s=ending.cpu_s, patience=patience,
    )  # fmt: skip


def _ask(request: _Request, hear: Callable[[Any, Mirror, int], None]) -> Run | Cut:
    """Return what the standing process makes of a request."""
    spec, me = request[0], threading.current_thread()
    limit = inf if spec.time_limit is None else spec.time_limit
    if not _is_plain([spec.problem_options, spec.optimizer_options]):  # an object cannot be sent there
        runner = Runner(lambda _, watch: (_make(request, watch)[0], False))
        return runner.ask(None, limit, hear)  # type: ignore[no-any-return]
    if load_new_kernels(spec):
        _end_standing(me)  # it begins from here, where they are
    for thread in [thread for thread in _STANDING if not thread.is_alive()]:
        _end_standing(thread)
    if me in _STANDING:
        runner, before = _STANDING[me]
        if not runner.child.is_alive() or before.change():
            _end_standing(me)
    if me not in _STANDING:
        _STANDING[me] = Runner(_make), own_state.Kept(SLOW)
    return _STANDING[me][0].ask(request, limit, hear)  # type: ignore[no-any-return]


def _end_standing(thread: threading.Thread) -> None:
    if thread in _STANDING:
        _STANDING.pop(thread)[0].end()


def _make(request: _Request, watch: Watch) -> tuple[Run, bool]:
    spec, inner, replay, building_s, cut = request
    watch.enter(Phase.BUILDING, building_s)
    with spec.asked(inner, replay) as (asked, state):
        run = make_run(asked, state, watch, cut)
    return run, not (own_state.lasting() or has_children())


def _is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(isinstance(name, str) and _is_plain(one) for name, one in value.items())
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or type(value) in (bool, int, float, str)


def lost_run(
    spec: Spec, known_id: str, error_type: str, error: str, *, timed_out: bool = False, wall_s: float = 0.0,
    cpu_s: float = 0.0, patience: float = _PATIENCE,
) -> Run:  # fmt: skip
    """Return the failed run of `spec`: of status timeout where it `timed_out`, else failed with this type and error.

    `patience` [s] is given to each of the two looks. Where `known_id` is empty it is that of what these looks find.
    """
    ending = Ending("" if timed_out else error_type or "Lost", error, wall_s, cpu_s)
    provenance()  # here, where it is kept, and not in every child
    row = _bare(spec, ending)
    for look in (_as_built, _as_declared):
        try:
            row = apart(partial(look, spec, ending), patience)
            break
        except Lost:
            continue
    return Run(replace(row, run_id=known_id or row.run_id), ())


def _as_built(spec: Spec, ending: Ending) -> RunRow:
    problem = problems.make(spec.problem, **spec.problem_options)
    optimizer = optimizers.make(spec.optimizer, **spec.optimizer_options)
    asked = read_asked(pair_of(problem, optimizer), spec.budget, spec.repetition, start=spec.start, target=spec.target)
    gate = Evaluator(problem, asked.budget, start=asked.first, target=asked.target, targets=asked.targets)
    gate.stopped = None if ending.error_type else "timeout"
    return row_of(asked, gate, Answer(), ending, datetime.now(UTC))


def _as_declared(spec: Spec, ending: Ending) -> RunRow:
    """Return the row with the names, options and code of classes that cannot be built."""
    known, methods = problems.registry, optimizers.registry
    problem, optimizer = known.factory(spec.problem), methods.factory(spec.optimizer)
    named = replace(
        spec,
        problem_options=options_as_asked(known, spec.problem, spec.problem_options) or spec.problem_options,
        optimizer_options=options_as_asked(methods, spec.optimizer, spec.optimizer_options) or spec.optimizer_options,
        problem=known.told_name(spec.problem),
        optimizer=methods.told_name(spec.optimizer),
    )
    return _bare(named, ending, library_of(optimizer), code_digest(problem, optimizer))


_UNSAID = Library(library="", library_version="")


def _bare(spec: Spec, ending: Ending, library: Library = _UNSAID, code: str = "") -> RunRow:
    failed = "failed" if ending.error_type else "timeout"
    problem, optimizer = name_in_rows(spec.problem), name_in_rows(spec.optimizer)
    keys = (
        [problem, chosen_options(problems.registry, problem, spec.problem_options), ""],
        [optimizer, chosen_options(optimizers.registry, optimizer, spec.optimizer_options)],
    )
    counts = (
        "dimension", "evaluations", "jacobian_evaluations", "charged", "non_finite", "non_finite_slopes",
        "batch_evaluations", "residual_evaluations", "gradient_evaluations", "joint_evaluations", "restarts",
        "best_evaluation",
    )  # fmt: skip
    unknown = (
        "best_x", "parameter_names", "parameter_values", "minimum", "judged_value", "judged_evaluations",
        "outside_evaluations", "parameter_units", "parameter_starts", "parameter_truths", "chance",
    )  # fmt: skip
    blank: dict[str, Any] = {**dict.fromkeys(counts, 0), **dict.fromkeys(unknown), **NO_MERIT}
    return RunRow(
        run_id=run_id(*keys, spec.budget, spec.repetition, preferred_start(None, spec.start), spec.target),
        study="", problem=problem, optimizer=optimizer, data_id="", **blank,
        problem_options=canonical(spec.problem_options), optimizer_options=canonical(spec.optimizer_options),
        **library, repetition=spec.repetition, seed="", start=spec.start or "", budget=spec.budget, target=spec.target,
        status=failed, stop_reason=failed, error_type=ending.error_type, error=ending.error, best_value=float("inf"),
        inside_box=False, at_bound=[], targets=[], hits=[],
        hits_charged=[], wall_s=ending.wall_s, cpu_s=ending.cpu_s, started_at=datetime.now(UTC),
        schema_version=SCHEMA_VERSION, code_digest=code, traceback=ending.traceback, unit="", problem_group="",
        tampering="", process_changes=[], **provenance(),
    )  # fmt: skip


def name_in_rows(name: str) -> str:
    """Return what rows call a problem or an optimiser: a class of a user's file has no path of this machine."""
    if not user_file.is_file_path(name):
        return name
    return f"{user_file.told_name(user_file.place_of(name))}:{name.rpartition(':')[2]}"
