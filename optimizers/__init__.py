"""How to look for it: optimisers behind one face, which know no problem and no budget.

>>> import optimizers
>>> optimizers.make("de", population=40).traits.minimum_budget
40
"""

from optimizers import (  # noqa: F401  (they register themselves)
    differential,
    fmincon,
    genetic,
    least_squares,
    nine_point,
    nlopt_algorithms,
    pygmo_populations,
    pygmo_trajectories,
    swarm,
)
from optimizers.base import BudgetExhausted, Objective, Optimizer, Stop, TargetReached, TimeUp, Traits, registry

make = registry.make
names = registry.names

__all__ = [
    "BudgetExhausted",
    "Objective",
    "Optimizer",
    "Stop",
    "TargetReached",
    "TimeUp",
    "Traits",
    "make",
    "names",
    "registry",
]
