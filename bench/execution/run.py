"""One run: a problem, an optimiser, a budget and a repetition make one row, whatever happens.

Converged, exhausted, on target or crashed: the row says which. Compilation happens before the clock starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench import optimizers, problems
from calibench.bench.execution.answer import answer_of, hits_of
from calibench.bench.execution.code_digest import code_digest, library_of
from calibench.bench.execution.evaluator import Evaluator, TracePoint
from calibench.bench.execution.frames import frames_of
from calibench.bench.execution.own_problem import minimum_of, unit_of
from calibench.bench.execution.provenance import provenance
from calibench.bench.execution.request import Array, Start, check_request, starting_point
from calibench.bench.execution.run_id import (
    canonical,
    digest,
    key_of_optimizer,
    key_of_problem,
    name_of,
    options_of,
    run_id,
    seed_sequence,
)
from calibench.bench.execution.run_row import SCHEMA_VERSION, RunRow
from calibench.bench.execution.stochastic import seeded
from calibench.bench.execution.time_limit import QUIET, Ending, run_here, run_watched, text_of

if TYPE_CHECKING:
    import pandas as pd


@final
@dataclass(frozen=True)
class Spec:
    """What a run is, in values: enough to do it anywhere, and to know whether it has been done.

    Options are those given; names are those of the registries, ``pkg.module:Class`` or ``/place/of/file.py:Class``,
    as a process anywhere finds them. `time_limit` is no part
    of what a run is: its id does not hold it, and a run that ends in time is the same to the last bit.
    """

    problem: str
    problem_options: Mapping[str, Any]
    optimizer: str
    optimizer_options: Mapping[str, Any]
    budget: int
    repetition: int
    start: Start | None = None
    target: float | None = None
    time_limit: float | None = None

    def execute(self) -> Run:
        """Build problem and optimiser and run them."""
        return execute(
            problems.make(self.problem, **self.problem_options),
            optimizers.make(self.optimizer, **self.optimizer_options),
            budget=self.budget,
            seed=self.repetition,
            start=self.start,
            target=self.target,
            time_limit=self.time_limit,
        )


@final
@dataclass(frozen=True, eq=False)
class Run:
    """What came of a run: its row of ``runs.parquet``, the study still to be said, and the points of its trace."""

    record: RunRow
    points: tuple[TracePoint, ...]

    @property
    def row(self) -> dict[str, Any]:
        """Return the row by the names of its columns."""
        return vars(self.record).copy()

    @property
    def run_id(self) -> str:
        """Return the id that names this run: a digest of what it is."""
        return self.record.run_id

    @property
    def best_x(self) -> Array | None:
        """Return the best point found, shape (dim,); None where no finite value was."""
        return None if self.record.best_x is None else np.array(self.record.best_x)

    @property
    def best_value(self) -> float:
        """Return the best value found; infinite where no finite value was."""
        return self.record.best_value

    @property
    def evaluations(self) -> int:
        """Return the number of evaluations."""
        return self.record.evaluations

    @property
    def charged(self) -> int:
        """Return evaluations and `dimension` for each Jacobian."""
        return self.record.charged

    @property
    def status(self) -> str:
        """Return ok, failed or timeout."""
        return self.record.status

    @property
    def stop_reason(self) -> str:
        """Return converged, budget, target, failed or timeout."""
        return self.record.stop_reason

    @property
    def trace(self) -> pd.DataFrame:
        """Return the best value over evaluations: columns evaluations, charged, best_value, restart."""
        import pandas as pd

        return pd.DataFrame(self.points, columns=["evaluations", "charged", "best_value", "restart"])


def execute(
    problem: Any,
    optimizer: Any,
    budget: int,
    seed: int = 0,
    *,
    start: Start | Array | None = None,
    target: float | None = None,
    problem_name: str | None = None,
    optimizer_name: str | None = None,
    time_limit: float | None = None,
) -> Run:
    """Minimise `problem` with `optimizer` within `budget` evaluations; `seed` is the repetition.

    `problem` is any object with `lower`, `upper`, `start` and a call. `start` is "nominal" (the problem's own),
    "random" (uniform in the box, the same for all optimisers), or a point; by default what the problem prefers.
    `time_limit` [s] ends it, as a row of status timeout with all that was found until then; the run then lives in a
    forked child, so that what loops in C ends too, and what the problem changes in memory is not seen here. An
    optimiser that may hang always runs so, and is ended after a minute without an evaluation.
    Raises `ValueError` for a request that makes no sense; a run that has begun never raises, its row tells.
    """
    check_request(problem, optimizer, budget, seed, target, time_limit)
    budget, seed, target = int(budget), int(seed), None if target is None else float(target)
    who = name_of(problem) if problem_name is None else problem_name
    method = name_of(optimizer) if optimizer_name is None else optimizer_name
    problem_options, optimizer_options = options_of(problem), options_of(optimizer)
    problem_key, optimizer_key = key_of_problem(problem, who), key_of_optimizer(optimizer, method)
    label, first = starting_point(problem, start, problem_key, seed)
    rng = np.random.default_rng(seed_sequence(problem_key, optimizer_key, repetition=seed))
    targets = [*getattr(problem, "targets", ())]
    if target is not None and target not in targets:
        targets.append(target)
    code = code_digest(problem, optimizer)
    broken = _compile(problem, optimizer)
    again = seed_sequence(problem_key, "restart", repetition=seed)  # no part of the optimiser: paired across methods
    asked = seeded(problem, problem_key, seed)
    gate = Evaluator(asked, budget, start=first, target=target, targets=targets, restart_seed=again)
    may_hang = getattr(getattr(optimizer, "traits", None), "may_hang", False)
    began = datetime.now(UTC)
    if broken is not None:
        ending = broken
    elif time_limit is None and not may_hang:
        ending = run_here(optimizer, gate, rng)
    else:
        ending = run_watched(optimizer, gate, rng, time_limit, quiet=QUIET if may_hang else None)
    gate.finish()
    ending = _with_an_answer(gate, ending)
    answer, ending = answer_of(problem, gate.best_x, ending, problem_key, seed)
    hits, hits_charged = hits_of(problem, gate, answer)
    record = RunRow(
        run_id=run_id(problem_key, optimizer_key, budget, seed, label if label != "given" else first, target),
        study="",
        problem=who,
        problem_options=canonical(problem_options),
        data_id=getattr(problem, "data_id", ""),
        dimension=gate.dimension,
        optimizer=method,
        optimizer_options=canonical(optimizer_options),
        **library_of(optimizer),
        repetition=seed,
        seed=digest(problem_key, optimizer_key, seed),
        start=label,
        budget=budget,
        target=target,
        evaluations=gate.evaluations,
        batch_evaluations=gate.batch_evaluations,
        residual_evaluations=gate.residual_evaluations,
        jacobian_evaluations=gate.jacobian_evaluations,
        charged=gate.charged,
        non_finite=gate.non_finite,
        restarts=gate.restarts,
        status="failed" if ending.error_type else "timeout" if gate.stopped == "timeout" else "ok",
        stop_reason="failed" if ending.error_type else gate.stopped or _natural_end(gate),
        error_type=ending.error_type,
        error=ending.error,
        traceback=ending.traceback,
        best_value=gate.best_value,
        best_evaluation=gate.best_evaluation,
        best_x=None if gate.best_x is None else gate.best_x.tolist(),
        inside_box=answer.inside_box,
        at_bound=answer.at_bound,
        parameter_names=answer.parameter_names,
        parameter_values=answer.parameter_values,
        **answer.merit.columns,
        merit=answer.merit.others,
        judged_value=answer.judged.value,
        judged_evaluations=answer.judged.evaluations,
        targets=gate.targets,
        hits=hits,
        hits_charged=hits_charged,
        unit=unit_of(problem),
        minimum=minimum_of(problem),
        wall_s=ending.wall_s,
        cpu_s=ending.cpu_s,
        started_at=began,
        code_digest=code,
        schema_version=SCHEMA_VERSION,
        **provenance(),
    )
    return Run(record, tuple(gate.trace))


def _natural_end(gate: Evaluator) -> str:
    return "budget" if gate.remaining <= 0 else "converged"


def _compile(problem: Any, optimizer: Any) -> Ending | None:
    """Do what should not be timed; return the ending of a run whose problem or optimiser fails in it."""
    for part in (problem, optimizer):
        try:
            if hasattr(part, "compile"):
                part.compile()
        except Exception as error:
            said = f"before the first evaluation: {text_of(error)}"
            return Ending(type(error).__name__, said, 0.0, 0.0, frames_of(error))
    return None


def _with_an_answer(gate: Evaluator, ending: Ending) -> Ending:
    """Return the ending, which is a failure where nothing was asked for, or nothing finite came back."""
    if ending.error_type or gate.stopped == "timeout" or gate.best_x is not None:
        return ending
    if gate.charged == 0:
        why = f": the budget of {gate.budget} is below its first step" if gate.stopped == "budget" else ""
        return replace(ending, error_type="NoEvaluation", error=f"the optimizer made no evaluation{why}")
    said = f"none of {gate.evaluations} values was finite" if gate.evaluations else "no value was asked for"
    return replace(ending, error_type="NoFiniteValue", error=said)
