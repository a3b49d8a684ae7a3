"""The planar machine as it stands: three legs from bases A_i over elbows B_i to one end-effector point P.

Cong et al. 2008. A machine is an array of shape (..., 15): xa1 ya1 xa2 ya2 xa3 ya3 la1-3 lb1-3 z1-3, mm and rad. Joint
i stands at theta_i = reading_i + z_i.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES = (
    "xa1", "ya1", "xa2", "ya2", "xa3", "ya3", "la1", "la2", "la3", "lb1", "lb2", "lb3", "z1", "z2", "z3",
)  # fmt: skip
BASES, PROXIMAL, DISTAL, OFFSETS = slice(0, 6), slice(6, 9), slice(9, 12), slice(12, 15)
HOME = np.array([216.5, 250.0])
MAKERS = np.array([0.0, 250.0, 433.0, 0.0, 433.0, 500.0, *[244.0] * 6, *[1.0] * 3])
SCATTER = np.array([5.0] * 6 + [5.0] * 6 + [0.2] * 3)
ANGLE_ONLY_FREE = np.arange(4, 15)  # A_1 and A_2 are held: a planar similarity leaves all angles as they are
ALL_FREE = np.arange(15)


def random_machine(rng: np.random.Generator) -> Array:
    """Draw a machine, shape (15,), about the maker's: bases within 5 mm, links 239-249 mm, offsets 1 +- .2 rad."""
    return MAKERS + SCATTER * rng.uniform(-1, 1, 15)


def bases(machine: Array) -> Array:
    """Return A, shape (..., 3, 2), mm, of a machine of shape (..., 15)."""
    return machine[..., BASES].reshape(*machine.shape[:-1], 3, 2)


def inverse(machine: Array, positions: Array, branch: Array) -> Array:
    """Return the joint angles theta, shape (n, 3), rad, at positions (n, 2), elbows on the sides `branch` (3,) of +-1.

    `machine` may be one for each row, shape (n, 15). NaN where a leg does not reach.
    """
    out = positions[..., None, :] - bases(machine)
    la, lb = machine[..., PROXIMAL], machine[..., DISTAL]
    reach = np.hypot(out[..., 0], out[..., 1])
    with np.errstate(invalid="ignore"):
        inner = np.arccos((la**2 + reach**2 - lb**2) / (2 * la * reach))
    return np.arctan2(out[..., 1], out[..., 0]) + branch * inner


def elbows(machine: Array, theta: Array) -> Array:
    """Return B, shape (..., 3, 2), mm, of joint angles theta (..., 3)."""
    la = machine[..., PROXIMAL, None]
    return bases(machine) + la * np.stack([np.cos(theta), np.sin(theta)], axis=-1)


def leg_errors(machine: Array, readings: Array, positions: Array) -> Array:
    """Return |P - B_i| - lb_i, shape (..., n, 3), mm, of readings (n, 3) and positions (n, 2); machine (..., 15)."""
    one = machine[..., None, :]
    reach = positions[..., None, :] - elbows(one, readings + one[..., OFFSETS])
    return np.hypot(reach[..., 0], reach[..., 1]) - one[..., DISTAL]


def closure(machine: Array, readings: Array) -> Array:
    """Return the power of the radical centre of the three distal circles, shape (..., n), mm^2: 0 where they meet."""
    one = machine[..., None, :]
    b = elbows(one, readings + one[..., OFFSETS])
    lb = one[..., DISTAL]
    near = b - b[..., :1, :]  # from B_1, so that the squares stay small
    height = ((near**2).sum(axis=-1) - lb**2 + lb[..., :1] ** 2) / 2
    (x2, y2), (x3, y3) = (np.moveaxis(near[..., k, :], -1, 0) for k in (1, 2))
    area = x2 * y3 - x3 * y2
    x = (height[..., 1] * y3 - height[..., 2] * y2) / area
    y = (x2 * height[..., 2] - x3 * height[..., 1]) / area
    return x**2 + y**2 - lb[..., 0] ** 2
