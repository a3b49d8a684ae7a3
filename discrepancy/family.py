"""Kept for scripts that import from here: the names are those of `discrepancy`."""

from calibench.discrepancy.model.effect import Cause, needs, number

__all__ = ["Cause", "needs", "number"]
