"""The meaning of the best point of a run: its place in the box, physical parameters, merit, judged value."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.execution.merit import Merit, merit_of
from calibench.bench.execution.request.pair import Pair
from calibench.bench.execution.stochastic import Judged, hits_of_the_answer, is_stochastic, judged
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.frames import frames_of
from calibench.bench.gate.time_limit import JUDGING, Ending, text_of
from calibench.core import own_state
from calibench.core.seeds import begin_generators, seed_sequence
from calibench.problems.base import extra_of

Array = NDArray[np.float64]


@final
@dataclass(frozen=True)
class Answer:
    """The best point as the problem reads it; for a run without one all fields are empty."""

    inside_box: bool = False
    at_bound: list[str] = field(default_factory=list)
    parameter_names: list[str] | None = None
    parameter_values: list[float] | None = None
    parameter_units: list[str] | None = None
    parameter_starts: list[float] | None = None
    parameter_truths: list[float | None] | None = None
    merit: Merit = field(default_factory=Merit)
    judged: Judged = field(default_factory=Judged)


def place_of_answer(pair: Pair, x: Array | None) -> Answer:
    """Return what is known of the answer x, shape (dim,), without a call of the problem: its place in the box."""
    return Answer() if x is None else Answer(**_placed(pair, x))


def answer_of(pair: Pair, x: Array | None, ending: Ending, repetition: int) -> tuple[Answer, Ending]:
    """Return what the answer x, shape (dim,), means, and the ending: a failure where the problem fails in judging it.

    The seed of fresh evaluations follows from the problem's key and the `repetition`.
    """
    problem = pair.problem
    known: dict[str, Any] = {}
    if own_state.is_kept():  # a fork begins `random` anew
        begin_generators(seed_sequence(pair.problem_word, "judging", repetition=repetition))
    try:
        if x is not None:
            known |= _read(pair, x)  # kept, whatever the figures of merit do
            if extra_of(problem, "merit"):
                known["merit"] = merit_of(problem.merit(np.array(x)))
        known["judged"] = judged(problem, x, pair.problem_word, repetition)
        return Answer(**known), ending
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        said = f"{JUDGING}{text_of(error)}"
        failed = replace(ending, error_type=type(error).__name__, error=said, traceback=frames_of(error))
        return Answer(**known), ending if ending.error_type else failed


def hits_of(problem: Any, gate: Evaluator, answer: Answer) -> tuple[list[int | None], list[int | None]]:
    """Return what each target cost, in evaluations and charged: as the gate saw it, or by the answer where noisy."""
    if not is_stochastic(problem):
        return gate.hits, gate.hits_charged
    value = answer.judged.value
    return hits_of_the_answer(gate, np.inf if value is None else value)


def _read(pair: Pair, x: Array) -> dict[str, Any]:
    problem, parameters = pair.problem, pair.parameters
    values = np.asarray(problem.physical(x) if extra_of(problem, "physical") else x, float)
    if values.shape != (len(parameters),):
        raise TypeError(f"physical(x) returned shape {values.shape} for {len(parameters)} parameters")
    read = {"parameter_names": [each.name for each in parameters], "parameter_values": values.tolist()}
    return {**_placed(pair, x), **read, **_declared(pair)}


def _declared(pair: Pair) -> dict[str, Any]:
    """Return what the problem says of its parameters, so that who reads the row need not build the problem."""
    if getattr(pair.problem, "parameters", None) is None:
        return {}
    return {
        "parameter_units": [each.unit for each in pair.parameters],
        "parameter_starts": [float(each.start) for each in pair.parameters],
        "parameter_truths": [None if each.true is None else float(each.true) for each in pair.parameters],
    }


def _placed(pair: Pair, x: Array) -> dict[str, Any]:
    """Return the place of x in the box: everything that needs no call of the problem."""
    lower, upper, above_lower, below_upper = pair.box
    at_bound = (x <= above_lower) | (x >= below_upper)
    return {
        "inside_box": bool(((lower <= x) & (x <= upper)).all()),
        "at_bound": [name for name, at in zip(pair.coordinate_names, at_bound, strict=True) if at],
    }
