"""The method of the authors of the sockets, again, so that it can be asked about places that it has not seen.

MUKCa (Franzese, Spahn, Kober, Della Santina: github.com/platonics-delft/kinematics_calibration, parameter_optimizer.py)
moves all six numbers of each joint's origin in the URDF, and those of the ball. What it makes small is a sum over
places, in m^2: the mean square of the ball's way from the mean point of its socket, the square of the error of the two
points' distance, and 1e-4 times the squares of all changes [m, rad] but the ball's. Theirs is minimised by IPOPT, this
by least squares. It shares the URDF's numbers with the package, and no kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibench.problems.base import Array

DISTANCE = 50.0  # mm, of the two sockets of the tool
_TIP, _BALL = "ball_link", "ball_joint"
_HELD_BY = 1e-4  # weight of the squares of changes, as theirs
_MM = 1e3

Places = Mapping[str, tuple[Array, Array]]  # of each place the joints [rad], (n, 7), with the ball in socket 0 and in 1
Origins = Mapping[str, Array]  # of each joint x, y, z [m] and roll, pitch, yaw [rad]


def places(folder: Path) -> Places:
    """Return the postures of all places, by name."""
    return {
        place.name: (_read(place / "hole_0.csv"), _read(place / "hole_1.csv"))
        for place in sorted(folder.iterdir())
        if (place / "hole_0.csv").exists()
    }


def origins(urdf: Path) -> Origins:
    """Return the origins of the joints from the base to the ball, in their order."""
    return {name: place for name, _, place in _joints(urdf)}


def left(urdf: Path, at: Origins, sockets: tuple[Array, Array]) -> tuple[float, float]:
    """Return of a place the rms way [mm] of the ball from its mean point, and the error [mm] of their distance."""
    balls = [_MM * _ball(urdf, at, q) for q in sockets]
    means = [ball.mean(axis=0) for ball in balls]
    square = sum(float(((ball - mean) ** 2).sum()) for ball, mean in zip(balls, means, strict=True))
    return float(np.sqrt(square / sum(map(len, balls)))), float(np.linalg.norm(means[0] - means[1])) - DISTANCE


def fitted(urdf: Path, seen: Sequence[tuple[Array, Array]]) -> Origins:
    """Return the origins that their sum is least for, from those of `urdf`, by the places that are `seen`."""
    start = origins(urdf)
    free = [name for name, kind, _ in _joints(urdf) if kind != "fixed" or name == _BALL]
    first = np.concatenate([start[name] for name in free])
    held = np.repeat([name != _BALL for name in free], 6)
    q = np.concatenate([part for pair in seen for part in pair])
    ends = np.cumsum([len(part) for pair in seen for part in pair])[:-1]

    def moved(x: Array) -> Origins:
        return {**start, **dict(zip(free, x.reshape(-1, 6), strict=True))}

    def residuals(x: Array) -> Array:
        balls = np.split(_ball(urdf, moved(x), q), ends)
        rows = [np.sqrt(len(seen) * _HELD_BY) * (x - first)[held]]
        for one, other in zip(balls[::2], balls[1::2], strict=True):
            weight = 1 / np.sqrt(len(one) + len(other))
            means = one.mean(axis=0), other.mean(axis=0)
            rows += [(weight * (one - means[0])).ravel(), (weight * (other - means[1])).ravel()]
            rows.append(np.array([np.linalg.norm(means[0] - means[1]) - DISTANCE / _MM]))
        return _MM * np.concatenate(rows)

    return moved(least_squares(residuals, first, xtol=1e-12, ftol=1e-12, gtol=1e-10, max_nfev=60).x)


def _ball(urdf: Path, at: Origins, q: Array) -> Array:
    """Return where the ball is [m], (n, 3)."""
    turn, place, k = np.eye(3)[None], np.zeros((len(q), 3)), 0
    for name, kind, _ in _joints(urdf):
        place = place + turn @ at[name][:3]
        turn = turn @ Rotation.from_euler("xyz", at[name][3:]).as_matrix()
        if kind != "fixed":  # all turn about z
            turn = turn @ Rotation.from_rotvec(q[:, k, None] * [0.0, 0.0, 1.0]).as_matrix()
            k += 1
    return np.asarray(place)


@cache
def _joints(urdf: Path) -> list[tuple[str, str, Array]]:
    by_child = {_of(joint, "child", "link"): joint for joint in ElementTree.parse(urdf).getroot().findall("joint")}
    found: list[tuple[str, str, Array]] = []
    link = _TIP
    while link in by_child:
        joint = by_child[link]
        place = [*_numbers(_of(joint, "origin", "xyz")), *_numbers(_of(joint, "origin", "rpy"))]
        found.insert(0, (joint.attrib["name"], joint.attrib["type"], np.array(place)))
        link = _of(joint, "parent", "link")
    return found


def _of(joint: ElementTree.Element, part: str, name: str) -> str:
    element = joint.find(part)
    return "" if element is None else element.get(name, "")


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()] or [0.0, 0.0, 0.0]


def _read(path: Path) -> Array:
    return np.loadtxt(path, delimiter=",")
