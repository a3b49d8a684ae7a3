"""The row of a run whose process ended before the gate could write one; the process that watched it writes the row.

The request of the run is read from its problem and optimiser, built once more in a child process with little time.
Where that ends the child too, only the classes are read; and where even their files cannot be loaded, only the `Spec`.
So there is always a row.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

from calibench import optimizers, problems
from calibench.bench.execution.answer import Answer, Merit
from calibench.bench.execution.request import pair_of, preferred_start, read_asked
from calibench.bench.execution.row_of import row_of
from calibench.bench.execution.run import Run, Spec
from calibench.bench.execution.run_row import SCHEMA_VERSION, RunRow
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.processes import Lost, apart
from calibench.bench.gate.time_limit import Ending
from calibench.bench.provenance.code_digest import Library, code_digest, library_of
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical, chosen_options, options_as_asked, run_id
from calibench.core import user_file

_PATIENCE = 5.0  # seconds for building a problem and an optimiser, and again for looking at their classes
_UNSAID = Library(library="", library_version="")


def lost_run(
    spec: Spec,
    known_id: str,
    error_type: str,
    error: str,
    *,
    timed_out: bool = False,
    wall_s: float = 0.0,
    cpu_s: float = 0.0,
    patience: float = _PATIENCE,
) -> Run:
    """Return the failed run of `spec`: of status timeout where it `timed_out`, else failed with this type and error.

    Its evaluations are not known, so there are none in it. `patience` [s] is given to each of the two looks. Where
    `known_id` is empty it is that of what these looks find.
    """
    ending = Ending("" if timed_out else error_type or "Lost", error, wall_s, cpu_s)
    provenance()  # here, where it is kept, and not in every child
    row = _bare(
        spec=spec,
        ending=ending,
        problem_options={},
        optimizer_options={},
        problem=spec.problem,
        optimizer=spec.optimizer,
        library=_UNSAID,
        code="",
    )
    for look in (_as_built, _as_declared):
        try:
            row = apart(lambda look=look: look(spec, ending), patience)  # type: ignore[misc]
            break
        except Lost:
            continue
    return Run(replace(row, run_id=known_id or row.run_id), ())


def _as_built(spec: Spec, ending: Ending) -> RunRow:
    """Return the row as the run itself would have begun it."""
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
    return _bare(
        spec=spec,
        ending=ending,
        problem_options=options_as_asked(known, spec.problem, spec.problem_options),
        optimizer_options=options_as_asked(methods, spec.optimizer, spec.optimizer_options),
        problem=known.told_name(spec.problem),
        optimizer=methods.told_name(spec.optimizer),
        library=library_of(optimizer),
        code=code_digest(problem, optimizer),
    )


def _bare(
    spec: Spec,
    ending: Ending,
    problem_options: dict[str, object],
    optimizer_options: dict[str, object],
    problem: str,
    optimizer: str,
    library: Library,
    code: str,
) -> RunRow:
    """Return the row of a run of which nothing was built."""
    failed = "failed" if ending.error_type else "timeout"
    keys = (
        [_told(problem), chosen_options(problems.registry, problem, problem_options or spec.problem_options), ""],
        [_told(optimizer), chosen_options(optimizers.registry, optimizer, optimizer_options or spec.optimizer_options)],
    )
    known = run_id(*keys, spec.budget, spec.repetition, preferred_start(None, spec.start), spec.target)
    return RunRow(
        run_id=known, study="", problem=_told(problem), optimizer=_told(optimizer), data_id="", dimension=0,
        problem_options=canonical(problem_options or spec.problem_options),
        optimizer_options=canonical(optimizer_options or spec.optimizer_options),
        library=library["library"], library_version=library["library_version"], repetition=spec.repetition, seed="",
        start=spec.start or "", budget=spec.budget, target=spec.target, evaluations=0, jacobian_evaluations=0,
        charged=0, non_finite=0, non_finite_slopes=0, batch_evaluations=0, residual_evaluations=0,
        gradient_evaluations=0, joint_evaluations=0, restarts=0, status=failed, stop_reason=failed,
        error_type=ending.error_type, error=ending.error, best_value=float("inf"),
        best_evaluation=0, best_x=None, inside_box=False, at_bound=[], parameter_names=None, parameter_values=None,
        **Merit().columns, targets=[], hits=[], hits_charged=[], wall_s=ending.wall_s, cpu_s=ending.cpu_s,
        started_at=datetime.now(UTC), schema_version=SCHEMA_VERSION, code_digest=code, traceback=ending.traceback,
        merit=None, unit="", minimum=None, problem_group="", judged_value=None, judged_evaluations=None,
        outside_evaluations=None, tampering="", parameter_units=None, parameter_starts=None, parameter_truths=None,
        chance=None, process_changes=[], **provenance(),
    )  # fmt: skip


def _told(name: str) -> str:
    """Return what rows call a class of a user's file: no path of this machine."""
    if not user_file.is_file_path(name):
        return name
    return f"{user_file.told_name(user_file.place_of(name))}:{name.rpartition(':')[2]}"
