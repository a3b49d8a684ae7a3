"""What was moved while an arm was read: its base or the tracker, the target on its link, the zero of a joint.

A motion adds columns to the linear model at the fit, for the readings that were taken after it. It counts by what it
explains of the squares that are left, beside all numbers that were fitted.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np

from calibench.calibration.determined import information_of
from calibench.calibration.model import ArmModel
from calibench.calibration.normal import covariance_of
from calibench.calibration.rigid import Array, Index, Mask, cross

_EDGE = 8  # readings before and after a motion, at the least
_LEAST = 5  # wild readings that can be one motion
_PLAIN = 0.5  # of what a fit leaves, in squares: a motion that explains as much is told
_OF_WILD = 0.9  # the same of the middle one of wild readings, a handful of which fits any motion by half
_SHOWN, _ENDS = 6000, 200  # readings that are looked at, and motions that are tried at a time
_SAME = 1e-6  # of a column, in squares: a motion of which the fit has taken all but this is not seen


@final
@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of `what`: "base", "target", or the name of a joint, in force at `rows`.

    It moves their places by `off`, rms [mm], and explains the `share` of the squares that were left.
    """

    what: str
    rows: Index
    off: float
    share: float


def motion_from(model: ArmModel, p: Array, kept: Index, wild: Mask) -> Motion | None:
    """Return the motion after which the readings lie elsewhere, from one row to the last; None if none is plain.

    `kept` are the numbers that were fitted to all but the `wild` readings, (n,). Places are needed, not parts of them.
    """
    known = np.flatnonzero(~wild)
    if not _asked(model) or len(known) < 2 * _EDGE + 1:
        return None
    shown = known[np.linspace(0, len(known) - 1, min(len(known), _SHOWN)).astype(np.int64)]
    left, best = _Left(model.at(shown), p, kept), None
    ends = np.arange(_EDGE, len(shown) - _EDGE)
    while len(ends):
        tried = ends[np.linspace(0, len(ends) - 1, min(len(ends), _ENDS)).astype(np.int64)]
        best = max(left.after(tried), key=lambda one: one.share)
        at = int(best.rows[0])
        ends = ends[abs(ends - at) < len(ends) // _ENDS] if len(ends) > _ENDS else ends[:0]
    assert best is not None
    return replace(best, rows=shown[best.rows]) if best.share > _PLAIN else None


def motion_of_wild(model: ArmModel, p: Array, kept: Index, wild: Mask) -> Motion | None:
    """Return the likeliest motion of the `wild` readings, (n,), `share` being of a middle one; None if it fits none."""
    rows = np.flatnonzero(wild)
    if not _asked(model) or len(rows) < _LEAST or len(wild) > _SHOWN:
        return None
    left, found = _Left(model, p, kept), list[tuple[float, Motion]]()
    some, rest = left.columns[rows], left.columns[rows, :, -1]
    for what, at in left.kinds:
        ways = some[:, :, left.fitted :][:, :, at]
        by = ways @ np.linalg.lstsq(ways.reshape(-1, ways.shape[2]), rest.ravel(), rcond=_SAME)[0]
        size, beside = ((one**2).sum(axis=1) for one in (rest, rest - by))
        unlikely = rest.size * np.log(beside.sum() + 1e-300) + ways.shape[2] * np.log(rest.size)
        off, share = float(np.sqrt((by**2).sum(axis=1).mean())), 1 - float(np.median(beside / size))
        found.append((unlikely, Motion(what, rows, off, share)))
    motion = min(found, key=lambda one: one[0])[1]
    return motion if motion.share > _OF_WILD else None


def _asked(model: ArmModel) -> bool:
    return model.position is not None and model.loci is None and not model.sees


class _Left:
    """What a fit leaves of places, and the columns of its numbers and of each motion: (n, 3, columns)."""

    def __init__(self, model: ArmModel, p: Array, kept: Index) -> None:
        assert model.position is not None
        poses, rest = model.placed(p), model.errors(p)[0]
        about = (model.position - model.position.mean(axis=0)) / max(float(np.ptp(model.position)), 1e-9)
        of_base = np.concatenate(
            [np.broadcast_to(np.eye(3), (len(rest), 3, 3)), cross(np.eye(3), about[:, None]).swapaxes(1, 2)], axis=2
        )
        zeros = [k for k, name in enumerate(model.names) if name.partition("_")[0] in ("zero", "theta")]
        motions = [of_base, poses[:, :3, :3], model.slopes(p, np.array(zeros, dtype=np.int64))[:, :3]]
        self.columns = np.concatenate([model.slopes(p, kept)[:, :3], *motions, rest[:, :, None]], axis=2)
        self.every, self.fitted = self._square(np.arange(len(rest))), len(kept)
        known = model.sigma[0] ** 2 * information_of(model)[kept]
        self.covariance = covariance_of(self.every[: len(kept), : len(kept)] + np.diag(known))
        joints = [(model.names[k].partition("_")[2], slice(9 + j, 10 + j)) for j, k in enumerate(zeros)]
        self.kinds = [("base", slice(0, 6)), ("target", slice(6, 9)), *joints]

    def after(self, ends: Index) -> list[Motion]:
        """Return the likeliest motion at each of these readings, in order of time, of it and all that follow."""
        pieces = np.array([self._square(np.arange(a, b)) for a, b in pairwise([*ends, len(self.columns)])])
        parts = pieces[::-1].cumsum(axis=0)[::-1]
        return [self._likeliest(part, np.arange(end, len(self.columns))) for end, part in zip(ends, parts, strict=True)]

    def _square(self, rows: Index) -> Array:
        some = self.columns[rows].reshape(-1, self.columns.shape[2])
        return np.asarray(some.T @ some)

    def _likeliest(self, part: Array, rows: Index) -> Motion:
        k, count = self.fitted, 3 * len(self.columns)
        beside, pulled = part[:k, k:-1], self.covariance @ self.every[:k, -1]
        square = part[k:-1, k:-1] - beside.T @ self.covariance @ beside
        pull = part[k:-1, -1] - beside.T @ pulled
        total = float(self.every[-1, -1] - self.every[:k, -1] @ pulled)
        best, least = None, np.inf
        for what, at in self.kinds:
            scale = np.sqrt(np.diag(part)[k:-1][at]) + 1e-12
            values, ways = np.linalg.eigh(square[at, at] / np.outer(scale, scale))
            seen = values > _SAME
            way = ways[:, seen] @ ((ways[:, seen].T @ (pull[at] / scale)) / values[seen]) / scale
            share = min(float(way @ pull[at]) / max(total, 1e-300), 1.0)
            unlikely = count * np.log(max(1 - share, 1e-12)) + len(scale) * np.log(count)  # Schwarz 1978
            if unlikely < least:
                off = float(np.sqrt(way @ part[k:-1, k:-1][at, at] @ way / len(rows)))
                best, least = Motion(what, rows, off, share), unlikely
        assert best is not None
        return best
