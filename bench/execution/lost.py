"""The row of a run whose process ended outside the gate."""

from __future__ import annotations

from datetime import UTC, datetime

from calibench import optimizers, problems
from calibench.bench.execution.answer import Answer
from calibench.bench.execution.asked import read_asked
from calibench.bench.execution.row_of import row_of
from calibench.bench.execution.run import Run, Spec
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.time_limit import Ending
from calibench.bench.provenance.code_digest import code_digest


def lost_run(spec: Spec, run_id: str, error_type: str, error: str, status: str = "failed") -> Run:
    """Return the run as a row without an answer."""
    problem = problems.make(spec.problem, **spec.problem_options)
    optimizer = optimizers.make(spec.optimizer, **spec.optimizer_options)
    asked = read_asked(
        problem, optimizer, spec.budget, spec.repetition, start=spec.start, target=spec.target, problem_name=None,
        optimizer_name=None, time_limit=None,
    )  # fmt: skip
    gate, ending = Evaluator(problem, spec.budget), Ending(error_type, error, 0.0, 0.0)
    return Run(row_of(asked, gate, Answer(), ending, datetime.now(UTC), code_digest(problem, optimizer)), ())
