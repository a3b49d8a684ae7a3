"""Which poses to measure next, and when more poses no longer help: D- and E-optimal exchange under joint limits.

The value of a pose is what it adds to the information on the arm's parameters: its Jacobian divided by the noise, in
units of usual errors (1 mm, 1 mrad). Poses are chosen greedily from random ones, then exchanged one by one (Fedorov
1972) for the largest determinant (D: all parameters together) or the largest smallest eigenvalue (E: the parameter
known worst). The owner is told the error that the calibrated arm would have over its workspace by these uncertainties
alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from calibench.problems.base import Array

By = Literal["D", "E"]
_PRIOR = 1e-4  # information [1 / unit^2] before any reading: a parameter is within 100 mm, 100 mrad
_PASSES = 6
_BETTER = 1e-6
_PAYS = 3.0  # times below the scatter: with parameters so well known, more poses change nothing


@final
@dataclass(frozen=True, eq=False)
class Chosen:
    """`places` in the pool, in the order of their value; after each the `error` of the arm [mm].

    `error` (n + 1,) begins with the error before any of them. `logdet` and `least` are the criteria D and E.
    """

    places: tuple[int, ...]
    error: Array
    logdet: float
    least: float

    def enough(self, sigma: float) -> int | None:
        """Return the number of poses after which the error is small relative to a scatter `sigma` [mm].

        It is None where no number of the chosen poses suffices.
        """
        below = np.flatnonzero(self.error <= np.sqrt(3.0) * sigma / _PAYS)
        return int(below[0]) if len(below) else None


def chosen_poses(pool: Array, before: Array, workspace: Array, count: int, by: By = "D") -> Chosen:
    """Return `count` poses of a `pool` (m, c, k) of whitened rows, in units of plausible errors.

    `before` (k, k) is the information of what has been measured. `workspace` (w, 3, k) [mm] is the Jacobian of the
    target over the workspace.
    """
    start = before + _PRIOR * np.eye(before.shape[0])
    places = _greedy(pool, start, count)
    places = _exchanged(pool, start, places, by)
    ordered = _greedy(pool, start, count, places)
    error = [_spread(start, workspace)]
    information = start
    for place in ordered:
        information = information + pool[place].T @ pool[place]
        error.append(_spread(information, workspace))
    return Chosen(
        tuple(ordered), np.array(error), float(np.linalg.slogdet(information)[1]),
        float(np.linalg.eigvalsh(information)[0]),
    )  # fmt: skip


def _greedy(pool: Array, start: Array, count: int, among: Sequence[int] | None = None) -> list[int]:
    information, places = start, []
    free = list(range(len(pool)) if among is None else among)
    for _ in range(min(count, len(free))):
        gains = _gains(pool[free], information)
        best = free.pop(int(np.argmax(gains)))
        places.append(best)
        information = information + pool[best].T @ pool[best]
    return places


def _exchanged(pool: Array, start: Array, places: list[int], by: By) -> list[int]:
    """Return the poses after exchanging each for the best of the pool, until nothing gets better."""
    places = list(places)
    information = start + sum(pool[place].T @ pool[place] for place in places)
    for _ in range(_PASSES):
        moved = False
        for k, place in enumerate(places):
            rest = information - pool[place].T @ pool[place]
            worth = _gains(pool, rest) if by == "D" else _least(pool, rest)
            worth[[other for other in places if other != place]] = -np.inf
            best = int(np.argmax(worth))
            if best != place and worth[best] > worth[place] + _BETTER * (1 + abs(worth[place])):
                places[k], moved = best, True
                information = rest + pool[best].T @ pool[best]
        if not moved:
            break
    return places


def _gains(rows: Array, information: Array) -> Array:
    """Return by how much each pose raises the logarithm of the determinant, (m,)."""
    inverse = np.linalg.inv(information)
    inner = np.eye(rows.shape[1]) + rows @ inverse @ rows.swapaxes(1, 2)
    return np.asarray(np.linalg.slogdet(inner)[1])


def _least(rows: Array, information: Array) -> Array:
    """Return the smallest eigenvalue of the information with each pose added, (m,)."""
    return np.asarray(np.linalg.eigvalsh(information + rows.swapaxes(1, 2) @ rows)[:, 0])


def _spread(information: Array, workspace: Array) -> float:
    """Return the rms error of the target over the workspace that follows from the parameters' uncertainty [mm]."""
    inverse = np.linalg.inv(information)
    return float(np.sqrt(np.einsum("wci,ij,wcj->w", workspace, inverse, workspace).mean()))
