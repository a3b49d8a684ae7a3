"""`de`, `ga` and `pso` exactly as Cong et al. 2008 state them (sections 4.1 to 4.3, settings of 4.4).

Each begins with a random population in the box. The steps are compiled (`_differential_kernels` and so on), a method's
loop is its `minimize`. Where the paper leaves a word open there is an option, and its default is said below.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from math import ceil, inf, log2
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.optimizers.base import Array, Objective, Reason, Stop, Traits, registry

_BATCHES = 5  # of a rehearsal
_LONGEST = 53  # bits of a parameter that a double holds exactly
_ROWS = 16  # in which the box is written down: a multiple of any vector's width


@dataclass(frozen=True)
class _Population:
    """A method whose first sample is `population` random points of the box; `_short_run` are options of a short run."""

    population: int

    _short_run: ClassVar[Mapping[str, Any]] = {"population": 4, "NR": 1}

    @property
    def traits(self) -> Traits:
        """Return the traits; the first sample is one population."""
        return Traits(
            stochastic=True, uses_start=False, minimum_budget=self.population, needs_finite_bounds=True, batches=True
        )

    def compile(self) -> None:
        """Compile (or load from the cache) the steps, so that no clock sees it: run some batches on the unit square."""
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
            replace(self, **self._short_run).minimize(flat, np.random.default_rng(0))

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Search until the objective stops it."""
        raise NotImplementedError


@registry.register("de")
@final
@dataclass(frozen=True)
class DifferentialEvolution(_Population):
    """DE/rand/1/bin; parameters that leave the box are drawn anew in it. Ignores the start: its first sample is random.

    `population` is N, `F` the weight of the difference in [0, 2], `CR` the crossover constant in [0, 1].
    `early_abandon` lets the objective stop summing where a trial is no better than its member, so that (48) is decided:
    the same search to the last bit, sooner where the objective can (`Objective.batch_below`).
    """

    population: int = 150
    F: float = 0.5
    CR: float = 0.8
    early_abandon: bool = False

    name: ClassVar[str] = "de"
    _short_run: ClassVar[Mapping[str, Any]] = {"population": 4}

    def __post_init__(self) -> None:
        if self.population < 4:
            raise ValueError(f"de.population={self.population}: a member and three others are needed, so 4 or more")
        if not 0 <= self.F <= 2:
            raise ValueError(f"de.F={self.F:g}: must lie in 0 .. 2")
        if not 0 <= self.CR <= 1:
            raise ValueError(f"de.CR={self.CR:g}: must lie in 0 .. 1")

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Breed generations until the objective stops it."""
        from calibench.optimizers.own import _differential_kernels as step
        from calibench.optimizers.own._random_kernels import random_state

        state, lower, upper = random_state(rng), objective.lower, objective.upper
        size = self.population
        room = np.empty((2 * size + 2, objective.dimension))
        population, trial, room[-2], room[-1] = room[:size], room[size:-2], lower, upper
        population[:] = step.initialize(size, lower, upper, state)
        values = np.array(objective.batch(population))
        step.propose(population, self.F, self.CR, room[-2], room[-1], state, trial)
        while True:
            trial_values = objective.batch_below(trial, values) if self.early_abandon else objective.batch(trial)
            step.advance(room, values, trial_values, self.F, self.CR, state)


@registry.register("ga")
@final
@dataclass(frozen=True)
class GeneticAlgorithm(_Population):
    """Tournaments, one-point crossover and two-bit mutation of strings. Ignores the start: its first sample is random.

    As stated: `population` is N; a parameter has L = ceil(log2(width / `precision`)) bits, the precision in mm and rad
    alike; `tournament` is the number of individuals in one; `PCrossover` and `PMutation` are probabilities; the best
    individual is maintained, and evaluated once; after `NR` generations without an improvement, half the individuals
    except it begin again. As read, where the paper does not say:

    - `rivals`: those of a tournament are drawn with replacement (any), or are distinct.
    - `mutation_per`: two bits of an individual flip with PMutation, or two of each parameter's, or each bit does.
    - `crossover`: a pair has one crossing point in its whole string, or one in each parameter's.
    - `coding`: the string of a parameter is a binary number, or a Gray code.
    - `improvement`: the population improves where its best does, or where its mean since the last renewal does.
    - `renewal`: the half that begins again is a random one, or the worst.
    """

    population: int = 100
    precision: float = 1e-4
    tournament: int = 4
    PCrossover: float = 0.85
    PMutation: float = 0.15
    NR: int = 50
    rivals: Literal["any", "distinct"] = "any"
    mutation_per: Literal["individual", "parameter", "bit"] = "individual"
    crossover: Literal["string", "parameter"] = "string"
    coding: Literal["binary", "gray"] = "binary"
    improvement: Literal["best", "mean"] = "best"
    renewal: Literal["random", "worst"] = "random"

    name: ClassVar[str] = "ga"

    def __post_init__(self) -> None:
        registry.check("ga", vars(self))
        if self.population < 2:
            raise ValueError(f"ga.population={self.population}: a pair is needed to cross, so 2 or more")
        if self.precision <= 0:
            raise ValueError(f"ga.precision={self.precision:g}: must be above 0")
        if self.tournament < 1:
            raise ValueError(f"ga.tournament={self.tournament}: must be 1 or more")
        if self.rivals == "distinct" and self.tournament > self.population:
            rule = f"there are {self.population} distinct rivals; or rivals=any"
            raise ValueError(f"ga.tournament={self.tournament}: {rule}")
        for key, probability in (("PCrossover", self.PCrossover), ("PMutation", self.PMutation)):
            if not 0 <= probability <= 1:
                raise ValueError(f"ga.{key}={probability:g}: must lie in 0 .. 1")
        if self.NR < 1:
            raise ValueError(f"ga.NR={self.NR}: must be 1 or more")

    def lengths(self, width: Array) -> NDArray[np.int64]:
        """Return the bits of each parameter, shape (dim,), at least one: L = ceil(log2(width / precision))."""
        if not np.isfinite(width).all():
            raise ValueError("ga searches a box: all bounds must be finite")
        bits = [ceil(log2(w / self.precision)) if w > self.precision else 1 for w in width.tolist()]
        if max(bits) > _LONGEST:
            raise ValueError(
                f"ga.precision={self.precision:g}: a parameter of width {width.max():g} would take {max(bits)} bits, "
                f"{_LONGEST} are the most; take a larger precision"
            )
        return np.array(bits, dtype=np.int64)

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Breed generations until the objective stops it."""
        from calibench.optimizers.own import _genetic_kernels as step
        from calibench.optimizers.own._random_kernels import random_state

        state, lower, upper = random_state(rng), objective.lower, objective.upper
        lengths, gray = self.lengths(upper - lower), self.coding == "gray"
        size, dim = self.population, objective.dimension
        words, values = np.empty((2, size, dim), dtype=np.int64), np.empty(size)
        box = step.scales(lower, upper, lengths, min(size, _ROWS))
        room = np.concatenate([np.empty((size, dim)), box.reshape(-1, dim)])
        asked = room[:size]
        memory = np.concatenate([np.zeros(step.HEAD, dtype=np.int64), lengths, np.zeros(size, dtype=np.int64)])
        mean = self.improvement == "mean"
        rules = np.array([
            inf, self.tournament, self.rivals == "distinct", self.PCrossover, self.crossover == "parameter",
            self.PMutation, ("individual", "parameter", "bit").index(self.mutation_per), gray, self.NR,
            self.renewal == "worst", mean,
        ], dtype=float)  # fmt: skip
        step.randomize(np.arange(size), words[0], lengths, state)
        step.decode(words[0], gray, lengths, box, asked)
        memory[step.STILL] = -1  # whatever the first sample is worth, it is no generation without an improvement
        points = asked
        while True:
            found = objective.batch(points)
            if mean:  # as NumPy adds, in pairs
                step.receive(values, found, memory)
                count = step.proceed(words, room, values, values.mean(), memory, rules, state)
            else:
                count = step.advance(words, room, values, found, memory, rules, state)
            if count != len(points):
                points = asked[:count]


@registry.register("pso")
@final
@dataclass(frozen=True)
class ParticleSwarm(_Population):
    """Particles drawn to their own best place and the swarm's, eq. (45). Ignores the start: its first sample is random.

    As stated: `population` is N, `C1` and `C2` the acceleration constants; the inertia weight falls linearly from
    `w_first` to `w_last`; after `NR` iterations without an improvement half the particles, never the best, begin again.
    As read, where the paper does not say:

    - `w_iterations`: w falls over so many iterations and then stays, or over those that the budget at the start allows,
      so that another budget is another search.
    - `random_per`: R1 and R2 are drawn for each component, or one pair for each particle.
    - `velocity_limit`: no limit, or the largest velocity in widths of the box.
    - `initial_velocity`: random, up to the width of the box each way, or zero.
    - `border`: a particle placed on the border keeps its velocity there, or has none (in the component that left).
    - `improvement`: the population improves where G_best does, or where any P_best does.
    - `renewal`: the half that begins again is a random one, or that of the worst P_best.
    - `renewal_forgets`: who begins again forgets its P_best.

    `early_abandon` lets the objective stop summing where a place is no better than the particle's P_best: the same
    search to the last bit, sooner where the objective can (`Objective.batch_below`).
    """

    population: int = 100
    C1: float = 2.0
    C2: float = 2.0
    w_first: float = 0.9
    w_last: float = 0.1
    NR: int = 50
    w_iterations: int | None = None
    random_per: Literal["component", "particle"] = "component"
    velocity_limit: float | None = None
    initial_velocity: Literal["random", "zero"] = "random"
    border: Literal["keep", "zero"] = "keep"
    improvement: Literal["best", "any"] = "best"
    renewal: Literal["random", "worst"] = "random"
    renewal_forgets: bool = True
    early_abandon: bool = False

    name: ClassVar[str] = "pso"

    def __post_init__(self) -> None:
        registry.check("pso", vars(self))
        if self.population < 2:
            raise ValueError(f"pso.population={self.population}: a swarm has 2 or more")
        for key, weight in (("C1", self.C1), ("C2", self.C2)):
            if weight < 0:
                raise ValueError(f"pso.{key}={weight:g}: must be 0 or more")
        for key, weight in (("w_first", self.w_first), ("w_last", self.w_last)):
            if not 0 <= weight <= 1:
                raise ValueError(f"pso.{key}={weight:g}: must lie in 0 .. 1")
        if self.NR < 1:
            raise ValueError(f"pso.NR={self.NR}: must be 1 or more")
        if self.w_iterations is not None and self.w_iterations < 1:
            rule = "must be 1 or more, or null for those of the budget"
            raise ValueError(f"pso.w_iterations={self.w_iterations}: {rule}")
        if self.velocity_limit is not None and self.velocity_limit <= 0:
            raise ValueError(f"pso.velocity_limit={self.velocity_limit:g}: must be above 0, or null for no limit")

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Fly until the objective stops it."""
        from calibench.optimizers.own import _swarm_kernels as step
        from calibench.optimizers.own._random_kernels import random_state

        state, lower, upper = random_state(rng), objective.lower, objective.upper
        width = upper - lower
        flights = self.w_iterations or -(-objective.remaining // self.population) - 1  # the first sample is no flight
        limit = inf if self.velocity_limit is None else self.velocity_limit
        room = np.empty((7, self.population, objective.dimension))
        position, velocity, own_best = room[0], room[1], room[2]
        room[4], room[5], room[6] = inf if limit == inf else limit * width, lower, upper
        own_values, memory = np.full(self.population, inf), np.zeros(3, dtype=np.int64)
        moving = self.initial_velocity == "random"
        step.place(np.arange(self.population), position, velocity, moving, lower, upper, state)
        own_best[:], room[3] = position, position[0]
        rules = np.array([
            self.w_first, self.w_last, flights, self.C1, self.C2, self.random_per == "component",
            self.border == "zero", self.improvement == "any", self.NR, self.renewal == "worst", moving,
            self.renewal_forgets,
        ], dtype=float)  # fmt: skip
        while True:
            values = objective.batch_below(position, own_values) if self.early_abandon else objective.batch(position)
            step.advance(room, values, own_values, memory, rules, state)
