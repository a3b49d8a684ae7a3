"""Kept for scripts that import from here: the names are those of `discrepancy`."""

from calibench.discrepancy.model.formulations import Constraints

__all__ = ["Constraints"]
