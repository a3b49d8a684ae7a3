"""Run one pygmo algorithm through the gate: one problem, one population, one budget.

pygmo owns the loop: it evolves a population of which every member passes our objective. Tolerances are off; a method
that stops all the same begins again with a new population, and the restart stands in the trace. pygmo's own counts are
not used (they miss the differences). Where it can take a generation's values at once, they come from our batch.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import Memoized
from calibench.optimizers.pygmo.population_sizes import RULES, members, most_members

# (the module pygmo, the objective, the number of members) -> pygmo's algorithm object
Build = Callable[[Any, Objective, int], Any]
T = TypeVar("T")


@final
@dataclass(frozen=True)
class Pygmo:
    """One pygmo algorithm with its options, and `build`, which makes pygmo's own object for what is left to spend.

    `from_start`: one member at the start, instead of a random population; the trait `uses_start` is just this.
    `scaled`: the search runs in the unit box and on the value divided by its first size. `stops`: may end by itself;
    then `restarts` decides whether it begins again.
    `batches`: takes the values of a generation at once, which changes no candidate and saves most of the calls.
    The option `population` is a number, or the formula of the rule in `population_sizes` that gives one.
    """

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    algorithm: str
    options: Mapping[str, Any]
    build: Build = field(repr=False, compare=False)
    from_start: bool = False
    scaled: bool = False
    stops: bool = False
    batches: bool = False
    stochastic: bool = True
    uses_gradient: bool = False

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"pygmo_{self.algorithm}"

    @property
    def library(self) -> str:
        """Return the package that does the work."""
        return "pygmo"

    @property
    def traits(self) -> Traits:
        """Return the traits; the first sample is one population, of which a rule gives the most."""
        restarts = self.options.get("restarts", False)
        first, per_dimension = (1, int(self.uses_gradient)) if self.from_start else self._most_members()
        return Traits(
            stochastic=self.stochastic or restarts,
            uses_gradient=self.uses_gradient,
            self_terminating=self.stops and not restarts,
            uses_start=self.from_start,
            minimum_budget=first,
            minimum_budget_per_dimension=per_dimension,
            needs_finite_bounds=True,
            batches=self.batches,
            package="pygmo",
        )

    def members(self, dimension: int, budget: int) -> int:
        """Return the size of the population in `dimension` dimensions with `budget` evaluations left."""
        return 1 if self.from_start else members(self.algorithm, self.options["population"], dimension, budget)

    def _most_members(self) -> tuple[int, int]:
        return most_members(self.algorithm, self.options["population"])

    def compile(self) -> None:
        """Import pygmo, so that no clock sees it."""
        _pygmo()

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Evolve until the objective stops it; what stops by itself begins again, if its options say so."""
        pygmo = _pygmo()

        def evolve(start: Array) -> None:
            size = self.members(objective.dimension, objective.remaining)
            method = self.build(pygmo, objective, size)
            if self.batches:
                method.set_bfe(pygmo.bfe(pygmo.member_bfe()))
            algorithm = pygmo.algorithm(method)
            if algorithm.has_set_seed():
                algorithm.set_seed(int(rng.integers(2**31)))
            fitness = _Fitness(objective, self.scaled, self.uses_gradient)
            try:
                problem, seed = pygmo.problem(fitness), int(rng.integers(2**31))
                if self.from_start:
                    first = pygmo.population(problem, size=0, seed=seed)
                    first.push_back(fitness.inside(start))
                else:
                    first = pygmo.population(problem, size=size, seed=seed)
                algorithm.evolve(first)
            finally:
                caught = fitness.close()
            if caught is not None:  # ipopt swallows what a callback raises
                raise caught

        return with_restarts(evolve, objective, restarts=not self.traits.self_terminating)


class _Fitness:
    """The objective in pygmo's words. pygmo copies its problem; our copy is itself, as the objective's is.

    `caught` is the first exception that came through it, Ctrl-C too, as not every method of pygmo lets it pass.
    """

    def __init__(self, objective: Objective, scaled: bool, has_gradient: bool) -> None:
        self._objective = objective
        self._slope = Memoized(objective, analytic=True, kind="forward") if has_gradient else None
        self._scaled = scaled
        width = objective.upper - objective.lower
        self._width = np.where(width > 0, width, 1.0) if scaled else np.ones(objective.dimension)
        self._origin = objective.lower if scaled else np.zeros(objective.dimension)
        self._size = 0.0
        self.caught: BaseException | None = None

    def close(self) -> BaseException | None:
        """Let all go, as pygmo's objects hold this one unseen by Python; return what was caught."""
        caught = self.caught
        self.__dict__.clear()
        return caught

    def fitness(self, u: Array) -> list[float]:
        return self._ask(self._value, u)

    def batch_fitness(self, flat: Array) -> Array:
        """Return the values of points laid end to end; only where the search is not scaled."""
        return self._ask(self._values, flat)

    def gradient(self, u: Array) -> Array:
        return self._ask(self._gradient, u)

    def _ask(self, function: Callable[[Array], T], u: Array) -> T:
        """Return ``function(u)``, unless something has been raised before."""
        try:
            if self.caught is not None:
                raise self.caught
            return function(u)
        except BaseException as error:
            self.caught = error
            raise

    def _value(self, u: Array) -> list[float]:
        x = self._outside(u)
        value = self._objective(x) if self._slope is None else self._slope.value(x)
        if not self._scaled:
            return [value]
        if not self._size:
            self._size = abs(value) if np.isfinite(value) and value else 1.0
        return [value / self._size]

    def _values(self, flat: Array) -> Array:
        return self._objective.batch(self._outside(flat.reshape(-1, self._objective.dimension)))

    def _gradient(self, u: Array) -> Array:
        assert self._slope is not None
        slope = self._slope.gradient(self._outside(u)) * self._width / (self._size or 1.0)
        return np.nan_to_num(slope, posinf=0.0, neginf=0.0)

    def has_gradient(self) -> bool:
        return self._slope is not None

    def get_bounds(self) -> tuple[Array, Array]:
        return self.inside(self._objective.lower), self.inside(self._objective.upper)

    def inside(self, x: Array) -> Array:
        """Return x in pygmo's coordinates."""
        return (x - self._origin) / self._width if self._scaled else x

    def _outside(self, u: Array) -> Array:
        """Return pygmo's point in ours, never outside the box: some miss it by rounding, ipopt on purpose by 1e-8."""
        x = self._origin + u * self._width if self._scaled else u
        return x.clip(self._objective.lower, self._objective.upper)  # np.clip takes twice as long

    def __copy__(self) -> _Fitness:
        return self

    def __deepcopy__(self, _memo: object) -> _Fitness:
        return self


def evolved(
    algorithm: str,
    population: int | str | None,
    arguments: Mapping[str, Any],
    *,
    least: int,
    fixed: Mapping[str, Any] | None = None,
    batches: bool = False,
    per_generation: Callable[[int], int] = lambda size: size,
    adapt: Callable[[dict[str, Any], int], dict[str, Any]] = lambda options, _size: options,
) -> Pygmo:
    """Return a method that evolves a random population for as long as the budget lasts.

    `population` is a number >= `least`, or the name of the rule of `algorithm`; null is that rule too. `arguments` are
    options of pygmo's constructor, `fixed` those that are not ours to choose, and `adapt` makes what pygmo is given out
    of both once the size is known. `per_generation` is what a generation of a size costs, as some methods plan their
    course by the number of generations.
    """
    population = RULES[algorithm].default if population is None else population
    if isinstance(population, int):
        require(f"pygmo_{algorithm}.population", population, population >= least, f"pygmo asks for {least} or more")

    def build(pygmo: Any, objective: Objective, size: int) -> Any:
        generations = objective.remaining // per_generation(size) + 1
        return getattr(pygmo, algorithm)(gen=generations, **adapt({**arguments, **(fixed or {})}, size))

    return Pygmo(algorithm, {"population": population, **arguments}, build, batches=batches)


def require(option: str, value: Any, holds: bool, rule: str) -> None:
    """Raise `ValueError` with option, value and rule unless the rule `holds`."""
    if not holds:
        raise ValueError(f"{option}={value}: {rule}")


def within(algorithm: str, low: float, high: float, **options: float) -> None:
    """Raise `ValueError` unless each of `options` lies in low .. high."""
    for option, value in options.items():
        require(f"pygmo_{algorithm}.{option}", value, low <= value <= high, f"must lie in {low:g} .. {high:g}")


def _pygmo() -> Any:
    try:
        import pygmo
    except ImportError as error:
        raise ValueError(
            f"pygmo cannot be imported ({error}): its wheels exist for Linux only, here is {sys.platform}; "
            "choose an optimizer that does not begin with pygmo_"
        ) from None
    return pygmo


EXCLUDED = {
    "nlopt": "each of its algorithms stands here under NLopt's own name, nlopt_...",
    "scipy_optimize": "SciPy is called directly here, without a second layer around it",
    "null_algorithm": "it evaluates nothing",
    "cstrs_self_adaptive": "it treats constraints, and a calibration has only its box",
    **dict.fromkeys(
        ("nsga2", "nsga3", "nspso", "moead", "moead_gen", "maco"), "it needs several objectives, and an error is one"
    ),
}
for _name, _reason in EXCLUDED.items():
    registry.exclude(f"pygmo_{_name}", _reason)
