"""The start of a hand-eye calibration in closed form, and with it what the table does not state, or states wrongly.

With A the arm's poses and B those of the board in the camera, B = M A T for two unknown frames: the mount M and the
tool T. The rotations of M and T solve a linear homogeneous system, U B = A V with U = M' and V = T (Shah 2013 solves
the same one by its Kronecker product); the places are linear after that, with a scale between the units of both poses.
Handfuls of pairs are tried, so that wild ones have no say. Other orders of angles, inverse poses and rows out of step
are tried the same way. Places are part of each trial: a quaternion read with its real part at the wrong end is the
inverse rotation between two fixed ones (a cyclic exchange of four numbers is a reflection, which takes q to a q* b), so
that rotations alone cannot tell the one error from the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import final

import numpy as np

from calibench.bench.calibration.hand_eye.pairs import Pairs, Pose
from calibench.bench.calibration.readings import Mask
from calibench.core.words import as_columns, plain
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.rigid import inverse
from calibench.problems.arm.frames import angle_between, nearest_rotation
from calibench.problems.base import Array

_HANDFUL, _HANDFULS = 4, 100
_TIMES = 10.0  # times better: no chance, but another meaning of the same numbers
_TWICE = 2.0  # times better: one order of angles beside another
_APART = 0.12  # rad: the middle rotation further off belongs to no such frames, whatever the noise
_ROUNDING = 1e-6  # rad or mm: less is no misfit of rotations or places that files hold
_FAR = 6.0  # times the median: a place beyond has no say
_ALIKE = 1e-3  # part of a column: a scale that others explain so far is not told
_SCALES = {"mm": 1.0, "m": 1e3, "cm": 10.0, "inch": 25.4, "um": 1e-3}
_NEAR = 0.1


@final
@dataclass(frozen=True, eq=False)
class Start:
    """The arm's poses and the board's in the camera, (n, 4, 4) [mm], with mount and tool (4, 4) that join them."""

    arm: Array
    seen: Array
    mount: Array
    tool: Array
    notes: tuple[str, ...]


def started(pairs: Pairs, mounting: str, train: Mask) -> Start:
    """Return where the fit begins, by the pairs of `train` (n,). Raises `DataError` where they fit no such frames."""
    tried = _tried(pairs, mounting, train)
    apart_by = {key: _misfit(*both) for key, both in tried.items()}
    _check_sides(pairs, tried, min(apart_by.values()), mounting)
    flange, board, notes = _meaning(pairs, apart_by)
    arm, seen = arm_poses(pairs.moved(flange), mounting), pairs.seen(board)
    here = arm[train], seen[train]
    mount, tool, apart = _rotations(*here)
    if apart > _APART:
        raise DataError(
            f"rotations of flange and board lie {_deg(apart)} apart, wherever camera and board are: do both poses of a "
            "row belong together, and is rotation= right?"
        )
    return Start(arm, seen, *_places(*here, mount, tool, pairs), notes)


def arm_poses(flange: Array, mounting: str) -> Array:
    """Return what stands between mount and tool, (n, 4, 4): the flange's poses, or their inverse with the eye in it."""
    return np.asarray(inverse(flange)) if mounting == "eye_in_hand" else flange


def _tried(pairs: Pairs, mounting: str, train: Mask) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Return the poses of arm and board of `train` (n,) for each meaning of both rotations."""
    return {
        (flange, board): (
            arm_poses(pairs.moved(flange), mounting)[train],
            pairs.seen(board)[train],
        )
        for flange, board in product(pairs.flange.meanings, pairs.board.meanings)
    }


def _meaning(pairs: Pairs, apart: Mapping[tuple[str, str], float]) -> tuple[str, str, tuple[str, ...]]:
    """Return what the rotations of flange and board mean, and remarks; `apart` is what each meaning of both leaves."""
    ranked = sorted(apart, key=lambda key: apart[key])
    chosen = ranked[0]
    notes = []
    for k, pose in enumerate((pairs.flange, pairs.board)):
        named = next(iter(pose.meanings))
        if _quaternion(pose):
            kept = [key for key in ranked if key[k] == named and key[1 - k] == chosen[1 - k]]
            if chosen[k] != named and apart[kept[0]] > _TIMES * max(apart[chosen], _ROUNDING):
                raise DataError(_real_part_first(pose, apart[kept[0]], apart[chosen]))
            chosen = (named, chosen[1]) if k == 0 else (chosen[0], named)
            continue
        for other in ranked:
            if other[k] == chosen[k] or other[1 - k] != chosen[1 - k]:
                continue
            a, b = (pairs.flange, pairs.board)[k].meanings[chosen[k]], pose.meanings[other[k]]
            if apart[other] < _TWICE * max(apart[chosen], _ROUNDING) and not np.allclose(a, b, atol=1e-3):
                side = ("flange", "board")[k]
                raise DataError(
                    f"{', '.join(pose.columns[3:])} may be {chosen[k]}, or {other[k]}: rotation={side}:vector (or rpy, "
                    "xyz) states which"
                )
        if len(pose.meanings) > 1:
            notes.append(f"{', '.join(pose.columns[3:])} are read as {chosen[k]}, which alone fits")
    return (*chosen, tuple(notes))


def _quaternion(pose: Pose) -> bool:
    return len(pose.columns) == 7


def _real_part_first(pose: Pose, named: float, other: float) -> str:
    names = pose.columns[3:]
    side = names[0].rpartition("_")[0] or "board"
    order = {f"{side}_{q}": name for q, name in zip(("qw", "qx", "qy", "qz"), names, strict=True)}
    return (
        f"{', '.join(names)} fit {_more(named, other)} times better if the first of them is the real part of the "
        f"quaternion: {as_columns(order)}"
    )


def _check_sides(
    pairs: Pairs, tried: Mapping[tuple[str, str], tuple[Array, Array]], left: float, mounting: str
) -> None:
    """Refuse poses that fit far better with one side inverted, or with rows out of step, in some meaning."""
    n = len(next(iter(tried.values()))[0])
    better = min(_misfit(arm, np.asarray(inverse(seen))) for arm, seen in tried.values())
    if n > 3 and left > _TIMES * max(better, _ROUNDING):
        other = "camera_in_board" if pairs.read == "board_in_camera" else "board_in_camera"
        mount = "eye_to_hand" if mounting == "eye_in_hand" else "eye_in_hand"
        raise DataError(
            f"the poses fit {_more(left, better)} times better with one side inverted: the camera's columns are "
            f"read={other}, or the camera is mounted hand_eye={mount}, or the flange's columns hold the base in the "
            f"flange: flange={pairs.other_flange}"
        )
    for lag, where in ((1, "below"), (-1, "above")) if n > 5 else ():
        better = min(
            _misfit(arm[max(-lag, 0) : n - max(lag, 0)], seen[max(lag, 0) : n - max(-lag, 0)])
            for arm, seen in tried.values()
        )
        if left > _TIMES * max(better, _ROUNDING):
            raise DataError(
                f"the poses fit {_more(left, better)} times better if the board's pose of each row stands in the row "
                f"{where}: the rows of one of both are out of step by one"
            )


def _more(left: float, better: float) -> str:
    return plain(left / max(better, _ROUNDING), 2)


def _deg(angle: float) -> str:
    return f"{plain(float(np.rad2deg(angle)), 2)}°"


def _misfit(arm: Array, seen: Array) -> float:
    """Return what rotations leave of the middle pair [rad], and places beside the board's distance, in any unit."""
    mount, _, apart = _rotations(arm, seen)
    rows, wanted = _linear(arm, seen, mount)
    distance = float(np.median(np.linalg.norm(seen[:, :3, 3], axis=1))) + _ROUNDING
    scales = [by for size in _SCALES.values() for by in {size, 1 / size}]
    return apart + min(_nearest(rows[:, :, :6], wanted - by * rows[:, :, 6])[1] / (by * distance) for by in scales)


def _rotations(arm: Array, seen: Array) -> tuple[Array, Array, float]:
    """Return the rotations of mount and tool, (3, 3), and the angle [rad] that they leave of the middle pair."""
    arm, seen, n = arm[:, :3, :3], seen[:, :3, :3], len(arm)
    rows = np.zeros((n, 9, 18))
    for i, j in product(range(3), range(3)):  # (U B)_ij - (A V)_ij, of U and V by rows
        rows[:, 3 * i + j, 3 * i : 3 * i + 3] = seen[:, :, j]
        rows[:, 3 * i + j, 9 + j : 18 : 3] = -arm[:, i, :]
    best = _solved(rows.reshape(1, -1, 18))
    left = _left(arm, seen, best)
    if n > 2 * _HANDFUL:
        rng = np.random.default_rng(np.random.SeedSequence([n, 18]))
        picks = np.argsort(rng.random((_HANDFULS, n)), axis=1)[:, :_HANDFUL]
        tried = np.concatenate([best, _solved(rows[picks].reshape(_HANDFULS, -1, 18))])
        left = _left(arm, seen, tried)
        best = tried[[np.argmin(np.median(left, axis=1))]]
        before = np.zeros(0, dtype=bool)
        for _ in range(3):
            left = _left(arm, seen, best)[0]
            near = left <= max(_FAR * float(np.median(left)), _ROUNDING)
            if np.array_equal(near, before):
                break
            before = near
            best = _solved(rows[near].reshape(1, -1, 18))
        left = _left(arm, seen, best)
    return best[0, 0].T, best[0, 1], float(np.median(left))


def _solved(rows: Array) -> Array:
    """Return U and V, (k, 2, 3, 3), rotations nearest to the null vectors of `rows`, (k, m, 18)."""
    vectors = np.linalg.eigh(rows.swapaxes(1, 2) @ rows)[1][:, :, 0].reshape(-1, 2, 3, 3)
    senses = np.sign(np.linalg.det(vectors[:, 0]) + np.linalg.det(vectors[:, 1]))
    vectors = vectors * np.where(senses == 0, 1.0, senses)[:, None, None, None]
    return nearest_rotation(vectors)


def _left(arm: Array, seen: Array, found: Array) -> Array:
    """Return the angle [rad] that rotations `found`, (k, 2, 3, 3), leave of each pair, (k, n)."""
    by_board, by_arm = found[:, 0, None] @ seen, arm @ found[:, 1, None]
    return angle_between(by_board.reshape(-1, 3, 3), by_arm.reshape(-1, 3, 3)).reshape(len(found), -1)


def _places(arm: Array, seen: Array, mount: Array, tool: Array, pairs: Pairs) -> tuple[Array, Array]:
    """Return mount and tool, (4, 4) [mm], from their rotations; refuse places whose units do not go together."""
    rows, wanted = _linear(arm, seen, mount)
    plain_, left = _nearest(rows[:, :, :6], wanted - rows[:, :, 6])
    scaled, free = _nearest(rows, wanted)
    others = rows[:, :, :6].reshape(-1, 6)
    column = rows[:, :, 6].ravel()
    beside = column - others @ np.linalg.lstsq(others, column, rcond=1e-9)[0]
    told = np.linalg.norm(beside) > _ALIKE * np.linalg.norm(column)
    if told and scaled[6] > 0 and left > _TIMES * max(free, _ROUNDING) and len(arm) > 3:
        raise DataError(_of_scale(pairs, float(scaled[6]), left, free))
    made = np.tile(np.eye(4), (2, 1, 1))
    made[0, :3, :3], made[1, :3, :3] = mount, tool
    made[0, :3, 3], made[1, :3, 3] = plain_[3:6], plain_[:3]
    return made[0], made[1]


def _linear(arm: Array, seen: Array, mount: Array) -> tuple[Array, Array]:
    """Return the equations of the places, (n, 3, 7) and (n, 3): for tool, mount, and the scale of the board's."""
    rows = np.zeros((len(arm), 3, 7))
    rows[:, :, :3] = mount @ arm[:, :3, :3]
    rows[:, :, 3:6] = np.eye(3)
    rows[:, :, 6] = -seen[:, :3, 3]
    return rows, -(arm[:, :3, 3] @ mount.T)


def _of_scale(pairs: Pairs, scale: float, left: float, free: float) -> str:
    """Return what is wrong with places of which those of the board fit the flange's when they are `scale` times."""
    told = (
        f"places of flange and board lie {plain(left)} mm apart, and {plain(max(free, _ROUNDING))} mm if those of the"
    )
    for side, other, pose, by in (
        ("board", "flange", pairs.board, scale), ("flange", "board", pairs.flange, 1 / scale)
    ):  # fmt: skip
        unit = next((u for u, size in _SCALES.items() if by > 1 and abs(by / size - 1) < _NEAR), "mm")
        if unit != "mm":
            named = ",".join(f"{name}:{unit}" for name in pose.columns[:3])
            return (
                f"{told} {side} are {plain(by, 3)} times as far: units={named} if they are {unit}, or the unit of the "
                f"{other}'s is another"
            )
    return (
        f"{told} board are {plain(scale, 5)} times as far: is the size of its squares or markers the true one? "
        f"If they are {plain(pairs.board_scale * scale, 4)} times as large as the camera was told: "
        f"board_scale={plain(pairs.board_scale * scale, 5)}"
    )


def _nearest(rows: Array, wanted: Array) -> tuple[Array, float]:
    """Return the least squares solution of `rows` (n, 3, k) without far pairs, and what the middle pair leaves."""
    near = np.ones(len(rows), dtype=bool)
    for _ in range(6):
        found = np.linalg.lstsq(rows[near].reshape(-1, rows.shape[2]), wanted[near].ravel(), rcond=1e-9)[0]
        left = np.linalg.norm(rows @ found - wanted, axis=1)
        before, middle = near, float(np.median(left))
        near = left <= max(_FAR * middle, _ROUNDING)
        if np.array_equal(near, before):  # and so is all that follows from it
            break
    return np.asarray(found, dtype=float), middle
