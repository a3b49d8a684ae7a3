"""A series by itself through `bench calibrate`: errors of every fifth pose, all five choices, by how much is free.

The rows are base and target alone, joint zeros, lengths and angles too, and the scale of each joint's reading too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.arms.series import EACH, URDF, series
from calibench.calibration.api import calibrate
from calibench.calibration.calibrate import Calibration
from calibench.discrepancy import MeasuredData

FREE = {
    "frames": "base and target", "zeros": "joint zeros too", "geometry": "lengths and angles too",
    "gains": "joint scales too",
}  # fmt: skip


def rows(folder: Path, name: str) -> Iterator[str]:
    """Return lines for the page, one for each level: the 3D rms [mm] by each of the five choices, and their middle."""
    found = [calibrated(series(folder, name, first)) for first in range(EACH)]
    for k, told in enumerate(FREE.values()):
        errors = [one.levels[k].rms for one in found]
        low, high = found[0].levels[k].ci95
        cells = [f"{errors[0]:.3f} ({low:.3f} to {high:.3f})", *(f"{e:.3f}" for e in (*errors[1:], np.mean(errors)))]
        yield f"| {name} | {told} | {' | '.join(cells)} |"
    uncounted = [", ".join(wild.row for wild in one.wild) or "none" for one in found]
    yield f"  rows of which no error is counted: {'; '.join(uncounted)}"


def calibrated(data: MeasuredData) -> Calibration:
    """Return the calibration with all levels tried, each with the errors of the poses that `data` hold back."""
    columns = {n: np.asarray(data[n]) for n in data.columns if n != "row"}
    units = dict.fromkeys("xyz", "mm")
    return calibrate(URDF, columns, units=units, level="gains", resamples=20)
