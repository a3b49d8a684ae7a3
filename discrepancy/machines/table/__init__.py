"""A table of columns and a regression y = f(x; p): any function may be the base model."""

from calibench.discrepancy.machines.table import effects as effects
from calibench.discrepancy.machines.table.formulation import Table

__all__ = ["Table"]
