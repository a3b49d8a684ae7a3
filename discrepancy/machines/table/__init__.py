"""A table of columns and a regression y = f(x; p): any function may be the base model; the search finds what it lacks.

`models` has the functions that are known by name, `formulation` prepares the columns and makes one of them, or the
user's own, into a prediction, `effects` are those of a table alone.
"""

from calibench.discrepancy.machines.table import effects as effects
from calibench.discrepancy.machines.table.formulation import Table

__all__ = ["Table"]
