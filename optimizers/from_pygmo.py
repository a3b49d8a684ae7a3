"""pygmo's algorithms, each under its own name: ``pygmo_de`` is pygmo's de.

pygmo owns the loop: it evolves a population of which every member passes our objective. Tolerances are off; a method
that stops all the same begins again with a new population, and the restart stands in the trace.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts


@final
@dataclass(frozen=True)
class Pygmo:
    """One pygmo algorithm: its name, the size of its population, and the arguments of its own constructor."""

    algorithm: str
    population: int
    arguments: Mapping[str, Any]
    least: int

    def __post_init__(self) -> None:
        if self.population < self.least:
            raise ValueError(f"{self.name}.population={self.population}: pygmo asks for {self.least} or more")

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"pygmo_{self.algorithm}"

    @property
    def options(self) -> dict[str, Any]:
        """Return the options as they stand in a row."""
        return {"population": self.population, **self.arguments}

    @property
    def library(self) -> str:
        """Return the package that does the work."""
        return "pygmo"

    @property
    def traits(self) -> Traits:
        """Return the traits; the first sample is one population."""
        return Traits(stochastic=True, minimum_budget=self.population)

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Evolve populations, the first of which ignores the start, until the objective stops it."""
        pygmo = _pygmo()

        def evolve(_start: Array) -> None:
            generations = objective.remaining // self.population + 1
            algorithm = pygmo.algorithm(getattr(pygmo, self.algorithm)(gen=generations, **self._switched_off()))
            if algorithm.has_set_seed():
                algorithm.set_seed(int(rng.integers(2**31)))
            first = pygmo.population(
                pygmo.problem(_Fitness(objective)), size=self.population, seed=int(rng.integers(2**31))
            )
            algorithm.evolve(first)

        return with_restarts(evolve, objective, rng, restarts=True)

    def _switched_off(self) -> dict[str, Any]:
        never = {"de": {"ftol": 0.0, "xtol": 0.0}, "cmaes": {"ftol": 0.0, "xtol": 0.0, "force_bounds": True}}
        return {**self.arguments, **never[self.algorithm]}


class _Fitness:
    """The objective in pygmo's words. pygmo copies its problem; the objective's own copy is itself."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective

    def fitness(self, x: Array) -> list[float]:
        return [self._objective(x)]

    def get_bounds(self) -> tuple[Array, Array]:
        return self._objective.lower, self._objective.upper


def _pygmo() -> Any:
    try:
        import pygmo
    except ImportError as error:
        raise ValueError(
            f"pygmo cannot be imported ({error}): its wheels exist for Linux only, here is {sys.platform}; "
            "choose an optimizer that does not begin with pygmo_"
        ) from None
    return pygmo


@registry.register("pygmo_de")
def pygmo_de(population: int = 150, F: float = 0.8, CR: float = 0.9, variant: int = 2) -> Pygmo:
    """Differential evolution; `variant` 1-10 as pygmo numbers them (2 is rand/1/exp)."""
    if not 1 <= variant <= 10:
        raise ValueError(f"pygmo_de.variant={variant}: must lie in 1 .. 10")
    return Pygmo("de", population, {"F": F, "CR": CR, "variant": variant}, least=5)


@registry.register("pygmo_cmaes")
def pygmo_cmaes(population: int = 50, sigma0: float = 0.5) -> Pygmo:
    """Covariance matrix adaptation; `sigma0` is the first step size in shares of the box."""
    return Pygmo("cmaes", population, {"sigma0": sigma0}, least=5)
