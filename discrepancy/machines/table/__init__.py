"""A table of columns and a regression y = f(x; p): any function may be the base model; the search finds what it lacks.

`formulation` prepares the columns and makes a function that is known by name, or the user's own, into a prediction;
`effects` are those of a table alone.
"""

from calibench.discrepancy.machines.table import effects as effects
from calibench.discrepancy.machines.table.formulation import Table

__all__ = ["Table"]
