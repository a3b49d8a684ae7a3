"""Where a telescope points: two axes, the six errors of their geometry, and the tube's bend, exact on the sphere.

Every step is a rotation of a direction, so nothing is wrong near the pole or the zenith, where the field's own
formulas, of first order, grow with sec and tan. Equatorial and altazimuth mounts are one mechanism in two frames:

    equatorial   x: the equator on the meridian, y: west, z: the pole   roll = hour angle, pitch = declination
    altazimuth   x: north, y: east, z: the zenith                       roll = azimuth,    pitch = elevation

A declination beyond +-90 degrees is the other side of the pier: the tube has gone over the pole. With such angles the
terms of the axes change their signs by themselves.

The signs are those of TPOINT (P. T. Wallace): true = recorded + correction, an hour angle to the west and a pitch
upwards counted positive, a correction of azimuth to the left. So IH, ID, CH, NP, ME, IE and AW enter as they are, and
IA, CA, NPAE and AN, whose first axis turns to the right, with the sign turned. MA positive: the pole of the mount is
east of the true one; ME positive: below it; AN, AW: north and west of the zenith. TF positive: the tube droops.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calibench.problems.base import Array

Kind = Literal["equatorial", "altaz"]
Numbers = NDArray[Any]
ARCSEC = np.pi / 180 / 3600  # rad
NORTH_EAST = "north_east"
AZIMUTHS = {NORTH_EAST: (1, 0.0), "north_west": (-1, 0.0), "south_east": (-1, np.pi), "south_west": (1, np.pi)}
"""Way of counting azimuth, from where and through where -> its sign and zero [rad], seen from north through east."""
LOWEST = np.sin(np.radians(5.0))  # sine of the elevation at which cot E ends: nobody points lower

# term -> the turn it makes, and its sign in the frame of the mount; in the order in which the turns follow each other
TURNS = {
    "equatorial": {"IH": ("roll", 1), "ID": ("pitch", 1), "CH": ("across", 1), "NP": ("square", 1),
                   "MA": ("sideways", 1), "ME": ("forwards", 1)},
    "altaz": {"IA": ("roll", -1), "IE": ("pitch", 1), "CA": ("across", -1), "NPAE": ("square", -1),
              "AW": ("sideways", 1), "AN": ("forwards", -1)},
}  # fmt: skip


def direction(roll: Numbers, pitch: Numbers) -> Numbers:
    """Return the unit vector of two angles [rad], shape (n, 3)."""
    return np.stack([np.cos(pitch) * np.cos(roll), np.cos(pitch) * np.sin(roll), np.sin(pitch) + 0 * roll], axis=-1)


def angles(towards: Numbers) -> tuple[Array, Array]:
    """Return the roll, within +-pi, and the pitch, within +-pi/2, of real unit vectors (n, 3)."""
    return np.arctan2(towards[:, 1], towards[:, 0]), np.arcsin(np.clip(towards[:, 2], -1, 1))


def tangents(roll: Numbers, pitch: Numbers) -> tuple[Numbers, Numbers]:
    """Return the unit vectors in which roll and pitch grow, (n, 3) each: the two components of an error on the sky."""
    along = np.stack([-np.sin(roll), np.cos(roll), 0 * roll], axis=-1)
    up = np.stack([-np.sin(pitch) * np.cos(roll), -np.sin(pitch) * np.sin(roll), np.cos(pitch) + 0 * roll], axis=-1)
    return along, up


def zenith(kind: Kind, latitude: float) -> Array:
    """Return the zenith in the frame of the mount, (3,)."""
    return np.array([np.cos(latitude), 0.0, np.sin(latitude)]) if kind == "equatorial" else np.array([0.0, 0.0, 1.0])


def pointing(kind: Kind, latitude: float, roll: Numbers, pitch: Numbers, terms: dict[str, Numbers]) -> Numbers:
    """Return where the telescope truly points, unit vectors (n, 3), at recorded axes [rad] and `terms` [arcsec].

    `terms` has all of `TURNS` and `TF`, `TX`; each a number or (n,). Analytic in all of them.
    """
    turn = {name: sign * terms[term] * ARCSEC for term, (name, sign) in TURNS[kind].items()}
    pitch, roll = pitch + turn["pitch"], roll + turn["roll"]
    x, y, z = (np.cos(turn["across"]) * np.cos(pitch), np.sin(turn["across"]) + 0 * pitch,
               np.cos(turn["across"]) * np.sin(pitch))  # fmt: skip
    y, z = _turned(y, z, -turn["square"])
    x, y = _turned(x, y, roll)
    y, z = _turned(y, z, turn["sideways"])
    x, z = _turned(x, z, turn["forwards"])
    return _bent(np.stack(np.broadcast_arrays(x, y, z), axis=-1), zenith(kind, latitude), terms["TF"], terms["TX"])


def _turned(a: Numbers, b: Numbers, by: Numbers) -> tuple[Numbers, Numbers]:
    return a * np.cos(by) - b * np.sin(by), a * np.sin(by) + b * np.cos(by)


def _bent(towards: Numbers, up: Array, sine: Numbers, tangent: Numbers) -> Numbers:
    """Return directions lowered by `sine` sin z and `tangent` tan z [arcsec], in the vertical plane."""
    height = towards @ up
    floor = np.where(height.real > LOWEST, height, LOWEST)
    drop = ((sine + tangent / floor) * ARCSEC + 0 * height)[:, None]
    lowered = towards - drop * (up - height[:, None] * towards)
    return np.asarray(lowered / np.sqrt(np.sum(lowered * lowered, axis=-1))[:, None])
