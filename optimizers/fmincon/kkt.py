"""Multipliers and first-order optimality at a point, from the derivatives alone: one formula for both algorithms.

With slacks s >= 0 of the inequalities, lambda solves
    min |g + J_eq^T l_eq + J_in^T l|^2 + |k s * l|^2,  l >= 0,
a non-negative least-squares problem (Lawson and Hanson 1974, ch. 23) once the free l_eq are projected out. At a KKT
point both terms vanish for the true multipliers; near one, no threshold has to say which constraints are active,
whether iterates stand on them (SQP) or approach them from inside (interior point). The weight k = 100 keeps a
constraint with slack .1 from taking more than a hundredth of what is left of the gradient, and costs one with slack
1e-6 only 1e-8 of its multiplier. Coordinates are expected in which slacks are of order one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple, final

import numpy as np

from calibench.optimizers.base import Array

_WEIGHT = 100.0


@final
class Kkt(NamedTuple):
    """Multipliers of the equalities and inequalities, and the gradient of the Lagrangian they leave, shape (n,)."""

    equalities: Array
    inequalities: Array
    stationarity: Array


def kkt(gradient: Array, J_eq: Array, J_in: Array, slack: Array) -> Kkt:
    """Return the multipliers at a point: `gradient` (n,), Jacobians (m_eq, n) and (m_in, n), `slack` (m_in,)."""
    m_eq, m_in = len(J_eq), len(J_in)
    columns = np.vstack([J_in.T, np.diag(_WEIGHT * np.maximum(slack, 0.0))])
    free = np.vstack([J_eq.T, np.zeros((m_in, m_eq))])
    wanted = np.concatenate([-gradient, np.zeros(m_in)])
    if m_eq:
        u, sizes, _ = np.linalg.svd(free, full_matrices=False)
        basis = u[:, sizes > 1e-12 * max(sizes[0], 1e-300)]  # dependent equalities share what they span
        columns_left, wanted_left = columns - basis @ (basis.T @ columns), wanted - basis @ (basis.T @ wanted)
    else:
        columns_left, wanted_left = columns, wanted
    inequalities = _non_negative(columns_left, wanted_left)
    equalities: Array = np.zeros(0)
    if m_eq:
        equalities = np.asarray(np.linalg.lstsq(free, wanted - columns @ inequalities, rcond=None)[0], dtype=np.float64)
    return Kkt(equalities, inequalities, gradient + J_eq.T @ equalities + J_in.T @ inequalities)


def _non_negative(matrix: Array, wanted: Array) -> Array:
    from scipy.optimize import lsq_linear, nnls

    if not matrix.shape[1]:
        return np.zeros(0)
    try:
        return np.asarray(nnls(matrix, wanted, maxiter=30 * matrix.shape[1])[0])
    except RuntimeError:  # it cycles where rounding decides which constraints are active
        return np.maximum(np.asarray(lsq_linear(matrix, wanted, (0.0, np.inf)).x), 0.0)


def lagrangian_hessian(path: list[tuple[Array, Array]], n: int) -> Array:
    """Return the BFGS approximation, shape (n, n), from points and the gradients of the Lagrangian there.

    Damped (Powell 1978; Nocedal and Wright 2006, proc. 18.2), so that it stays positive definite.
    """
    B = np.eye(n)
    for (x, slope), (x_next, slope_next) in pairwise(path):
        s, y = x_next - x, slope_next - slope
        Bs = B @ s
        sBs, sy = float(s @ Bs), float(s @ y)
        if not sBs > 0:
            continue
        theta = 1.0 if sy >= 0.2 * sBs else 0.8 * sBs / (sBs - sy)
        r = theta * y + (1.0 - theta) * Bs
        sr = float(s @ r)
        if sr > 0 and np.isfinite(r).all():
            B = B - np.outer(Bs, Bs) / sBs + np.outer(r, r) / sr
    return B
