"""Sensor noise of a stated standard deviation, under the three laws that the workflow must stand."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from scipy.signal import lfilter

from benchmarks.blind.gpm2002.machine import Array

Law = Literal["gauss", "t3", "ar1"]
LAWS: tuple[Law, ...] = get_args(Law)
SHARES = (0.70, 0.15, 0.15)
CARRIED = 0.45  # the part of one reading's noise that the next one inherits


def draw(law: Law, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Draw noise of standard deviation 1, a row a reading in the order of time."""
    if law == "t3":
        return rng.standard_t(3, shape) / np.sqrt(3.0)  # the variance of t3 is 3
    white = rng.standard_normal(shape)
    if law == "gauss":
        return white
    first = white[:1].copy()
    white *= np.sqrt(1 - CARRIED**2)
    white[0] = first  # stationary from the first reading on
    return np.asarray(lfilter([1.0], [1.0, -CARRIED], white, axis=0))
