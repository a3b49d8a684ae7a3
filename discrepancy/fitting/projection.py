"""Projection off the Jacobian: remove the part of a signature that calibration absorbs. Data can show only the rest."""

from __future__ import annotations

import numpy as np

from calibench.problems.base import Array


def orthonormal(columns: Array, least: float) -> Array:
    """Return an orthonormal basis (n, m) of the span of `columns`, (n, p), each scaled to length 1.

    Directions whose singular value is not above `least` times the largest are left out.
    """
    lengths = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    return np.asarray(left[:, values > least * values[0]])


def project_off(columns: Array, basis: Array, times: int = 1) -> Array:
    """Return `columns`, (..., n, k) or (n,), less their part in the span of an orthonormal `basis`, (n, p).

    Twice for what the basis all but holds: the second time takes away what rounding left of the first.
    """
    for _ in range(times):
        columns = columns - basis @ (basis.T @ columns)
    return columns
