"""A caller's candidates as a problem takes them: copies of the right type and length, or a `ValueError`."""

from __future__ import annotations

import numpy as np

from calibench.problems.base import Array


def vector(name: str, x: Array, dim: int) -> Array:
    """Return x as an array of shape (dim,) of our own; `name` is the problem's, as the message tells it."""
    own = np.array(x, dtype=np.float64)
    if own.shape != (dim,):
        raise ValueError(f"{name}: x has shape {own.shape}, ({dim},) is needed")
    return own


def vectors(name: str, points: Array, dim: int) -> Array:
    """Return candidates likewise, shape (k, dim)."""
    own = np.array(points, dtype=np.float64, order="C")
    if own.ndim != 2 or own.shape[1] != dim:
        raise ValueError(f"{name}: points have shape {own.shape}, (k, {dim}) is needed")
    return own
