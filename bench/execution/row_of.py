"""A finished run as its row: each column of `RunRow` beside its source."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from calibench.bench.execution.answer import Answer, hits_of
from calibench.bench.execution.outcome import status_of, stop_reason_of
from calibench.bench.execution.request.asked import Asked
from calibench.bench.execution.run_row import SCHEMA_VERSION, RunRow
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.time_limit import Ending
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import digest


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
