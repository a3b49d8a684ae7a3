"""What the best point of a run means: its place in the box, its physical parameters, its merit, its judged value."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.execution.merit import Merit, merit_of
from calibench.bench.execution.stochastic import Judged, hits_of_the_answer, is_stochastic, judged
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.frames import frames_of
from calibench.bench.gate.processes.forked_worker import Lost, apart
from calibench.bench.gate.time_limit import Ending, text_of
from calibench.problems.base import coordinates_of, parameters_of

Array = NDArray[np.float64]
PATIENCE = 60.0  # seconds for judging an answer where a run is watched and has no limit of its own
_JUDGING = "in judging the answer: "


@final
@dataclass(frozen=True)
class Answer:
    """The best point as the problem reads it; of a run without one, nothing is inside and nothing is known."""

    inside_box: bool = False
    at_bound: list[str] = field(default_factory=list)
    parameter_names: list[str] | None = None
    parameter_values: list[float] | None = None
    merit: Merit = field(default_factory=Merit)
    judged: Judged = field(default_factory=Judged)


def judged_apart(
    problem: Any, x: Array | None, ending: Ending, key: Any, repetition: int, limit: float | None
) -> tuple[Answer, Ending]:
    """Return what `answer_of` does, found in a child process, so that what the problem does there is a failed row too.

    It has `limit` seconds, or `PATIENCE` where there is none.
    """
    if x is None:
        return Answer(), ending
    try:
        return apart(lambda: answer_of(problem, x, ending, key, repetition), PATIENCE if limit is None else limit)
    except Lost as lost:
        told = replace(ending, error_type=lost.error_type, error=f"{_JUDGING}{lost.error}", traceback=lost.traceback)
        return _placed(problem, x), ending if ending.error_type else told


def answer_of(
    problem: Any, x: Array | None, ending: Ending, key: Any, repetition: int, _limit: float | None = None
) -> tuple[Answer, Ending]:
    """Return what the answer x, shape (dim,), means, and the ending: a failure where the problem fails in judging it.

    `key` names the problem, `repetition` the run: the seed of fresh evaluations follows from both.
    """
    found = Answer()
    try:
        if x is not None:
            found = _read(problem, x)  # kept, whatever the figures of merit do
            if hasattr(problem, "merit"):
                found = replace(found, merit=merit_of(problem.merit(np.array(x))))
        return replace(found, judged=judged(problem, x, key, repetition)), ending
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        said = f"{_JUDGING}{text_of(error)}"
        failed = replace(ending, error_type=type(error).__name__, error=said, traceback=frames_of(error))
        return found, ending if ending.error_type else failed


def hits_of(problem: Any, gate: Evaluator, answer: Answer) -> tuple[list[int | None], list[int | None]]:
    """Return what each target cost, in evaluations and charged: as the gate saw it, or by the answer where noisy."""
    if not is_stochastic(problem):
        return gate.hits, gate.hits_charged
    value = answer.judged.value
    return hits_of_the_answer(gate, np.inf if value is None else value)


def _read(problem: Any, x: Array) -> Answer:
    names = [p.name for p in parameters_of(problem)]
    values = np.asarray(problem.physical(x) if hasattr(problem, "physical") else x, float)
    if values.shape != (len(names),):
        raise TypeError(f"physical(x) returned shape {values.shape} for {len(names)} parameters")
    return replace(_placed(problem, x), parameter_names=names, parameter_values=values.tolist())


def _placed(problem: Any, x: Array) -> Answer:
    """Return where x lies in the box: what can be told without a call of the problem."""
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    names = [c.name for c in coordinates_of(problem)]
    near = 1e-9 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    at_bound = (x <= lower + near) | (x >= upper - near)
    return Answer(
        inside_box=bool(((lower <= x) & (x <= upper)).all()),
        at_bound=[name for name, at in zip(names, at_bound, strict=True) if at],
    )
