"""The GPM2002 itself (Cong et al. 2008): fifteen numbers, its home, its inverse kinematics, its two coordinate systems.

A machine is an array of shape (15,): xa1 ya1 xa2 ya2 xa3 ya3 la1 la2 la3 lb1 lb2 lb3 z1 z2 z3, mm and rad.
"""

from __future__ import annotations

import numpy as np

from calibench.core.same_bits import arccos, arctan2, cos, sin
from calibench.problems import constants
from calibench.problems.base import Array

PAPER = "cong2008"
NAMES = (
    "xa1", "ya1", "xa2", "ya2", "xa3", "ya3", "la1", "la2", "la3", "lb1", "lb2", "lb3", "z1", "z2", "z3",
)  # fmt: skip
UNITS = ("mm",) * 12 + ("rad",) * 3


def makers_machine() -> Array:
    """Return the maker's machine, shape (15,): nominal bases and lengths, offsets zero."""
    geometry = constants.column(PAPER, "geometry")
    bases = [geometry[name] for name in NAMES[:6]]
    return np.array(bases + [geometry["link"]] * 6 + [0.0] * 3)


def home() -> Array:
    """Return the home position of the end-effector, shape (2,), mm."""
    geometry = constants.column(PAPER, "geometry")
    return np.array([geometry["home_x"], geometry["home_y"]])


def inverse_kinematics(machine: Array, positions: Array) -> Array:
    """Return the joint angles, shape (n, 3), rad, in the elbow branch + of all legs, for positions (n, 2), mm.

    That branch is the only one of eight that gives Table 2's initial offsets. Out of reach gives NaN.
    """
    angles = np.empty((len(positions), 3))
    for i in range(3):
        dx, dy = positions[:, 0] - machine[2 * i], positions[:, 1] - machine[2 * i + 1]
        la, lb, reach = machine[6 + i], machine[9 + i], np.hypot(dx, dy)
        cosine = (la**2 + reach**2 - lb**2) / (2 * la * reach)
        angles[:, i] = arctan2(dy, dx) + arccos(cosine)
    return angles


def to_cartesian(machine: Array) -> Array:
    """Return the machine with l_a cos z and l_a sin z in the places of l_a and z: the coordinates of J3, eq. (41)."""
    la, z = machine[6:9], machine[12:15]
    return np.concatenate([machine[:6], la * cos(z), machine[9:12], la * sin(z)])


def to_polar(machine: Array, turn: Array) -> Array:
    """Return the machine with l_a and z back in their places, eq. (44) with its square root and division restored.

    An angle is known but for whole turns: z is given in the turn of `turn`, shape (3,), rad.
    """
    lac, las = machine[6:9], machine[12:15]
    z = arctan2(las, lac)
    z = z + 2 * np.pi * np.round((turn - z) / (2 * np.pi))
    return np.concatenate([machine[:6], np.hypot(lac, las), machine[9:12], z])
