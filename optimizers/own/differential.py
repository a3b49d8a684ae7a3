"""`de`: differential evolution exactly as Cong et al. 2008 state it (section 4.3, settings of 4.4)."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Objective, Reason, Share, registry
from calibench.optimizers.own.population import compile_steps, population_traits


@registry.register("de")
@final
@dataclass(frozen=True)
class DifferentialEvolution:
    """DE/rand/1/bin; parameters that leave the box are drawn anew in it. Ignores the start: its first sample is random.

    `population` is N, `F` the weight of the difference in [0, 2], `CR` the crossover constant in [0, 1].
    `early_abandon` lets the objective stop summing where a trial is no better than its member, so that (48) is decided:
    the same search to the last bit, sooner where the objective can (`Objective.batch_below`).
    """

    population: Annotated[int, Range(4)] = 150  # a member and three others
    F: Annotated[float, Range(0, 2)] = 0.5
    CR: Share = 0.8
    early_abandon: bool = False

    name: ClassVar[str] = "de"

    def __post_init__(self) -> None:
        registry.check("de", vars(self))

    traits = property(population_traits)
    compile = compile_steps

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Breed generations until the objective stops it."""
        from calibench.optimizers.own import _differential_kernels as step
        from calibench.optimizers.own._random_kernels import random_state

        state, box = random_state(rng), np.array([objective.lower, objective.upper])
        lower, upper = box
        population = step.initialize(self.population, lower, upper, state)
        values, trial = np.array(objective.batch(population)), np.empty_like(population)
        while True:
            step.propose(population, self.F, self.CR, lower, upper, state, trial)
            trial_values = objective.batch_below(trial, values) if self.early_abandon else objective.batch(trial)
            step.select(population, values, trial, trial_values)
