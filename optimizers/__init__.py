"""How to look for it: optimisers behind one face, which know no problem and no budget.

>>> import optimizers
>>> optimizers.make("de", population=40).traits.minimum_budget
40
"""

from optimizers import differential, fmincon, from_nlopt, from_pygmo, least_squares  # noqa: F401  (they register themselves)
from optimizers.base import BudgetExhausted, Objective, Optimizer, Stop, TargetReached, Traits, registry

make = registry.make
names = registry.names

__all__ = [
    "BudgetExhausted",
    "Objective",
    "Optimizer",
    "Stop",
    "TargetReached",
    "Traits",
    "make",
    "names",
    "registry",
]
