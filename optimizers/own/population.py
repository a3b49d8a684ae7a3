"""What `de`, `ga` and `pso` share: their traits, and the short run that compiles their steps before a clock starts.

Each stands in a file of its own, so that a change of one changes the digest of no other's code.
"""

from contextlib import suppress
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from calibench.optimizers.base import Array, Optimizer, Stop, Traits

_BATCHES = 5  # of a rehearsal


def population_traits(method: Any) -> Traits:
    """Return the traits of a method whose first sample is its `population` of random points of the box."""
    first: int = method.population
    return Traits(stochastic=True, uses_start=False, minimum_budget=first, needs_finite_bounds=True, batches=True)


@cache
def compile_steps(method: Any) -> None:
    """Compile the steps of a method by a run of few members that begin again at once, once in a process."""
    few = {"population": 4, "NR": 1}
    _rehearse(replace(method, **{name: number for name, number in few.items() if name in vars(method)}))


@cache
def _rehearse(optimizer: Optimizer) -> None:
    """Run some batches of zeros on the unit square, once in a process: a user's class is built anew for every run."""
    # with the types of a run, as numba compiles anew for as little as a read-only array
    lower, upper = np.zeros(2), np.ones(2)
    for bounds in (lower, upper):
        bounds.flags.writeable = False  # as the gate's are
    batches = iter(range(_BATCHES))

    def batch(points: Array, _limits: Array | None = None) -> Array:
        if next(batches, None) is None:
            raise Stop
        return np.zeros(len(points))

    flat: Any = SimpleNamespace(
        lower=lower, upper=upper, start=lower, dimension=2, remaining=1000, batch=batch, batch_below=batch
    )
    with suppress(Stop):
        optimizer.minimize(flat, np.random.default_rng(0))
