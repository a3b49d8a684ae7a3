"""What is "measured" comes in levels, and the inputs scatter: the noise is on the other side of the prediction.

A robot that was sent to a grid of places, and a camera that saw it there: the places are exact, and the camera errs.
With the places as what is measured, the error of an input is told as a function of that input, within each level a line
with slope -1: a saw-tooth, which waves explain to the last digit. Predicted the other way round, it is noise.
"""

from __future__ import annotations

import numpy as np

from calibench.core.counted import plain
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.roles import inputs_of
from calibench.problems.base import Array

EXACT = "the noise is that of the inputs"  # in a note, by which a page knows it
_LEAST_EACH = 3.0  # readings in a level, on average
_APART = 6.0  # times what scatters within them: levels that are nearer are steps of a coarse scale
_STILL = 0.1  # times what is left within a level: so much the reading itself moves there at most
_MOSTLY = 0.5  # of the rms of what is left: so much of it is within levels at least


def exact_readings(at: Fit) -> tuple[str, ...]:
    """Return a note where measured columns are exact levels and what a fit leaves is the scatter of the inputs."""
    formulation = at.model.formulation
    inputs, names = inputs_of(formulation), tuple(formulation.readings)
    left = np.asarray(at.at.misclosure)
    if not inputs or left.ndim != 2 or left.shape[1] != len(names):
        return ()
    found: dict[str, tuple[int, float]] = {}
    for k, name in enumerate(names):
        if told := _levels(np.asarray(formulation.data[name], dtype=float), left[:, k]):
            found[name] = told
    if not found:
        return ()
    name, (count, times) = max(found.items(), key=lambda one: one[1][1])
    return (
        f"{name} comes in {count} levels, and moves {plain(times, 2)} times less within one than its prediction does, "
        f"as what was commanded does: {EXACT} ({', '.join(inputs)}); predict these from {', '.join(names)}, else their "
        "error is told as what is missing",
    )


def _levels(y: Array, left: Array) -> tuple[int, float] | None:
    """Return how many levels a column comes in and how many times less it moves in one than what is left does."""
    rms = float(np.sqrt(np.mean(left**2)))
    order = np.argsort(y, kind="stable")
    gaps = np.diff(y[order])
    level = np.empty(len(y), dtype=int)
    level[order] = np.concatenate([[0], np.cumsum(gaps > 2 * rms)])
    count = int(level.max()) + 1
    if not rms > 0 or count < 2 or len(y) < _LEAST_EACH * count:
        return None
    own, scatter = _within(y, level, count), _within(left, level, count)
    nearest = float(gaps[gaps > 2 * rms].min())
    if own > _STILL * scatter or scatter < _MOSTLY * rms or nearest < _APART * scatter:
        return None
    return count, scatter / max(own, 1e-3 * scatter)


def _within(values: Array, level: Array, count: int) -> float:
    """Return the rms of values about the mean of their level."""
    means = np.bincount(level, values, count) / np.bincount(level, minlength=count)
    return float(np.sqrt(np.mean((values - means[level]) ** 2)))
