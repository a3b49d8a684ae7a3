"""How to look for it: optimisers behind one face, which know no problem and no budget.

>>> from calibench import optimizers
>>> optimizers.make("de", population=40).traits.minimum_budget
40
"""

from calibench._checkout import one_module
from calibench.optimizers import (  # noqa: F401  (they register themselves)
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
from calibench.optimizers.base import (
    BudgetExhausted,
    Objective,
    Optimizer,
    Stop,
    TargetReached,
    TimeUp,
    Traits,
    registry,
)

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

one_module(__name__)
