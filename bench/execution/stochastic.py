"""Problems whose values are noisy: the noise of a run comes from its repetition, and its answer is judged apart.

A problem that says ``stochastic = True`` draws its noise from ``self.rng``. Every run works on a copy of the problem
with a generator of its own, seeded by problem and repetition alone: the same in any order and in any process, and the
same stream for all optimisers. A problem that keeps its generator elsewhere has ``seeded(rng)``, which returns that
copy.

The lowest value that a run has seen is lucky, so it is no measure of the answer. The answer x is judged by the
problem's ``noise_free(x)``, or else by the mean of `FRESH` evaluations that no budget pays, from a seed of their own.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.gate.evaluator import Evaluator
from calibench.core.seeds import seed_sequence
from calibench.problems.base import extra_of

Array = NDArray[np.float64]
FRESH = 30


def is_stochastic(problem: Any) -> bool:
    """Tell whether the values of `problem` are noisy."""
    return bool(extra_of(problem, "stochastic", False))


def check_stochastic(problem: Any, who: str) -> None:
    """Raise `ValueError` where `stochastic` of `problem` is not a flag, or no generator can be given to it."""
    said = extra_of(problem, "stochastic", False)
    if not isinstance(said, bool | np.bool_):
        raise ValueError(f"problem {who}: stochastic={said!r}: True or False is needed")
    if not said:
        if getattr(problem, "noise_free", None) is not None:
            raise ValueError(f"problem {who}: noise_free(x) is for stochastic = True, and it is not said")
        return
    if not callable(extra_of(problem, "noise_free", float)):
        raise ValueError(f"problem {who}: noise_free is no method: noise_free(x) returns the value without noise")
    try:
        _with_generator(problem, np.random.default_rng(0))
    except Exception as error:
        raise ValueError(f"problem {who}: cannot be given a generator: {type(error).__name__}: {error}") from error


def seeded(problem: Any, key: Any, repetition: int) -> Any:
    """Return `problem`, or where it is noisy its copy with the noise of this repetition; `key` names the problem."""
    if not is_stochastic(problem):
        return problem
    return _with_generator(problem, _generator(key, "noise", repetition))


@final
@dataclass(frozen=True)
class Judged:
    """The answer's value without noise and the fresh evaluations that gave it (0: exact); None: nothing is noisy."""

    value: float | None = None
    evaluations: int | None = None


def judged(problem: Any, x: Array | None, key: Any, repetition: int) -> Judged:
    """Return the value of the answer `x` from evaluations of its own.

    A mean with a value that is not finite is infinite.
    """
    if not is_stochastic(problem) or x is None:
        return Judged()
    known = getattr(problem, "noise_free", None)
    if known is not None:
        value = float(known(np.array(x)))
        return Judged(value if np.isfinite(value) else float("inf"), 0)
    gate = Evaluator(_with_generator(problem, _generator(key, "judge", repetition)), FRESH)
    return Judged(float(np.mean([gate(x) for _ in range(FRESH)])), FRESH)


def hits_of_the_answer(gate: Evaluator, value: float) -> tuple[list[int | None], list[int | None]]:
    """Return the cost of each of the gate's targets, in evaluations and charged, where the judged `value` is within it.

    The lowest value that a run saw may be luck, so it reaches no target. The answer does, at the evaluation that
    proposed it.
    """
    after = next((point for point in gate.trace if point[0] >= gate.best_evaluation), None)
    derivatives = 0 if after is None else after[1] - after[0]
    reached = [value <= level for level in gate.targets]
    return (
        [gate.best_evaluation if hit else None for hit in reached],
        [gate.best_evaluation + derivatives if hit else None for hit in reached],
    )


@final
class _NoTwin(TypeError):
    """What `seeded(rng)` returned cannot be run."""


def _with_generator(problem: Any, rng: np.random.Generator) -> Any:
    own = getattr(problem, "seeded", None)
    if own is None:
        twin = copy.copy(problem)
        object.__setattr__(twin, "rng", rng)  # also where the class is a frozen dataclass
        return twin
    twin = own(rng)
    if twin is problem or not callable(twin) or not all(hasattr(twin, a) for a in ("lower", "upper", "start")):
        raise _NoTwin("seeded(rng) must return another problem like this one, whose calls draw from rng")
    return twin


def _generator(key: Any, purpose: str, repetition: int) -> np.random.Generator:
    return np.random.default_rng(seed_sequence(key, purpose, repetition=repetition))
