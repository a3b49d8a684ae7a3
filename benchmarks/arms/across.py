"""Two series are fitted, the third is predicted: does a calibration hold where it was not made?

Geometry is one for all series, and so is the target on the flange. The base is one for each stand of the tracker:
series whose bases, each found by itself, lie within `_MOVED` of each other were read from one stand, and are fitted as
one long table. A base for each series though the tracker stood still is the fault that this page's first figures had:
over 2.3 rad of the first joint each, side by side, two free bases let a lean of the second axis, which all poses
together tell well, run away by 2 mrad. Base and target of the third series are fitted to `poses` of its rows, evenly
spread, and the error is that of the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.arms.frames import FRAMES, framed, freed
from benchmarks.arms.series import SERIES, URDF, series
from benchmarks.arms.within import gain
from calibench.calibration.fit import rms
from calibench.calibration.walk import BASE, PLACE, TOOL
from calibench.discrepancy import MeasuredData, Model, Predicted
from calibench.discrepancy.machines.arm import Arm
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton

Index = NDArray[np.int64]
POSES = 20
CHOICES = 25  # of the poses by which base and target are found
_MOVED = 5.0  # mm: a tracker that was set up anew stands further off than calibration errors make it seem
_LEAST = 1e-9


def rows(folder: Path, poses: int = POSES) -> Sequence[str]:
    """Return the table's lines: a third series each, predicted by the nominal arm and by what two others calibrate."""
    whole = {name: formulated([series(folder, name)]) for name in SERIES}
    lines = []
    for third in SERIES:
        two = [name for name in SERIES if name != third]
        stands = [formulated([series(folder, n) for n in one]) for one in grouped({n: whole[n] for n in two})]
        found = {
            "nominal": {},
            "a base each": shared_geometry([whole[n] for n in two]),
            "a base a stand": shared_geometry(stands),
        }
        cells, n = [], len(whole[third].data)
        for geometry in found.values():
            errors = predicted(whole[third], geometry, evenly(n, poses))
            low, high = gain(errors, np.zeros_like(errors))
            cells.append(f"{rms(errors):.3f} ({low:.3f} to {high:.3f})")
        spread = [rms(predicted(whole[third], found["a base a stand"], told)) for told in choices(n, poses, CHOICES)]
        cells.append(f"{np.median(spread):.3f} ({min(spread):.3f} to {max(spread):.3f})")
        every = rms(framed(whole[third], np.arange(n), found["a base a stand"]).left(
            whole[third].data
        ))  # fmt: skip
        lines.append(f"| {third} | {', '.join(two)} | {len(stands)} | " + " | ".join(cells) + f" | {every:.3f} |")
    return lines


def formulated(several: Sequence[MeasuredData]) -> Predicted:
    """Return one formulation of some series, as of one stand of the tracker; all rows are fitted."""
    names = [name for name in several[0].columns if name != "split"]
    columns = {name: np.concatenate([np.asarray(one[name]) for one in several]) for name in names}
    columns["row"] = np.arange(len(columns["row"]), dtype=float)
    return Arm(URDF).formulate(MeasuredData(columns, "arm", {}, " and ".join(one.name for one in several)))


def grouped(whole: Mapping[str, Predicted]) -> list[tuple[str, ...]]:
    """Return the series by the stand of the tracker from which they were read."""
    groups: list[tuple[str, ...]] = []
    for name, one in whole.items():
        near = [g for g in groups if np.linalg.norm(_foot(whole[g[0]]) - _foot(one)) < _MOVED]
        groups = [g for g in groups if g not in near] + [(*(n for g in near for n in g), name)]
    return groups


def shared_geometry(stands: Sequence[Predicted]) -> dict[str, float]:
    """Return what two stands' readings together say of the arm: name -> value of what is not base or target."""
    geometry = [p.name for p in max(stands, key=lambda one: len(one.data)).parameters if p.name not in FRAMES]
    models = [Model(freed(one, (*BASE, *TOOL, *geometry))) for one in stands]
    shared = len(TOOL) + len(geometry)
    places = [np.r_[len(BASE) * k + np.arange(len(BASE)), len(BASE) * len(models) + np.arange(shared)] for k in
              range(len(models))]  # fmt: skip
    start = np.concatenate([*(m.start[: len(BASE)] for m in models), models[0].start[len(BASE) :]])

    def residuals(x: Array) -> Array:
        return np.concatenate([np.ravel(m.residuals(x[at])) for m, at in zip(models, places, strict=True)])

    def jacobian(x: Array) -> Array:
        parts = []
        for m, at in zip(models, places, strict=True):
            own = np.asarray(m.jacobian(x[at])).reshape(-1, m.size)
            part = np.zeros((len(own), len(x)))
            part[:, at] = own
            parts.append(part)
        return np.concatenate(parts)

    x = gauss_newton(residuals, jacobian, start, rank_tolerance=_LEAST)
    return dict(zip(geometry, x[-len(geometry) :].tolist(), strict=True))


def predicted(third: Predicted, geometry: Mapping[str, float], told: Index) -> Array:
    """Return the errors [mm] of all rows but `told`, by which base and target of the third series are found."""
    rest = np.setdiff1d(np.arange(len(third.data)), told)
    return np.asarray(framed(third, told, geometry).left(third.data)[rest])


def evenly(n: int, poses: int) -> Index:
    """Return the rows of `poses` that are evenly spread over n, from the first to the last."""
    return np.unique(np.linspace(0, n - 1, poses).round().astype(np.int64))


def choices(n: int, poses: int, count: int) -> list[Index]:
    """Return `count` other choices of rows, n / poses apart, which begin at one place after the other of that gap."""
    starts = (np.arange(count) + 0.5) / count
    return [np.unique(((np.arange(poses) + start) * n / poses).astype(np.int64)) for start in starts]


def _foot(one: Predicted) -> Array:
    start = {**one.held, **{p.name: p.start for p in one.parameters}}
    return np.array([start[f"base_{axis}"] for axis in PLACE])
