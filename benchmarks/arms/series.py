"""The series of a UR10 by a laser tracker as their authors keep them, a row a pose in the order of time.

Landgraf, Ernst, Schleth, Fabritius, Huber, "A Hybrid Neural Network Approach for Increasing the Absolute Accuracy of
Industrial Robots", IEEE CASE 2021; github.com/christianlandgraf/ipa-robot-accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibench.bench.measured import read_measured
from calibench.calibration.urdf import read_urdf
from calibench.discrepancy import MeasuredData
from calibench.problems.arm.families import shipped
from calibench.problems.base import Array

SERIES = {"B": "joint_configurations", "C": "random_poses", "D": "iso_cubes"}
URDF = str(shipped("ur10.urdf"))
EACH = 5  # every fifth pose is kept back


def series(folder: Path, name: str, first: int = 0) -> MeasuredData:
    """Return joints [rad], x y z [mm], temperature [degC], the row of the file, and the split, of all whole rows.

    Of the poses that are kept back row `first` of the file, from 0, is the first.
    """
    read = read_measured(folder / f"Series_{name}" / f"measurements_{SERIES[name]}.csv", "arm", {})
    columns = {joint: _numbers(read, joint) for joint in read_urdf(URDF).chain().driven}
    columns |= {axis: _numbers(read, f"measurement_{axis}") for axis in "xyz"}
    columns["temperature_C"] = _numbers(read, "measurement_temperature")
    rows = np.arange(len(read))
    columns["row"] = rows.astype(float)
    whole = np.all([np.isfinite(c) for name, c in columns.items() if name != "temperature_C"], axis=0)
    split = np.where(rows % EACH == first, "hold", "train")
    return MeasuredData({**columns, "split": split}, "arm", {}, f"UR10 {name}, from {first + 1}").rows(whole)


def shuffled(data: MeasuredData, seed: int = 0) -> MeasuredData:
    """Return the rows in an order of chance: what follows the order of time has no order to follow."""
    order = np.random.default_rng(np.random.SeedSequence([seed, len(data)])).permutation(len(data))
    columns = {name: np.asarray(data[name])[order] for name in data.columns if name != "row"}
    columns["row"] = np.arange(len(data), dtype=float)
    return MeasuredData(columns, "arm", dict(data.metadata), f"{data.name}, rows shuffled")


def in_runs(data: MeasuredData) -> Sequence[MeasuredData]:
    """Return the data as often as there are runs of rows next to each other, each time with another run kept back."""
    place = np.argsort(np.argsort(data["row"], kind="stable"), kind="stable")
    run = place * EACH // len(data)
    return [
        MeasuredData(
            {**{name: np.asarray(data[name]) for name in data.columns}, "split": np.where(run == k, "hold", "train")},
            "arm", dict(data.metadata), f"{data.name}, run {k + 1} of {EACH} kept back",
        )
        for k in range(EACH)
    ]  # fmt: skip


def _numbers(read: MeasuredData, name: str) -> Array:
    return np.asarray(read[name], dtype=float)
