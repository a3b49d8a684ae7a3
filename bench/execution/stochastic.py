"""Problems whose values are noisy: the noise of a run comes from its repetition, and its answer is judged apart.

A problem that says ``stochastic = True`` draws its noise from ``self.rng``, or has ``seeded(rng)``. Every run works on
a copy with a generator seeded by problem and repetition alone. The lowest value that a run has seen is lucky: the
answer is judged by ``noise_free(x)``, or by the mean of `FRESH` evaluations that no budget pays.
"""

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
    return _with_generator(problem, np.random.default_rng(seed_sequence(key, "noise", repetition=repetition)))


@final
@dataclass(frozen=True)
class Judged:
    """The answer's value without noise and the fresh evaluations that gave it (0: exact); None: nothing is noisy."""

    value: float | None = None
    evaluations: int | None = None


def judged(problem: Any, x: Array | None, key: Any, repetition: int) -> Judged:
    """Return the value of the answer `x` from evaluations of its own; infinite where one of them is not finite."""
    if not is_stochastic(problem) or x is None:
        return Judged()
    known = getattr(problem, "noise_free", None)
    if known is not None:
        value = float(known(np.array(x)))
        return Judged(value if np.isfinite(value) else float("inf"), 0)
    rng = np.random.default_rng(seed_sequence(key, "judge", repetition=repetition))
    gate = Evaluator(_with_generator(problem, rng), FRESH)
    return Judged(float(np.mean([gate(x) for _ in range(FRESH)])), FRESH)


def _with_generator(problem: Any, rng: np.random.Generator) -> Any:
    own = getattr(problem, "seeded", None)
    if own is None:
        twin = copy.copy(problem)
        object.__setattr__(twin, "rng", rng)  # also where the class is a frozen dataclass
        return twin
    twin = own(rng)
    if twin is problem or not callable(twin) or not all(hasattr(twin, a) for a in ("lower", "upper", "start")):
        raise TypeError("seeded(rng) must return another problem like this one, whose calls draw from rng")
    return twin
