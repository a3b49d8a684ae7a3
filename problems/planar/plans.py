"""Named sampling plans: the positions of the end-effector, about home, at which readings are taken.

The papers do not publish their plans. `disc` and `box` are random points drawn from a seed, the others are fixed.
"""

from __future__ import annotations

from typing import Literal, assert_never

import numpy as np

from calibench.core.same_bits import cos, sin
from calibench.problems.base import Array

_FARTHEST = 1000.0
PlanName = Literal["grid", "disc", "box", "line", "circle", "two_circles"]


def plan_points(plan: PlanName, home: Array, radius: float, n: int, rng: np.random.Generator) -> Array:
    """Return `n` end-effector positions, shape (n, 2), mm, within `radius` of `home` (along x for grid, line, box).

    Raises `ValueError` where n points cannot make the plan.
    """
    if not radius > 0:
        raise ValueError(f"radius={radius:g}: must be above 0 mm")
    if radius > _FARTHEST:
        raise ValueError(f"radius={radius:g}: out of reach; the legs reach some 490 mm")
    if plan == "grid":
        return home + radius * _grid(n)
    if plan == "disc":
        r, angle = np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
        return home + radius * np.column_stack([r * cos(angle), r * sin(angle)])
    if plan == "box":
        return np.asarray(home + radius * (2 * rng.random((n, 2)) - 1))
    if plan == "line":
        return home + radius * np.column_stack([np.linspace(-1, 1, n), np.zeros(n)])
    if plan == "circle":
        return home + radius * _circle(n)
    if plan == "two_circles":  # the outer one has twice the radius and twice the points
        inner = n // 3
        return home + radius * np.vstack([_circle(n - inner), 0.5 * _circle(inner)])
    assert_never(plan)


def _circle(n: int) -> Array:
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([cos(angle), sin(angle)])


def _grid(n: int) -> Array:
    """Return a grid of equal pitch, three rows where n allows, scaled to reach from -1 to 1 in x; n = 3 is a corner."""
    if n == 3:
        return np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rows = 3 if n % 3 == 0 and n >= 9 else max(d for d in range(1, int(n**0.5) + 1) if n % d == 0)
    columns = n // rows
    if rows < 2 or columns < 2:
        raise ValueError(f"n={n}: a grid needs rows and columns, such as n=9, 21 or 50; or choose another plan")
    pitch = 2.0 / (columns - 1)
    x, y = np.meshgrid(np.arange(columns) * pitch - 1.0, (np.arange(rows) - (rows - 1) / 2) * pitch)
    return np.column_stack([x.ravel(), y.ravel()])
