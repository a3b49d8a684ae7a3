"""Kept for scripts that import from here: the names are those of `discrepancy`."""

from calibench.discrepancy.model.effect import Effect, NotTestable

__all__ = ["Effect", "NotTestable"]
