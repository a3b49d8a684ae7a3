"""How to look for it: optimisers behind one face, which know no problem and no budget.

>>> from calibench import optimizers
>>> optimizers.make("de", population=40).traits.minimum_budget
40
"""

from calibench._checkout import one_module
from calibench.optimizers import fmincon, least_squares, nlopt, own, pygmo  # noqa: F401  (they register themselves)
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
