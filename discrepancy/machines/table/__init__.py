"""A table of columns and a regression y = f(x; p): any function may be the base, and what it misses is looked for.

`models` holds the functions that are known by name, `base` makes one of them, or one's own, into a prediction,
`columns` prepares the columns, `formulation` states what is measured, `effects` is what only a table has, `description`
declares the words.
"""

from __future__ import annotations

from calibench.discrepancy.machines.table import description as description
from calibench.discrepancy.machines.table import effects as effects
from calibench.discrepancy.machines.table.formulation import Table

__all__ = ["Table"]
