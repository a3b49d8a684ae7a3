"""`pso`: the particle swarm of Cong et al. 2008 (section 4.2, settings of 4.4); an option for each word left open."""

from dataclasses import dataclass
from math import inf
from typing import Annotated, ClassVar, Literal, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Count, CountOrNull, Objective, Reason, Share, registry
from calibench.optimizers.own.population import compile_steps, population_traits


@registry.register("pso")
@final
@dataclass(frozen=True)
class ParticleSwarm:
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

    population: Annotated[int, Range(2)] = 100
    C1: Annotated[float, Range(0)] = 2.0
    C2: Annotated[float, Range(0)] = 2.0
    w_first: Share = 0.9
    w_last: Share = 0.1
    NR: Count = 50
    w_iterations: CountOrNull = None
    random_per: Literal["component", "particle"] = "component"
    velocity_limit: Annotated[float | None, Range(0, above=True)] = None
    initial_velocity: Literal["random", "zero"] = "random"
    border: Literal["keep", "zero"] = "keep"
    improvement: Literal["best", "any"] = "best"
    renewal: Literal["random", "worst"] = "random"
    renewal_forgets: bool = True
    early_abandon: bool = False

    name: ClassVar[str] = "pso"

    def __post_init__(self) -> None:
        registry.check("pso", vars(self))

    traits = property(population_traits)
    compile = compile_steps

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
