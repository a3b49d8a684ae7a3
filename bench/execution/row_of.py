"""A finished run as its row: each column of `RunRow` beside its source, and from its end status and reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np

from calibench.bench.execution.answer import Answer, hits_of, merit_of
from calibench.bench.execution.request import Asked
from calibench.bench.execution.run_row import SCHEMA_VERSION, RunRow
from calibench.bench.gate.endings import StopReason, frames_of, text_of
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.time_limit import BEFORE, Ending
from calibench.bench.provenance.environment import provenance
from calibench.core.seeds import digest
from calibench.core.words import counted
from calibench.problems.base import extra_of


def row_of(
    asked: Asked,
    gate: Evaluator,
    answer: Answer,
    ending: Ending,
    began: datetime,
    process_changes: Sequence[str] = (),
) -> RunRow:
    """Return the row: the request, the gate's counts, the meaning of the answer and how the run ended."""
    pair = asked.pair
    hits, hits_charged = hits_of(pair.problem, gate, answer)
    return RunRow(
        run_id=asked.run_id,
        study="",  # known where it is stored
        problem=pair.problem_name,
        problem_options=pair.problem_options,
        data_id=pair.data_id,
        dimension=gate.dimension,
        optimizer=pair.optimizer_name,
        optimizer_options=pair.optimizer_options,
        **pair.library,
        repetition=asked.repetition,
        seed=digest(pair.problem_key, pair.optimizer_key, asked.repetition),
        start=asked.start,
        budget=asked.budget,
        target=asked.target,
        evaluations=gate.evaluations,
        batch_evaluations=gate.batch_evaluations,
        residual_evaluations=gate.residual_evaluations,
        jacobian_evaluations=gate.jacobian_evaluations,
        gradient_evaluations=gate.gradient_evaluations,
        joint_evaluations=gate.joint_evaluations,
        charged=gate.charged,
        non_finite=gate.non_finite,
        outside_evaluations=gate.outside_evaluations,
        restarts=gate.restarts,
        status=status_of(gate, ending),
        stop_reason=stop_reason_of(gate, ending),
        error_type=ending.error_type,
        error=ending.error,
        traceback=ending.traceback,
        tampering="; ".join(gate.attempts),
        process_changes=list(process_changes),
        best_value=gate.best_value,
        best_evaluation=gate.best_evaluation,
        best_x=None if gate.best_x is None else gate.best_x.tolist(),
        inside_box=answer.inside_box,
        at_bound=answer.at_bound,
        parameter_names=answer.parameter_names,
        parameter_values=answer.parameter_values,
        parameter_units=answer.parameter_units,
        parameter_starts=answer.parameter_starts,
        parameter_truths=answer.parameter_truths,
        **answer.merit.columns,
        merit=answer.merit.others,
        judged_value=answer.judged.value,
        judged_evaluations=answer.judged.evaluations,
        targets=gate.targets,
        hits=hits,
        hits_charged=hits_charged,
        unit=pair.unit,
        minimum=pair.minimum,
        problem_group=pair.problem_group,
        chance=asked.can_differ,
        wall_s=ending.wall_s,
        cpu_s=ending.cpu_s,
        started_at=began,
        non_finite_slopes=gate.non_finite_slopes,
        code_digest=pair.code,
        schema_version=SCHEMA_VERSION,
        **provenance(),
    )


def compile_parts(problem: Any, optimizer: Any) -> Ending | None:
    """Do the work that is not timed; return the ending of a run whose problem or optimiser fails in it."""
    for compile_part in (partial(compile_problem, problem, optimizer), getattr(optimizer, "compile", None)):
        try:
            if compile_part is not None:
                compile_part()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit too
            said = f"{BEFORE}{text_of(error)}"
            return Ending(type(error).__name__, said, 0.0, 0.0, frames_of(error))
    return None


def compile_problem(problem: Any, *optimizers: Any) -> None:
    """Compile what `optimizers` will call; of a problem with `compile_values` the values alone, if they ask no more."""
    traits = [getattr(optimizer, "traits", None) for optimizer in optimizers]
    asked = [getattr(one, trait, True) for one in traits for trait in ("uses_residuals", "uses_gradient")]
    if not any(asked) and extra_of(problem, "compile_values"):
        problem.compile_values()
    elif extra_of(problem, "compile"):
        problem.compile()


def check_merit(problem: Any) -> Ending | None:
    """Return the ending of a run whose ``merit(x)`` returns what no row can hold, seen at the start; None otherwise.

    It would fail when the budget is spent. What merit raises itself is left to the answer: it may need one.
    """
    if not extra_of(problem, "merit"):
        return None
    try:
        found = problem.merit(np.array(problem.start, dtype=float))
    except KeyboardInterrupt:
        raise
    except BaseException:
        return None
    try:
        merit_of(found)
    except TypeError as error:
        return Ending(type(error).__name__, f"{BEFORE}{error}", 0.0, 0.0)
    return None


def with_an_answer(gate: Evaluator, ending: Ending) -> Ending:
    """Return the ending: a failure where nothing was asked, no value was finite, or the last slopes were not.

    The last: a search that ends by itself by a Jacobian with slopes that were read as 0 has found no minimum.
    """
    if ending.error_type or gate.stopped == "timeout":
        return ending
    if gate.charged == 0:
        why = f": the budget of {gate.budget} is below its first step" if gate.stopped == "budget" else ""
        return replace(ending, error_type="NoEvaluation", error=f"the optimizer made no evaluation{why}")
    if gate.best_x is None:
        said = f"none of {gate.evaluations} values was finite" if gate.evaluations else "no value was asked for"
        return replace(ending, error_type="NoFiniteValue", error=said)
    if gate.unknown_slopes and stop_reason_of(gate, ending) == "converged":
        slopes = counted(gate.unknown_slopes, "slope")
        said = f"it stopped by itself where its last Jacobian had {slopes} not finite, read as 0: that is no minimum"
        return replace(ending, error_type="NonFiniteSlopes", error=said)
    return ending


def status_of(gate: Evaluator, ending: Ending) -> str:
    """Return failed, timeout or ok."""
    if ending.error_type:
        return "failed"
    return "timeout" if gate.stopped == "timeout" else "ok"


def stop_reason_of(gate: Evaluator, ending: Ending) -> StopReason:
    """Return failed, or the reason for the end: timeout, target, budget, or converged with budget left."""
    if ending.error_type:
        return "failed"
    return gate.stopped or ("budget" if gate.remaining <= 0 else "converged")
