"""The atlas: where a smooth disagreement of any shape would lie. Leg by covariate, and over the workspace.

Each chart is an effect of no name: an unknown smooth function of one covariate added to what one encoder says (or of
the place, to each constraint). It finds what the catalogue does not have, tells where, and is the fallback model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from discrepancy.data import MeasuredData
from discrepancy.fit import Fit
from discrepancy.linear import size
from discrepancy.machine import Quantities
from problems.base import Array

_KNOTS = 7  # columns of a curve
_MAP = 5  # columns of a map along each axis


@final
@dataclass(frozen=True, eq=False)
class Chart:
    """An `Effect` without a name: a smooth function of `covariates` added to `quantities`, one of its own for each."""

    target: str
    covariate: str
    quantities: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    covariates: tuple[str, ...]
    knots: int
    levels: tuple[float, ...] = ()
    family: str = "smooth"
    channel: str = "reading"
    formula: str = "a smooth function of the covariate"
    twins: tuple[str, ...] = ()
    unit: str = "rad"
    positions: int = 1
    place: bool = field(default=False)

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the covariates."""
        return self.covariates

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        one = len(self.levels) - 1 if self.levels else self.knots ** len(self.low) - 1
        return tuple(f"{q} s{k}" for q in self.quantities for k in range(one))

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each coefficient."""
        return (self.unit,) * len(self.coefficients)

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,)."""
        return {name: basis @ c for name, basis in self.basis(q, data, c).items()}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n, k)."""
        values = [np.asarray(data[name], dtype=float) for name in self.covariates]
        if self.levels:
            one = np.stack([values[0] == level for level in self.levels[1:]], axis=-1).astype(float)
        else:
            one = np.ones((len(data), 1))
            for value, low, high in zip(values, self.low, self.high):
                one = (one[:, :, None] * curve(value, low, high, self.knots)[:, None, :]).reshape(len(data), -1)
            one = one[:, 1:]  # the constant is the offset's
        one[~np.all(np.isfinite(values), axis=0)] = 0.0  # rows that are not the target's
        k = one.shape[1]
        found = {}
        for j, name in enumerate(self.quantities):
            wide = np.zeros((len(data), k * len(self.quantities)))
            wide[:, j * k : (j + 1) * k] = one
            found[name] = wide
        return found

    def amplitude(self, c: Array) -> float:
        """Return the length of the coefficients."""
        return size(c)


def curve(values: Array, low: float, high: float, knots: int) -> Array:
    """Return `knots` Chebyshev polynomials of values (n,) mapped from [low, high], (n, knots); flat beyond."""
    s = np.clip(2 * (values - low) / (high - low) - 1, -1, 1) if high > low else np.zeros(len(values))
    return np.cos(np.arange(knots) * np.arccos(s)[:, None])


def charts(fit: Fit) -> tuple[tuple[Chart, ...], dict[str, Array]]:
    """Return the atlas of a fit, and the columns that it needs beside those measured."""
    formulation = fit.at.model.formulation
    found: list[Chart] = []
    extra: dict[str, Array] = {}
    for target, covariates in formulation.covariates(fit.at.recorded).items():
        quantities = _quantities(target, formulation.readings)
        if target == "workspace":
            names = tuple(f"place_{name}" for name in covariates)
            for name, values in zip(names, covariates.values()):
                extra[name] = np.asarray(values, dtype=float)
            low, high = tuple(float(extra[n].min()) for n in names), tuple(float(extra[n].max()) for n in names)
            for leg in (q for q in formulation.readings if q.startswith("enc")):
                found.append(Chart("leg " + leg[-1], "place", (leg,), low, high, names, _MAP, place=True))
            continue
        for name, values in covariates.items():
            own = values[np.isfinite(values)]
            levels = np.unique(own)
            if len(levels) < 2:
                continue
            column = name if name in fit.at.model.formulation.data else f"{target} {name}"
            if column != name:
                extra[column] = np.asarray(values, dtype=float)
            few = tuple(float(v) for v in levels) if len(levels) <= 4 else ()
            found.append(
                Chart(target, name, quantities, (float(own.min()),), (float(own.max()),), (column,), _KNOTS, few)
            )
    return tuple(found), extra


def _quantities(target: str, readings: tuple[str, ...]) -> tuple[str, ...]:
    own = f"enc_{target[-1]}"
    return (own,) if own in readings else tuple(readings[:1])
