"""The traits that `de`, `ga` and `pso` share: each begins with a random population in the box, whatever the start."""

from __future__ import annotations

from calibench.optimizers.base import Traits


def population_traits(population: int) -> Traits:
    """Return the traits of a method whose first sample is `population` random points of the box."""
    return Traits(
        stochastic=True,
        uses_start=False,
        minimum_budget=population,
        needs_finite_bounds=True,
        batches=True,
    )
