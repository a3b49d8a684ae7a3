"""A table of columns and a regression y = f(x; p): any function may be the base model; the search finds what it lacks.

`models` has the functions that are known by name, `base` makes one of them, or the user's own, into a prediction,
`columns` prepares the columns, `formulation` states what is measured, `effects` are those of a table alone,
`description` declares the words.
"""

from __future__ import annotations

from calibench.discrepancy.machines.table import effects as effects
from calibench.discrepancy.machines.table.formulation import Table

__all__ = ["Table"]
