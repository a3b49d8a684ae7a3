"""The constraints of `fmincon` as one checked region, the scaled coordinates of a search, and its iterates.

Inequalities are stacked as [A x - b; c(x)] <= 0, equalities as [Aeq x - beq; ceq(x)] = 0. The nonlinear part is asked
once a point. Whether the linear part has a point at all is a linear programme, solved before the search begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibench.optimizers.base import Array
from calibench.optimizers.derivatives import differences
from calibench.optimizers.fmincon.options import DifferenceType

_OPEN = 1e3  # a box that much wider than its contents says nothing about their size


@final
@dataclass(frozen=True, eq=False)
class Region:
    """Where x, shape (n,), may be: n variables, m_A + m_c inequalities, m_Aeq + m_ceq equalities."""

    lower: Array
    upper: Array
    A: Array
    b: Array
    Aeq: Array
    beq: Array
    nonlcon: Callable[[Array], Any] | None
    gradients: bool
    kind: DifferenceType
    _last: list[tuple[Array, Array, Array, Array | None, Array | None]] = field(default_factory=list, repr=False)

    def values(self, x: Array) -> tuple[Array, Array]:
        """Return the inequalities (at most 0 inside) and the equalities (0 inside) at x."""
        c, ceq = self._ask(x)[1:3]
        return np.concatenate([self.A @ x - self.b, c]), np.concatenate([self.Aeq @ x - self.beq, ceq])

    def slopes(self, x: Array, steps: Array | None = None) -> tuple[Array, Array]:
        """Return derivatives of inequalities and equalities at x, a row each (undefined: 0); `steps` as there."""
        _, c, ceq, slope_c, slope_ceq = self._ask(x)
        if slope_c is None or slope_ceq is None:
            both = np.zeros((len(x), len(c) + len(ceq)))
            if both.size:
                value, size = np.concatenate([c, ceq]), step_sizes(x, self.lower, self.upper)
                joined = lambda at: np.concatenate(self._ask(at)[1:3])  # noqa: E731
                both = differences(joined, x, value, self.lower, self.upper, size=size, kind=self.kind, steps=steps)
            slope_c, slope_ceq = both[:, : len(c)], both[:, len(c) :]
        inside, on = np.vstack([self.A, slope_c.T]), np.vstack([self.Aeq, slope_ceq.T])
        return np.nan_to_num(inside, posinf=0.0, neginf=0.0), np.nan_to_num(on, posinf=0.0, neginf=0.0)

    def violation(self, x: Array) -> float:
        """Return the largest violation of any constraint at x; NaN where one is not defined."""
        inside, on = self.values(x)
        return float(np.max(np.concatenate([[0.0], inside, np.abs(on), self.lower - x, x - self.upper])))

    def is_defined(self, x: Array) -> bool:
        return all(np.isfinite(part).all() for part in self._ask(x)[1:3])

    def contradiction(self) -> str:
        """Return why no x satisfies bounds and linear constraints; empty where one does."""
        crossed = np.flatnonzero(self.lower > self.upper)
        if crossed.size:
            i = int(crossed[0])
            return f"lb[{i}]={self.lower[i]:g} is above ub[{i}]={self.upper[i]:g}"
        if not (len(self.b) or len(self.beq)):
            return ""
        from scipy.optimize import linprog

        box: Any = np.column_stack([self.lower, self.upper])
        found = linprog(np.zeros(len(self.lower)), self.A, self.b, self.Aeq, self.beq, box)
        return "no point satisfies the bounds and linear constraints together" if found.status == 2 else ""

    def nearest(self, x: Array) -> Array:
        """Return a point, found from x, where the sum of squared violations is least; only constraints are asked."""
        from scipy.optimize import least_squares

        free = self.lower < self.upper

        def whole(part: Array) -> Array:
            point = x.copy()
            point[free] = part
            return point

        def excess(part: Array) -> Array:
            inside, on = self.values(whole(part))
            return np.asarray(np.nan_to_num(np.concatenate([np.maximum(inside, 0.0), on]), nan=1e100, posinf=1e100))

        def slope(part: Array) -> Array:
            point = whole(part)
            inside, _ = self.values(point)
            rows_in, rows_on = self.slopes(point)
            return np.asarray(np.vstack([rows_in * (inside > 0)[:, None], rows_on])[:, free])

        box = (self.lower[free], self.upper[free])
        found = least_squares(excess, x[free], jac=slope, bounds=box, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        return whole(np.asarray(found.x))

    def _ask(self, x: Array) -> tuple[Array, Array, Array, Array | None, Array | None]:
        """Return x, c, ceq and, where they are given, their gradients, shape (n, m); the last two points are kept."""
        if self.nonlcon is None:
            return x, _NONE, _NONE, np.zeros((len(x), 0)), np.zeros((len(x), 0))
        for known in self._last:
            if np.array_equal(known[0], x):
                return known
        answer = self.nonlcon(x.copy())
        wanted = "(c, ceq, gradc, gradceq)" if self.gradients else "(c, ceq)"
        if not isinstance(answer, tuple | list) or len(answer) < (4 if self.gradients else 2):
            raise ValueError(f"nonlcon returned {type(answer).__name__}: {wanted} is needed, [] where there is none")
        c, ceq = _vector("c", answer[0]), _vector("ceq", answer[1])
        if self._last and (len(c), len(ceq)) != (len(self._last[0][1]), len(self._last[0][2])):
            raise ValueError(f"nonlcon returned {len(c)} and {len(ceq)} constraints, other numbers than before")
        both: list[Array | None] = [None, None]
        for k, (name, m) in enumerate((("gradc", len(c)), ("gradceq", len(ceq))) if self.gradients else ()):
            slopes = _numbers(f"{name} of nonlcon", answer[2 + k]) if m else np.zeros((len(x), 0))
            slopes = slopes[:, None] if slopes.shape == (len(x),) and m == 1 else slopes
            if slopes.shape != (len(x), m):
                shape = f"({len(x)}, {m}), one column a constraint, is needed"
                raise ValueError(f"nonlcon returned {name} of shape {slopes.shape}: {shape}")
            both[k] = slopes
        self._last[:] = [(x.copy(), c, ceq, both[0], both[1]), *self._last[:1]]
        return self._last[0]


_NONE = np.zeros(0)


def region(
    n: int, A: ArrayLike | None = None, b: ArrayLike | None = None, Aeq: ArrayLike | None = None,
    beq: ArrayLike | None = None, lb: ArrayLike | None = None, ub: ArrayLike | None = None,
    nonlcon: Callable[[Array], Any] | None = None, gradients: bool = False, kind: DifferenceType = "forward",
) -> Region:  # fmt: skip
    """Return the checked region of n variables. None and empty stand for no constraint."""
    if nonlcon is not None and not callable(nonlcon):
        raise ValueError(f"nonlcon={nonlcon!r}: a function of x, or None, is needed")
    bounds = []
    for name, values, default in (("lb", lb, -np.inf), ("ub", ub, np.inf)):
        bound = np.asarray(default) if values is None or np.size(values) == 0 else _numbers(name, values)
        if bound.shape not in ((n,), ()) or np.isnan(bound).any():
            trouble = "holds NaN" if bound.shape in ((n,), ()) else f"has shape {bound.shape}"
            raise ValueError(f"{name} {trouble}: one number, infinite where open, for each of {n} variables is needed")
        bounds.append(np.broadcast_to(bound, (n,)).copy())
    rows, limits = _linear("A", A, "b", b, n)
    rows_eq, limits_eq = _linear("Aeq", Aeq, "beq", beq, n)
    return Region(
        bounds[0], bounds[1], A=rows, b=limits, Aeq=rows_eq, beq=limits_eq, nonlcon=nonlcon, gradients=gradients,
        kind=kind,
    )  # fmt: skip


def step_sizes(x: Array, lower: Array, upper: Array) -> Array:
    """Return what difference steps at x are relative to, shape (n,): the box unless it is open or very wide."""
    own, width = np.maximum(np.abs(x), 1.0), upper - lower
    return np.where(width <= _OPEN * own, np.maximum(np.abs(x), width), own)


def _numbers(name: str, values: Any) -> Array:
    try:
        given = np.asarray(values)
        if given.dtype.kind == "c":
            raise ValueError
        return np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must hold real numbers") from None


def _linear(name: str, matrix: ArrayLike | None, side_name: str, side: ArrayLike | None, n: int) -> tuple[Array, Array]:
    without_matrix, without_side = (v is None or np.size(v) == 0 for v in (matrix, side))
    if without_matrix and without_side:
        return np.zeros((0, n)), _NONE
    if without_matrix or without_side:
        given, missing = (side_name, name) if without_matrix else (name, side_name)
        raise ValueError(f"{given} is given without {missing}: both or neither are needed")
    rows, limits = np.atleast_2d(_numbers(name, matrix)), np.atleast_1d(_numbers(side_name, side))
    if rows.ndim != 2 or rows.shape[1] != n:
        raise ValueError(f"{name} has shape {rows.shape}: one row a constraint, {n} columns, one a variable, is needed")
    if limits.shape != (len(rows),):
        raise ValueError(f"{side_name} has shape {limits.shape}: ({len(rows)},), one for each row of {name}, is needed")
    if not (np.isfinite(rows).all() and np.isfinite(limits).all()):
        raise ValueError(f"{name} and {side_name} must be finite; leave out a constraint that is none")
    return rows, limits


def _vector(name: str, values: Any) -> Array:
    """Return what nonlcon gave as a vector; a complex number in it is NaN, so that the point is refused."""
    if values is None:
        return _NONE
    given = np.atleast_1d(np.asarray(values))
    if given.dtype.kind == "c":
        given = np.where(given.imag == 0, given.real, np.nan)
    try:
        vector = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"nonlcon returned {name} which is not numbers") from None
    if vector.ndim != 1:
        raise ValueError(f"nonlcon returned {name} of shape {vector.shape}: a vector is needed")
    return vector


_STEEPEST = 100.0  # the largest component of a gradient at the start, after scaling
_FLATTEST = 1e-8  # below this the start is stationary, and its gradient tells nothing about the size of f
_VERY_WIDE = 1e3  # a box that much wider than its contents is no measure of a variable
_INSIDE = 1e-2  # an interior point begins at least this far, in u, from its bounds


@final
@dataclass(frozen=True, eq=False)
class Frame:
    """The coordinates u of the variables that are free: x = origin + width u, inside the bounds."""

    x0: Array
    lower: Array
    upper: Array
    free: NDArray[np.bool_]
    origin: Array
    width: Array

    @staticmethod
    def of(region: Region, x0: Array, scale: bool) -> Frame:
        """Return the frame: unit boxes where bounds are closed and not very wide, else sizes of x0 (1 without)."""
        lower, upper = region.lower, region.upper
        size = np.maximum(np.abs(x0), 1.0)
        closed = (upper - lower <= _VERY_WIDE * size) & (upper > lower)
        origin, width = np.where(closed, lower, 0.0), np.where(closed, upper - lower, size)
        if not scale:
            origin, width = np.zeros_like(x0), np.ones_like(x0)
        free = lower < upper
        return Frame(np.clip(x0, lower, upper), lower, upper, free, origin[free], width[free])

    def x(self, u: Array) -> Array:
        """Return the point of u, never outside the bounds."""
        point = self.x0.copy()
        point[self.free] = self.origin + self.width * u
        return np.clip(point, self.lower, self.upper)

    def u(self, x: Array) -> Array:
        return np.asarray((x[self.free] - self.origin) / self.width)

    def bounds(self) -> tuple[Array, Array]:
        return self.u(self.lower), self.u(self.upper)

    def inside(self, u: Array) -> Array:
        """Return u moved off its bounds, where an interior point can begin."""
        low, high = self.bounds()
        room = np.minimum(_INSIDE, 0.25 * (high - low))
        return np.minimum(np.maximum(u, low + room), high - room)


@final
@dataclass(frozen=True, eq=False)
class Iterate:
    """A point with all that is known about it. Multipliers are those of the constraints as given, not as scaled."""

    x: Array
    value: float
    gradient: Array
    J_in: Array
    J_eq: Array
    violation: float
    first_order: float
    inequalities: Array
    equalities: Array
    at_lower: Array
    at_upper: Array


@final
@dataclass(frozen=True, eq=False)
class Scales:
    """What f, the inequalities and the equalities are divided by."""

    f: float
    inside: Array
    on: Array

    @staticmethod
    def of(frame: Frame, gradient: Array, J_in: Array, J_eq: Array, *, on: bool) -> Scales:
        """Return the scales from derivatives at a start; ones where not `on`. Constraints are never made larger."""
        free, width = frame.free, frame.width
        rows_in, rows_eq = (np.max(np.abs(J[:, free] * width), axis=1, initial=0.0) for J in (J_in, J_eq))
        if not on:
            return Scales(1.0, np.ones(len(J_in)), np.ones(len(J_eq)))
        steepest, f = float(np.max(np.abs(gradient[free] * width), initial=0.0)), 1.0
        if steepest > _STEEPEST:
            f = steepest / _STEEPEST
        elif _FLATTEST < steepest < 1.0:
            f = steepest
        return Scales(f, np.maximum(1.0, rows_in / _STEEPEST), np.maximum(1.0, rows_eq / _STEEPEST))


def iterate_at(
    region: Region, frame: Frame, scales: Scales, x: Array, value: float, gradient: Array, J_in: Array, J_eq: Array
) -> Iterate:
    """Return the iterate x, its multipliers (found in u) those of f and constraints as given; no slope counts as 0."""
    gradient, inside = np.nan_to_num(gradient, posinf=0.0, neginf=0.0), region.values(x)[0]
    free, width, n = frame.free, frame.width, int(frame.free.sum())
    u, (low, high) = frame.u(x), frame.bounds()
    rows = np.vstack([J_in[:, free] * width / scales.inside[:, None], -np.eye(n), np.eye(n)])
    slack = np.concatenate([-inside / scales.inside, u - low, high - u])
    kept = np.isfinite(slack)
    on = J_eq[:, free] * width / scales.on[:, None]
    of_equalities, of_slacks, stationarity = kkt(gradient[free] * width / scales.f, on, rows[kept], slack[kept])
    scaled = np.zeros(len(slack))
    scaled[kept] = of_slacks * scales.f
    at_inside, at_low, at_high = np.split(scaled, [len(inside), len(inside) + n])
    inequalities, equalities = at_inside / scales.inside, of_equalities * scales.f / scales.on
    at_lower, at_upper = np.zeros(len(x)), np.zeros(len(x))
    at_lower[free], at_upper[free] = at_low / width, at_high / width
    left = gradient + J_in.T @ inequalities + J_eq.T @ equalities  # what a fixed variable's own bounds carry
    at_lower[~free], at_upper[~free] = np.maximum(left[~free], 0.0), np.maximum(-left[~free], 0.0)
    first_order = max(
        scales.f * float(np.max(np.abs(stationarity / width), initial=0.0)),
        float(np.max(scaled[kept] * np.maximum(slack[kept], 0.0), initial=0.0)),
    )
    return Iterate(
        x, value, gradient, J_in, J_eq, violation=region.violation(x), first_order=first_order,
        inequalities=inequalities, equalities=equalities, at_lower=at_lower, at_upper=at_upper,
    )  # fmt: skip


_WEIGHT = 100.0


def kkt(gradient: Array, J_eq: Array, J_in: Array, slack: Array) -> tuple[Array, Array, Array]:
    """Return the multipliers at a point: `gradient` (n,), Jacobians (m_eq, n) and (m_in, n), `slack` (m_in,).

    Returns those of equalities and of inequalities, and the gradient of the Lagrangian that they leave, shape (n,). For
    slacks s >= 0 they solve min |g + J_eq^T l_eq + J_in^T l|^2 + |k s * l|^2, l >= 0, by non-negative least squares
    (Lawson and Hanson 1974, ch. 23) once the free l_eq are projected out: no threshold says which constraints are
    active. With k = 100 a constraint with slack .1 takes at most a hundredth of what is left of the gradient, and one
    with slack 1e-6 loses 1e-8 of its multiplier.
    """
    from scipy.optimize import lsq_linear, nnls

    m_eq, m_in = len(J_eq), len(J_in)
    columns = np.vstack([J_in.T, np.diag(_WEIGHT * np.maximum(slack, 0.0))])
    free = np.vstack([J_eq.T, np.zeros((m_in, m_eq))])
    wanted = np.concatenate([-gradient, np.zeros(m_in)])
    across, rest = columns, wanted
    if m_eq:
        u, sizes, _ = np.linalg.svd(free, full_matrices=False)
        basis = u[:, sizes > 1e-12 * max(sizes[0], 1e-300)]  # dependent equalities share what they span
        across, rest = columns - basis @ (basis.T @ columns), wanted - basis @ (basis.T @ wanted)
    equalities, inequalities = np.zeros(0), np.zeros(0)
    if m_in:
        try:
            inequalities = np.asarray(nnls(across, rest, maxiter=30 * m_in)[0])
        except RuntimeError:  # it cycles where rounding decides which constraints are active
            inequalities = np.maximum(np.asarray(lsq_linear(across, rest, (0.0, np.inf)).x), 0.0)
    if m_eq:
        equalities = np.asarray(np.linalg.lstsq(free, wanted - columns @ inequalities, rcond=None)[0], dtype=np.float64)
    return equalities, inequalities, gradient + J_eq.T @ equalities + J_in.T @ inequalities


def lagrangian_hessian(path: list[tuple[Array, Array]], n: int) -> Array:
    """Return the BFGS approximation (n, n), damped (Powell 1978; Nocedal and Wright 2006, 18.2)."""
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
