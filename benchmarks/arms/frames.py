"""Base and tool of a series, fitted to some of its poses, for an arm whose geometry is given.

A pose's residual is the way [mm] from where the target was seen to where the arm brings it. Numbers are looked for by
Gauss-Newton; what the poses hardly tell of (a singular value below `_LEAST` of the largest) keeps its start, which was
found from the same poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from calibench.calibration.walk import BASE, TOOL
from calibench.discrepancy import MeasuredData, Model, Predicted
from calibench.problems.base import Array, Parameter
from calibench.problems.fitting import gauss_newton

FRAMES = (*BASE, *TOOL)
_LEAST = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Framed:
    """An arm with its frames: `formulation` frees nothing but them, at `x` (9,)."""

    formulation: Predicted
    x: Array

    def left(self, data: MeasuredData) -> Array:
        """Return the 3D error [mm] at each row of `data`, (n,)."""
        return norms(Model(self.formulation.on(data)).residuals(self.x))


def freed(whole: Predicted, names: Sequence[str], geometry: Mapping[str, float] | None = None) -> Predicted:
    """Return the formulation in which `names` are free and all else is nominal, or what `geometry` says."""
    values = {**whole.held, **{p.name: p.start for p in whole.parameters}, **(geometry or {})}
    free = tuple(Parameter(n, "", values[n], values[n] - 1e3, values[n] + 1e3) for n in names)
    return replace(
        whole, parameters=free, held={n: v for n, v in values.items() if n not in names},
        measured=dict.fromkeys(whole.measured, 1.0), _checked=True,
    )  # fmt: skip


def framed(whole: Predicted, rows: NDArray[np.intp], geometry: Mapping[str, float] | None = None) -> Framed:
    """Return the arm of `geometry` (nominal without) with base and tool fitted to the rows."""
    formulation = freed(whole, FRAMES, geometry)
    model = Model(formulation.on(whole.data.rows(rows)))
    x = gauss_newton(
        lambda x: model.residuals(x).ravel(),
        lambda x: model.jacobian(x).reshape(-1, model.size),
        model.start,
        rank_tolerance=_LEAST,
    )
    return Framed(formulation, np.asarray(x))


def norms(residuals: Array) -> Array:
    """Return the length of each row's residual, (n,) [mm]."""
    return np.asarray(np.sqrt((np.asarray(residuals)[:, :3] ** 2).sum(axis=1)))
