"""Where the base stands and where the target sits on the flange, found from the readings alone, without a guess.

Of each reading the flange is known in the frame of the base, turn A and place a, and the target in that of the tracker:

    x = R (a + A c) + t          R, t of the base and c of the target unknown

Written out, x is linear in R, in the products R c and in t: 13 unknown numbers for each coordinate. Their solution is
brought to the nearest rotation, and refined turn by turn: R and t by the closest rigid fit of points (Kabsch, Acta
Cryst. A32 (1976) 922), c by linear least squares, both with readings that lie far out weighed down. With few poses, or
poses that turn the flange little, c = 0 is a second start; the one that ends nearer is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from itertools import combinations
from typing import final

import numpy as np

from calibench.core.words import plain
from calibench.problems.arm.frames import frames_of_positions
from calibench.problems.arm.stands import moved
from calibench.problems.base import Array

LEAST_POSES = 4  # one more than the three points that a rigid fit needs
_LINEAR = 14  # poses from which on the linear equations are overdetermined
_ROUNDS = 200
_STILL = 1e-9  # of the size of the cloud
_HUBER = 2.0  # robust deviations beyond which the influence of a reading does not grow
# residuals, in the size of the cloud of points: something may be wrong; it cannot be this arm
_DOUBTFUL, _APART = 0.1, 0.4
_ELSEWHERE = 0.02  # rms of what is left, in the size of the cloud: the readings may be of two stands
_CURED = 8.0  # factor by which another interpretation of the file must reduce the residuals
_FACTORS = {1e3: "m", 1e-3: "um", 25.4: "inch", 1 / 25.4: ""}  # to mm from a unit of length


@final
@dataclass(frozen=True, eq=False)
class Placed:
    """The base in the tracker's frame, `turned` (3, 3) and `base` (3,) [mm], and the target on the flange, `tool` (3,).

    `left` is what remains of each reading, (n,) [mm]; `mirrored` is the middle of what would remain if the tracker's
    frame were left-handed.
    """

    turned: Array
    base: Array
    tool: Array
    left: Array
    mirrored: float


def placed(flange: tuple[Array, Array], seen: Array) -> Placed:
    """Return where base and target are, from `seen` (n, 3) and the flange in the base's frame: turn and place."""
    found = _best(flange, seen)
    opposite = _best(flange, seen * [1.0, 1.0, -1.0])
    turned, base, tool, left = found
    return Placed(turned, base, tool, left, float(np.median(opposite[3])))


def misfit(
    found: Placed, seen: Array, flange: Callable[[Mapping[str, Array]], tuple[Array, Array]],
    joints: Mapping[str, Array], sliding: Set[str], described: str = "URDF",
) -> str:  # fmt: skip
    """Return why readings `seen` (n, 3) [mm] cannot be this arm's, and how to correct them.

    The text is "" for readings that may be this arm's. `flange(joints)` computes the flange at `joints`, name -> (n,)
    [rad, or mm of those in `sliding`]. `described` is what the arm is described by: URDF, or table.
    """
    left, spread = float(np.median(found.left)), _spread(seen)
    if not left > _DOUBTFUL * spread:
        return ""
    told = f"readings and arm lie {plain(left, 3)} mm apart, wherever base and target are"
    way, nearer = "", left / _CURED
    for words, made, places in _changed(joints, seen, sliding, described):
        after = float(np.median(placed(flange(made), places).left)) * spread / max(_spread(places), 1e-300)
        if after < nearer:
            way, nearer = words, after
    if way:
        return f"{told}, and near to each other if {way}"
    if left < _APART * spread:
        return ""
    return (
        f"{told}: is this the {described} of the arm, and are the columns those of its joints, in their units and "
        "senses?"
    )


def two_stands(found: Placed, flange: tuple[Array, Array], seen: Array) -> tuple[Array, str] | None:
    """Return which readings (n, 3) [mm] are of another stand, (n,), and in words what was moved; None for one stand.

    Base or target that lie elsewhere by millimetres are an effect; here they lie elsewhere by a good part of the arm.
    """
    if not np.sqrt(np.mean(found.left**2)) > _ELSEWHERE * _spread(seen):
        return None
    poses = np.tile(np.eye(4), (len(seen), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = flange
    far, told = moved(poses, seen, frames_of_positions(poses, seen, 1.0))
    return (far, told) if told else None


def _changed(
    joints: Mapping[str, Array], seen: Array, sliding: Set[str], described: str
) -> Iterator[tuple[str, Mapping[str, Array], Array]]:
    """Yield the corrections that are tried: in words, the joints, and the places."""
    for factor, unit in _FACTORS.items():
        stated = f", as units=x:{unit},y:{unit},z:{unit} does" if unit else ""
        for k, name in enumerate("xyz"):
            places = seen * np.where(np.arange(3) == k, factor, 1.0)
            yield f"{name} is multiplied by {factor:g}: it is in another unit than the others", joints, places
        yield f"x, y, z are multiplied by {factor:g}: state their unit{stated}", joints, seen * factor
        for name in sliding & joints.keys():
            words = f"{name} is multiplied by {factor:g}: state the unit of the column"
            yield words, {**joints, name: factor * joints[name]}, seen
    for name in joints:
        yield f"joint {name} counts the other way round", {**joints, name: -joints[name]}, seen
        for degrees in () if name in sliding else (-90, 90, 180):
            words = f"{degrees}° are added to joint {name}: its zero is not that of the {described}"
            yield words, {**joints, name: joints[name] + np.deg2rad(degrees)}, seen
    for one, other in combinations(joints, 2):
        yield f"{one} and {other} are exchanged", {**joints, one: joints[other], other: joints[one]}, seen


def _spread(seen: Array) -> float:
    return float(np.median(np.linalg.norm(seen - np.median(seen, axis=0), axis=1)))


def _best(flange: tuple[Array, Array], seen: Array) -> tuple[Array, Array, Array, Array]:
    starts = [np.zeros(3)]
    if len(seen) >= _LINEAR:
        starts.append(_linear(flange, seen))
    ends = [_refined(flange, seen, tool) for tool in starts]
    return min(ends, key=lambda end: float(np.median(end[3])))


def _linear(flange: tuple[Array, Array], seen: Array) -> Array:
    """Return the tool of the linear equations, (3,) [mm]."""
    A, a = flange
    columns = np.concatenate([a, A.reshape(len(a), 9), np.ones((len(a), 1))], axis=1)  # a_l, A_lm, 1
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    solved = np.linalg.lstsq(columns / size, seen, rcond=1e-9)[0] / size[:, None]  # (13, 3)
    R = _rotation(solved[:3].T)
    products = solved[3:12].reshape(3, 3, 3)  # l, m, k: R_kl c_m
    return np.asarray(np.einsum("kl,lmk->m", R, products) / 3.0)


def _refined(flange: tuple[Array, Array], seen: Array, tool: Array) -> tuple[Array, Array, Array, Array]:
    A, a = flange
    weight = np.ones(len(seen))
    size = float(np.linalg.norm(seen - seen.mean(axis=0), axis=1).mean()) + 1e-300
    R, t = np.eye(3), np.zeros(3)
    before = np.inf
    for _ in range(_ROUNDS):
        R, t = _rigid(a + A @ tool, seen, weight)
        root = np.sqrt(weight)[:, None]
        # the tool and the base's place at once: seen = R a + R A c + t
        M = np.concatenate([R @ A, np.broadcast_to(np.eye(3), A.shape)], axis=2) * root[..., None]
        solved = np.linalg.lstsq(M.reshape(-1, 6), ((seen - a @ R.T) * root).ravel(), rcond=1e-9)[0]
        tool, t = solved[:3], solved[3:]
        left = np.linalg.norm(seen - (a + A @ tool) @ R.T - t, axis=1)
        middle = float(np.median(left))
        weight = np.minimum(1.0, _HUBER * middle / np.maximum(left, 1e-300)) ** 2
        if abs(before - middle) < _STILL * size:
            break
        before = middle
    return R, t, tool, left


def _rigid(points: Array, seen: Array, weight: Array) -> tuple[Array, Array]:
    """Return R (3, 3) and t (3,) of the closest seen = R points + t."""
    w = weight / weight.sum()
    one, other = w @ points, w @ seen
    R = _rotation(((seen - other) * w[:, None]).T @ (points - one))
    return R, other - R @ one


def _rotation(M: Array) -> Array:
    """Return the rotation nearest to M, (3, 3)."""
    U, _, V = np.linalg.svd(M)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V)
