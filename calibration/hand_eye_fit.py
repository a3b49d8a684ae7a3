"""The one fit of a hand-eye calibration: both frames, and beside them the offset of two clocks and the board's scale.

The board is seen at B = k M A(t - offset) T: mount M, arm A, tool T, and the scale k of places alone. Noise lies along
the line of sight, across it, about the board's normal and across that; where the residuals do not tell these apart it
is one of places and one of rotations. Each is what is left over its degrees of freedom (Rao 1971). Pairs beyond six
times the middle residual have no weight, from a start that knows which are near (a skipped mean, Hampel 1985).
Residuals that follow their neighbours in order of rows count as fewer (first order of Newey and West 1987).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import fdtrc, ndtri

from calibench.calibration.normal import covariance_of, descend
from calibench.calibration.rigid import Array, Index, Mask, inverse, rotation_of, rpy_of, vector_of

_FLOOR = 1e-9  # mm or rad: the noise of readings without any
_WILD = 6.0  # times the median residual: a pair beyond has no say
_ROUNDS, _SETTLED, _SETTLED_TO = 30, 1e-4, 1e-11
_TINY = 1e-6  # of what is left of a pair: a direction that it alone tells
_NOTHING = 1e-300
_LEAST = 1.0  # degree of freedom: with fewer nothing tells a noise
_CHANCE = 1e-3  # of noise alone to look like directions that differ, or like neighbours that agree
_ROWS = 10  # pairs: with fewer neither is tested
_GAP = 5.0  # times the middle step of the robot's stamps: longer is a drop, and nothing is read in it
_WHOLE, _APART = np.array([0, 0, 0, 1, 1, 1]), np.array([0, 2, 2, 1, 3, 3])


@final
@dataclass(frozen=True, eq=False)
class Track:
    """The poses of the flange (m, 4, 4) [mm] at rising times (m,) [s], a line and a turn from each to the next."""

    time: Array
    poses: Array

    def at(self, time: Array) -> Array:
        """Return the poses at `time` (n,), held at both ends: (n, 4, 4)."""
        time = np.clip(time, self.time[0], self.time[-1])
        made = np.tile(np.eye(4), (len(time), 1, 1))
        made[:, :3, :3] = Slerp(self.time, Rotation.from_matrix(self.poses[:, :3, :3]))(time).as_matrix()
        made[:, :3, 3] = np.column_stack([np.interp(time, self.time, one) for one in self.poses[:, :3, 3].T])
        return made

    def has(self, time: Array) -> Mask:
        """Return which of `time` (n,) lie between two poses without a gap, (n,)."""
        steps = np.diff(self.time)
        after = np.clip(np.searchsorted(self.time, time), 1, len(steps)) - 1
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        return np.asarray(inside & (steps[after] <= _GAP * np.median(steps)))


@final
@dataclass(frozen=True, eq=False)
class Sight:
    """What was seen: the board in the camera `seen` (n, 4, 4) for the `arm`'s poses (n, 4, 4) [mm].

    With `time` (n,) of the camera [s] and a `track` the arm's poses are read there, inverted for an `eye_in_hand`.
    """

    arm: Array
    seen: Array
    time: Array | None = None
    track: Track | None = None
    eye_in_hand: bool = False

    def at(self, keep: Mask) -> Sight:
        """Return some of the pairs."""
        return replace(
            self, arm=self.arm[keep], seen=self.seen[keep], time=None if self.time is None else self.time[keep]
        )

    def moved(self, offset: float) -> Array:
        """Return the arm's poses (n, 4, 4) where the camera's clock is `offset` [s] ahead of the robot's."""
        if self.track is None or self.time is None:
            return self.arm
        flange = self.track.at(self.time - offset)
        return np.asarray(inverse(flange)) if self.eye_in_hand else flange


@final
@dataclass(frozen=True, eq=False)
class Adjustment:
    """Mount and tool (4, 4) [mm], offset [s], scale; the covariance of their errors by noises, `parts` (g, k, k).

    An error is a shift [mm] and a turn [rad] behind mount and tool, then of what is `free` beside them. `noise` (g,) is
    that of each group of the axes, `groups` (6,), and its degrees of `freedom` (g,) are infinite where it was stated.
    `wild` (n,) are pairs without influence; `position` and `turned` (n, 3) [mm], [rad] what is left.
    `axes` (n, 6, 6) turns residuals into the axes of the noise. `alike` (g,) is how far neighbours in order of rows
    agree, 0 where noise alone does so.
    """

    sight: Sight
    mount: Array
    tool: Array
    offset: float
    scale: float
    free: tuple[str, ...]
    parts: Array
    noise: Array
    freedom: Array
    groups: Index
    wild: Mask
    position: Array
    turned: Array
    axes: Array
    alike: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def sigma(self) -> tuple[float, float]:
        """Return the noise of a place [mm] and a rotation [rad], the mean square over the axes."""
        square = self.noise[self.groups] ** 2
        return float(np.sqrt(square[:3].mean())), float(np.sqrt(square[3:].mean()))

    def errors(self, sight: Sight) -> tuple[Array, Array]:
        """Return what these frames leave of pairs, (n, 3) [mm] and (n, 3) [rad]."""
        return _errors(sight, self.mount, self.tool, self.offset, self.scale)


def adjust(
    sight: Sight, mount: Array, tool: Array, stated: tuple[float, float] = (0.0, 0.0), *, near: Mask | None = None,
    free: tuple[str, ...] = (), offset: float = 0.0,
) -> Adjustment:  # fmt: skip
    """Return the fit of mount and tool, and of what is `free` beside them: offset, scale, from pairs that are `near`.

    `stated` is the noise of a place [mm] and a rotation [rad], 0 to learn it.
    """
    n, known = len(sight.seen), np.array(stated)
    position, turned = _errors(sight, mount, tool, offset, 1.0)
    begin = Adjustment(
        sight=sight, mount=mount, tool=tool, offset=offset, scale=1.0, free=free, parts=np.zeros((2, 12, 12)),
        noise=np.where(known > 0, known, [1.0, 1e-3]), freedom=np.full(2, np.inf), groups=_WHOLE,
        wild=np.zeros(n, dtype=bool) if near is None else ~near, position=position, turned=turned,
        axes=np.tile(np.eye(6), (n, 1, 1)),
    )  # fmt: skip
    found = _settle(begin, known)

    # the axes of noise are apart where what is left of them differs more than noise would
    kept, groups = ~found.wild, _WHOLE.copy()
    if kept.sum() >= _ROWS:
        as_apart = _turned(replace(found, groups=_APART, noise=found.noise[[0, 1, 0, 1]]))
        found_apart = _with_noise(as_apart, _left(as_apart), np.zeros(4))
        for k in (0, 1):
            along, across = found_apart.noise[k], found_apart.noise[k + 2]
            if known[k] or max(along, across) <= 1e3 * _FLOOR:
                continue
            ratio = (along / across) ** 2
            chance = fdtrc(found_apart.freedom[k], found_apart.freedom[k + 2], ratio)
            if min(chance, 1 - chance) < _CHANCE / 2:
                groups[3 * k + 1 : 3 * k + 3] = k + 2
    if not np.array_equal(groups, found.groups):
        used = np.unique(groups)
        groups = np.searchsorted(used, groups)
        noise = found.noise[used % 2]
        found = _settle(replace(found, groups=groups, noise=noise), known[used % 2])
    # wider errors where residuals follow those of the row before: the first lag of Newey and West
    residuals = _slopes(found)[1][~found.wild]
    alike = np.zeros(len(found.noise))
    if len(residuals) >= _ROWS:
        for g in range(len(alike)):
            one = residuals[:, found.groups == g]
            one = one - one.mean(axis=0)
            r = float((one[1:] * one[:-1]).sum() / max(float((one**2).sum()), _FLOOR))
            if found.noise[g] > 1e3 * _FLOOR and r * np.sqrt(one.size) > ndtri(1 - _CHANCE):
                alike[g] = min(r, 0.98)
    fewer = (1 + alike) / (1 - alike)
    freedom = np.maximum(found.freedom / fewer, _LEAST)
    return replace(found, parts=found.parts * fewer[:, None, None], freedom=freedom, alike=alike)


def errors_of(found: Adjustment, slopes: Array) -> tuple[Array, Array]:
    """Return standard errors (m,) of numbers with `slopes` (m, k), and their degrees of freedom (m,).

    Where a noise is stated it is that of its axes; of learned ones Satterthwaite's freedom. Else what is left of pairs
    tells both, see `_by_pairs`.
    """
    if np.isfinite(found.freedom).all():
        variance, freedom = _by_pairs(found, slopes)
    else:
        k = slopes.shape[1]
        parts = np.einsum("mi,pij,mj->pm", slopes, found.parts[:, :k, :k], slopes)
        variance, squares = parts.sum(axis=0), (parts**2 / found.freedom[:, None]).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = np.where(squares > 0, variance**2 / squares, np.inf)
    return np.sqrt(variance), freedom


def _by_pairs(found: Adjustment, slopes: Array) -> tuple[Array, Array]:
    """Return variances (m,) of numbers with `slopes` (m, k) by what is left of each pair, and degrees of freedom (m,).

    The six residuals of a pair may have any covariance, as an error of the robot's turn gives them: pairs are clusters
    (Liang and Zeger 1986). What is left of one is made as large as before the fit took its share (CR2), and the freedom
    is that of noise of one size (Bell and McCaffrey 2002). Where pairs follow their neighbours they count as fewer.
    """
    rows, inverted = _rows_of(found)
    values, vectors = np.linalg.eigh(np.eye(6) - rows @ inverted @ rows.swapaxes(1, 2))
    root = vectors * np.maximum(values, _TINY)[:, None] ** -0.5 @ vectors.swapaxes(1, 2)
    pulls = np.einsum("nij,njk,mk->mni", root, rows, slopes @ inverted[: slopes.shape[1]], optimize=True)
    moved = (pulls * _slopes(found)[1]).sum(axis=2)
    own, shared = (pulls**2).sum(axis=2), np.einsum("nik,mni->mnk", rows, pulls)
    theirs = ((shared @ inverted) * shared).sum(axis=2)
    common = shared.swapaxes(1, 2) @ shared @ inverted
    squares = (own**2 - 2 * own * theirs).sum(axis=1) + (common * common.swapaxes(1, 2)).sum(axis=(1, 2))
    freedom = (own - theirs).sum(axis=1) ** 2 / np.maximum(squares, _NOTHING)
    fewer = float(((1 + found.alike) / (1 - found.alike)).max())
    return (moved**2).sum(axis=1) * fewer, np.maximum(freedom / fewer, _LEAST)


def again(found: Adjustment, keep: Mask) -> Adjustment:
    """Return the fit to the pairs of `keep` (n,) alone, with the noise and the weights of the fit to all."""
    sight = found.sight.at(keep)
    position, turned = found.errors(sight)
    wild, axes = found.wild[keep], found.axes[keep]
    return _step_down(replace(found, sight=sight, wild=wild, position=position, turned=turned, axes=axes))


def _settle(found: Adjustment, stated: Array) -> Adjustment:
    """Return the fit under the noise that it leaves; `stated` (g,) is that which is known, 0 to learn it."""
    for _ in range(_ROUNDS):
        before = found
        found = _step_down(_turned(found))
        left = _left(found)
        size = np.linalg.norm((left / found.noise[found.groups]).reshape(-1, 2, 3), axis=2)
        middle = np.median(size[~found.wild], axis=0)
        floor = 1e3 * _FLOOR / found.noise[found.groups[[0, 3]]]
        found = replace(found, wild=(size > _WILD * np.maximum(middle, floor)).any(axis=1))
        found = _with_noise(found, left, stated)
        same = np.array_equal(found.wild, before.wild)
        if same and np.allclose(found.noise, before.noise, rtol=_SETTLED, atol=0.0):
            break
    found = _step_down(found)
    rows, inverted = _rows_of(found)
    k = inverted.shape[0]
    parts = [rows[:, found.groups == g].reshape(-1, k) for g in range(len(found.noise))]
    return replace(found, parts=np.stack([inverted @ part.T @ part @ inverted for part in parts]))


def _with_noise(found: Adjustment, left: Array, stated: Array) -> Adjustment:
    """Return the fit with the noise of each group by what is `left`, and its degrees of freedom."""
    rows, inverted = _rows_of(found)
    kept, noise, freedom = ~found.wild, found.noise.copy(), np.full(len(found.noise), np.inf)
    for g in range(len(noise)):
        if not stated[g]:
            part = rows[:, found.groups == g].reshape(-1, len(inverted))
            count = int((found.groups == g).sum()) * int(kept.sum())
            freedom[g] = max(count - float(np.einsum("mi,ij,mj->", part, inverted, part)), _LEAST)
            square = float((left[kept][:, found.groups == g] ** 2).sum())
            noise[g] = max(float(np.sqrt(square / freedom[g])), _FLOOR)
    return replace(found, noise=noise, freedom=freedom)


def _step_down(found: Adjustment) -> Adjustment:
    """Return the least squares solution under the noise of `found`."""
    return descend(found, _value, lambda one: _equations(*_slopes(one)), _moved, _SETTLED_TO)


def _equations(rows: Array, residuals: Array) -> tuple[Array, Array]:
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat, flat.T @ residuals.ravel()


def _moved(found: Adjustment, step: Array) -> Adjustment:
    frames = []
    for frame, by in ((found.mount, step[:6]), (found.tool, step[6:12])):
        made = np.eye(4)
        made[:3, :3] = frame[:3, :3] @ rotation_of(by[None, 3:])[0]
        made[:3, 3] = frame[:3, 3] + frame[:3, :3] @ by[:3]
        frames.append(made)
    beside = dict(zip(found.free, step[12:], strict=True))
    offset, scale = found.offset + beside.get("offset", 0.0), found.scale + beside.get("scale", 0.0)
    position, turned = _errors(found.sight, frames[0], frames[1], offset, scale)
    return replace(
        found, mount=frames[0], tool=frames[1], offset=offset, scale=scale, position=position, turned=turned
    )  # fmt: skip


def _errors(sight: Sight, mount: Array, tool: Array, offset: float, scale: float) -> tuple[Array, Array]:
    poses = mount @ sight.moved(offset) @ tool
    position = scale * poses[:, :3, 3] - sight.seen[:, :3, 3]
    return position, vector_of(poses[:, :3, :3] @ sight.seen[:, :3, :3].swapaxes(1, 2))


def _turned(found: Adjustment) -> Adjustment:
    """Return the fit with the axes of its noise: line of sight and across, the board's normal and across.

    They are those of where the board is by the fit. Of what was seen, noise would turn them, and where it is larger
    along them than across that moves the frames.
    """
    if len(found.noise) == 2:
        return found
    axes, board = np.zeros_like(found.axes), found.mount @ found.sight.moved(found.offset) @ found.tool
    way = board[:, :3, 3] / (np.linalg.norm(board[:, :3, 3], axis=1, keepdims=True) + _FLOOR)
    basis = np.linalg.qr(np.concatenate([way[:, :, None], np.tile(np.eye(3), (len(way), 1, 1))], axis=2))[0]
    axes[:, :3, :3] = basis.swapaxes(1, 2)
    axes[:, 3:, 3:] = board[:, :3, [2, 0, 1]].swapaxes(1, 2)
    return replace(found, axes=axes)


def _left(found: Adjustment) -> Array:
    """Return what is left of the pairs in the axes of the noise, (n, 6)."""
    return np.asarray((found.axes @ np.column_stack([found.position, found.turned])[:, :, None])[:, :, 0])


def _slopes(found: Adjustment) -> tuple[Array, Array]:
    """Return slopes (n, 6, k) and residuals (n, 6) over their noise, 0 for wild pairs."""
    sight, n = found.sight, len(found.sight.seen)
    arm = sight.moved(found.offset)
    turn, place, of_mount = arm @ found.tool, arm[:, :3, :3] @ found.tool[:3, 3], found.mount[:3, :3]
    place = place + arm[:, :3, 3]
    whole = of_mount @ turn[:, :3, :3]
    rows = np.zeros((n, 6, 12 + len(found.free)))
    across = np.cross(np.eye(3)[None], place[:, None, :])  # e_i x place, (n, i, 3)
    rows[:, :3, :3], rows[:, 3:, 3:6] = of_mount, of_mount
    rows[:, :3, 3:6] = of_mount @ across.swapaxes(1, 2)
    rows[:, :3, 6:9] = rows[:, 3:, 9:12] = whole
    rows[:, :3] *= found.scale
    for k, name in enumerate(found.free, start=12):
        if name == "scale":
            rows[:, :3, k] = found.position + sight.seen[:, :3, 3]
            rows[:, :3, k] /= found.scale
        else:
            assert sight.track is not None
            h = float(np.median(np.diff(sight.track.time)))
            ends = [
                np.column_stack(_errors(sight, found.mount, found.tool, found.offset + s, found.scale)) for s in (h, -h)
            ]
            rows[:, :, k] = (ends[0] - ends[1]) / (2 * h)
    over = np.where(found.wild[:, None], 0.0, 1 / found.noise[found.groups])
    axes = found.axes * over[:, :, None]
    return axes @ rows, _left(found) * over


def _rows_of(found: Adjustment) -> tuple[Array, Array]:
    """Return slopes over their noise (n, 6, k), and the inverse of their information (k, k)."""
    rows, residuals = _slopes(found)
    return rows, covariance_of(_equations(rows, residuals)[0])


def _value(found: Adjustment) -> float:
    value = float(((_left(found)[~found.wild] / found.noise[found.groups]) ** 2).sum())
    return value if np.isfinite(value) else np.inf


def stands_of(poses: Array) -> Array:
    """Return six numbers of `poses` (n, 4, 4) that tell the same poses apart: x y z [mm], yaw, pitch, roll [rad]."""
    angles = rpy_of(poses)[:, ::-1]
    middle = np.arctan2(np.sin(angles).mean(axis=0), np.cos(angles).mean(axis=0))
    return np.column_stack([poses[:, :3, 3], middle + (angles - middle + np.pi) % (2 * np.pi) - np.pi])
