"""The scaled coordinates u of `fmincon`, in which closed boxes are the unit box; scales of values; iterates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.constraints import Region
from calibench.optimizers.fmincon.kkt import kkt

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
        """Return the coordinates of x."""
        coordinates: Array = (x[self.free] - self.origin) / self.width
        return coordinates

    def bounds(self) -> tuple[Array, Array]:
        """Return the bounds of u."""
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
    """Return the iterate x with its multipliers; a slope that is not defined counts as 0.

    The multipliers are found in u, where slacks are of order one, and returned for f and constraints as given.
    """
    gradient = np.nan_to_num(gradient, posinf=0.0, neginf=0.0)
    inside, _ = region.values(x)
    free, width, n = frame.free, frame.width, int(frame.free.sum())
    u, (low, high) = frame.u(x), frame.bounds()
    rows = np.vstack([J_in[:, free] * width / scales.inside[:, None], -np.eye(n), np.eye(n)])
    slack = np.concatenate([-inside / scales.inside, u - low, high - u])
    kept = np.isfinite(slack)
    on = J_eq[:, free] * width / scales.on[:, None]
    found = kkt(gradient[free] * width / scales.f, on, rows[kept], slack[kept])
    scaled = np.zeros(len(slack))
    scaled[kept] = found.inequalities * scales.f
    at_inside, at_low, at_high = np.split(scaled, [len(inside), len(inside) + n])
    inequalities, equalities = at_inside / scales.inside, found.equalities * scales.f / scales.on
    at_lower, at_upper = np.zeros(len(x)), np.zeros(len(x))
    at_lower[free], at_upper[free] = at_low / width, at_high / width
    left = gradient + J_in.T @ inequalities + J_eq.T @ equalities  # what a fixed variable's own bounds carry
    at_lower[~free], at_upper[~free] = np.maximum(left[~free], 0.0), np.maximum(-left[~free], 0.0)
    first_order = max(
        scales.f * float(np.max(np.abs(found.stationarity / width), initial=0.0)),
        float(np.max(scaled[kept] * np.maximum(slack[kept], 0.0), initial=0.0)),
    )
    violation = region.violation(x)
    return Iterate(x, value, gradient, J_in, J_eq, violation, first_order, inequalities, equalities, at_lower, at_upper)
