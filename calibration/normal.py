"""Normal equations of an arm's readings, summed over groups of poses: what fits, folds and draws have in common.

Of residuals r(p + s) = r + J s only J'J, J'r and r'r are kept, for each group of poses apart. A fold's fit is the sum
of the other groups and one solution of k numbers; so is a draw of poses, any choice of columns, and any prior. J itself
is made for some thousand poses at once, so that 100 000 take no more room than their readings.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar, final

import numpy as np

from calibench.calibration.model import ArmModel
from calibench.calibration.rigid import Array, Index

_AT_ONCE = 2048  # poses whose J is there at the same time
_NOTHING = 1e-150  # in the place of the length of a column of zeros
_SINGULAR = 1e-13  # of the largest eigenvalue, columns being scaled: below it a direction moves no residual
_STEPS, _TRIES = 60, 12
At = TypeVar("At")


@final
@dataclass(frozen=True, eq=False)
class Blocks:
    """Sums over the poses of each group, residuals in units of the noise: `gram` J'J (g, k, k), `slope` J'r (g, k),

    `square` r'r (g,), and the `count` (g,) of residuals of poses with an influence.
    """

    gram: Array
    slope: Array
    square: Array
    count: Array

    def sum(self) -> "Blocks":
        """Return one group of all."""
        return self.by(np.ones((1, len(self.gram))))

    def by(self, weights: Array) -> "Blocks":
        """Return groups that take each of these by `weights`, (new, g)."""
        gram = (weights @ self.gram.reshape(len(self.gram), -1)).reshape(-1, *self.gram.shape[1:])
        return Blocks(gram, weights @ self.slope, weights @ self.square, weights @ self.count)


def normal_blocks(
    model: ArmModel, p: Array, free: Index, weights: Array, group: Index | None = None, soft: bool = False
) -> Blocks:
    """Return the normal equations in the parameters `free` at p; `group`, (n,) 0, 1, ..., sums poses, None all.

    `weights` (n,) are those of readings; with `soft` one of three times the noise counts less. Of sockets a group has
    whole places, as a socket's point is the mean of all that was read in it.
    """
    group = np.zeros(len(weights), dtype=np.int64) if group is None else group
    count, k, counted = int(group.max(initial=0)) + 1, len(free), model.counted
    sums = Blocks(np.zeros((count, k, k)), np.zeros((count, k)), np.zeros(count), np.zeros(count))
    for there, rows, over, more, far in _parts(model, p, free, weights, np.argsort(group, kind="stable")):
        known = weights[there]
        by = np.sqrt(known / np.sqrt(1 + (over**2).sum(axis=1) / 9) if soft else known)
        rows, over = rows * by[:, None, None], over * by[:, None]
        ends = np.flatnonzero(np.diff(group[there], prepend=-1, append=-1))
        for a, b in pairwise(ends.tolist()):
            used = float(counted[there[a:b]][known[a:b] > 0].sum())
            _add(sums, int(group[there[a]]), rows[a:b].reshape(-1, k), over[a:b].ravel(), used)
        for (socket, _), row, one in zip(model.pairs() if len(far) else (), more, far, strict=True):
            _add(sums, int(group[model.socket == socket][0]), row[None], one[None], 0.0)
    return sums


def _parts(
    model: ArmModel, p: Array, free: Index, weights: Array, order: Index
) -> Iterator[tuple[Index, Array, Array, Array, Array]]:
    """Yield places of poses in `order`, and of these slopes and residuals, and of known distances; sockets as one."""
    if model.position is None:
        rows, more = model.jacobian(p, free, weights)
        over, far = model.residuals(p, weights)
        yield order, rows[order], over[order], more, far
        return
    for first in range(0, len(order), _AT_ONCE):
        there = order[first : first + _AT_ONCE]
        part = model.at(there)
        rows, more = part.jacobian(p, free, weights[there])
        over, far = part.residuals(p, weights[there])
        yield there, rows, over, more, far


def _add(sums: Blocks, g: int, rows: Array, residuals: Array, count: float) -> None:
    sums.gram[g] += rows.T @ rows
    sums.slope[g] += rows.T @ residuals
    sums.square[g] += residuals @ residuals
    sums.count[g] += count


def solve(gram: Array, slope: Array) -> Array:
    """Return the step s (k,) that minimises |r + J s|^2, of one group's `gram` and `slope`, along what these tell."""
    scaled, scale = _scaled(gram)
    return np.asarray(np.linalg.lstsq(scaled, -slope / scale, rcond=_SINGULAR)[0] / scale)


def descend(
    at: At, value_of: Callable[[At], float], equations: Callable[[At], tuple[Array, Array]],
    moved: Callable[[At, Array], At], settled: float = 1e-9,
) -> At:  # fmt: skip
    """Return the least squares solution from `at` on, by Levenberg's damping.

    `equations` are the normal ones, (k, k) and (k,), there; `moved` goes a step (k,). It ends where one gains less than
    `settled` of the value.
    """
    damping, value = 1e-6, value_of(at)
    for _ in range(_STEPS):
        gram, slope = equations(at)
        for _ in range(_TRIES):
            tried = moved(at, solve(gram + np.diag(damping * np.diag(gram)), slope))
            cost = value_of(tried)
            if cost <= value:
                break
            damping = max(damping, 1e-9) * 10
        else:
            break
        gained, at, value, damping = value - cost, tried, cost, max(damping / 10, 1e-12)
        if gained <= settled * (1 + value):
            break
    return at


def covariance_of(gram: Array) -> Array:
    """Return the covariance of numbers with the normal equations `gram`, (k, k), where residuals have noise of 1."""
    scaled, scale = _scaled(gram)
    return np.asarray(np.linalg.pinv(scaled, rcond=_SINGULAR, hermitian=True) / np.outer(scale, scale))


def root_of(gram: Array) -> Array:
    """Return rows (r, k) with these normal equations: they tell of columns what all readings tell; r is the rank."""
    values, vectors, scale = _known(gram)
    return np.asarray(np.sqrt(values)[:, None] * vectors.T * scale)


def whitening_of(gram: Array) -> Array:
    """Return directions (r, k), W, of numbers that these normal equations tell: W' W is their covariance."""
    values, vectors, scale = _known(gram)
    return np.asarray(vectors.T / np.sqrt(values)[:, None] / scale)


def _known(gram: Array) -> tuple[Array, Array, Array]:
    scaled, scale = _scaled(gram)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > _SINGULAR * values.max(initial=0.0)
    return values[kept], vectors[:, kept], scale


def _scaled(gram: Array) -> tuple[Array, Array]:
    scale = np.sqrt(np.diag(gram)) + _NOTHING
    return gram / np.outer(scale, scale), scale
