"""The scale of the board's places beside the robot's moves: one more number, fitted to what both frames leave.

The camera tells places in the size of the board that it was told. A board that is 3 % smaller makes all places 3 % too
far, and rotations stay true: the frames move by many times their intervals, and the noise that is learned grows. So the
scale s of seen = s (mount arm tool) is fitted beside the frames, one step of Gauss-Newton from s = 1, with the noise of
the places learned anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.stats import norm, t

from calibench.bench.calibration.hand_eye.adjust import Adjusted, rows_of
from calibench.core.words import plain

_CHANCE = 1e-3  # of noise alone to be told as a scale
_SPARE = 3.0  # degrees of freedom: with fewer a scale is not told from noise
_ROUNDS = 10
_FLOOR = 1e-9  # a noise or a scale's error of readings without any


@final
@dataclass(frozen=True)
class Scale:
    """How many times as far as the frames say the board is seen, its standard error, and whether noise is unlikely."""

    value: float
    se: float
    told: bool


def scale_of(found: Adjusted, learned: bool) -> Scale | None:
    """Return the scale of the board's places; None where too few pairs tell it. `learned` is the noise of places."""
    fit = found.fit
    left, turned = fit.model.errors(fit.p)
    assert turned is not None
    assert fit.model.position is not None
    kept = ~fit.wild
    places, rotations = rows_of(fit)
    seen = (left + fit.model.position)[kept].reshape(-1, 1)
    keep = np.repeat(kept, 3)
    places = np.hstack([found.sigma[0] * places[keep], seen])  # in mm
    rotations = np.hstack([rotations[keep], np.zeros((int(keep.sum()), 1))])
    wanted, turns = -left[kept].ravel(), -turned[kept].ravel() / found.sigma[1]
    size = np.linalg.norm(np.vstack([places / found.sigma[0], rotations]), axis=0) + _FLOOR
    sigma, freedom = found.sigma[0], np.inf
    for _ in range(_ROUNDS):
        rows = np.vstack([places / sigma, rotations]) / size
        covariance = np.linalg.pinv(rows.T @ rows, rcond=1e-13)
        solved = covariance @ rows.T @ np.concatenate([wanted / sigma, turns])
        if not learned:
            break
        over = rows[: len(wanted)]
        freedom = len(wanted) - float(np.einsum("mi,ij,mj->", over, covariance, over))
        if freedom < _SPARE:
            return None
        sigma = max(float(np.linalg.norm(wanted - places @ (solved / size)) / np.sqrt(freedom)), _FLOOR)
    value = float(solved[-1] / size[-1])
    se = max(float(np.sqrt(covariance[-1, -1]) / size[-1]), _FLOOR)
    limit = t.ppf(1 - _CHANCE / 2, freedom) if np.isfinite(freedom) else norm.ppf(1 - _CHANCE / 2)
    return Scale(1 + value, se, bool(abs(value) > limit * se))


def scale_told(scale: Scale, stated: float) -> str:
    """Return what a scale means, and the cure; `stated` is the scale that the user stated already."""
    cure = plain(stated / scale.value, 5)
    size = f"{plain(100 * abs(1 / scale.value - 1), 2)} % {'smaller' if scale.value > 1 else 'larger'}"
    return (
        f"the camera sees the board {plain(scale.value, 5)} times as far as the robot's moves say (standard error "
        f"{plain(scale.se, 2)}): the frames and their intervals are wrong. Measure the board: if its squares or "
        f"markers are {size} than the camera was told, state board_scale={cure}; if they are not, calibrate the "
        "camera's lens anew"
    )
