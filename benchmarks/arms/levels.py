"""A series by itself through `bench calibrate`: errors of every fifth pose, all five choices, by how much is free.

The rows are base and target alone, joint zeros, lengths and angles too, and the scale of each joint's reading too.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.arms.series import EACH, URDF, series
from calibench.bench.calibration.calibrate import calibrate
from calibench.bench.calibration.report.result import Calibration
from calibench.bench.calibration.request import CalibrateRequest
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
    columns = {f"{n} [mm]" if n in "xyz" else n: np.asarray(data[n]) for n in data.columns if n != "row"}
    with TemporaryDirectory() as made:
        path = Path(made) / "poses.csv"
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
        request = CalibrateRequest(Path(URDF), str(path), level="gains", resamples=20, page=False)
        return calibrate(request)[0]
