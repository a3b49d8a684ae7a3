"""Smooth terms: tests, by Chebyshev polynomials, for a smooth disagreement of any shape over a covariate or the space.

A smooth term is an effect without a name: an unknown smooth function of one covariate that is added to one reading (or
a function of the place, added to each constraint). It detects what the catalogue lacks, tells where it is, and is the
model that is used where no named effect fits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import size
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData, Sensor
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import inputs_of, roles_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class SmoothTerm:
    """An unnamed `Effect`: a smooth function of `covariates` added to `quantities`, a separate one for each.

    `mix`, (k, m), restricts it to those combinations of its columns that calibration does not absorb.
    """

    target: str
    covariate: str
    quantities: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    covariates: tuple[str, ...]
    knots: int
    levels: tuple[float, ...] = ()
    mix: Array | None = None
    family: str = "smooth"
    channel: str = "reading"
    formula: str = "a smooth function of the covariate"
    twins: tuple[str, ...] = ()
    unit: str = "rad"
    positions: int = 1

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the covariates."""
        return self.covariates

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        one = len(self.levels) - 1 if self.levels else self.knots ** len(self.low) - 1
        if self.mix is not None:
            one = self.mix.shape[1]
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
        if self.mix is not None:
            one = one @ self.mix
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
    """Return `knots` Chebyshev polynomials of values (n,) mapped from [low, high], (n, knots); constant outside."""
    s = np.clip(2 * (values - low) / (high - low) - 1, -1, 1) if high > low else np.zeros(len(values))
    return np.cos(np.arange(knots) * np.arccos(s)[:, None])


def smooth_columns(formulation: Formulation, x: Array) -> dict[str, Array]:
    """Return the columns that smooth terms need beside the measured ones, for a formulation at parameters x."""
    extra: dict[str, Array] = {}
    for target, covariates in formulation.covariates(Model(formulation).quantities(x)[0]).items():
        for name, values in covariates.items():
            column = _column(target, name, formulation)
            if column not in formulation.data:
                extra[column] = np.asarray(values, dtype=float)
    return extra


def smooth_terms(fit: Fit) -> tuple[SmoothTerm, ...]:
    """Return the smooth terms of a fit, whose data must have the columns of `smooth_term_columns`."""
    formulation = fit.model.formulation
    found: list[SmoothTerm] = []
    for target, covariates in formulation.covariates(fit.at.recorded).items():
        columns = {name: _column(target, name, formulation) for name in covariates}
        if target == WORKSPACE:
            ends = [(float(np.min(formulation.data[c])), float(np.max(formulation.data[c]))) for c in columns.values()]
            low, high = tuple(e[0] for e in ends), tuple(e[1] for e in ends)
            names = tuple(columns.values())
            for sensor in (sensor for sensor in formulation.sensors if sensor.over_place):
                shown = next(iter(sensor.targets), sensor.column)
                found.append(
                    SmoothTerm(
                        target=shown,
                        covariate="place",
                        quantities=(sensor.column,),
                        low=low,
                        high=high,
                        covariates=names,
                        knots=thresholds().map_terms,
                    )
                )
            continue
        for name, column in columns.items():
            own = np.asarray(formulation.data[column], dtype=float)
            own = own[np.isfinite(own)]
            found += _over(target, name, column, own, _quantities(target, formulation.sensors))
    return tuple(found)


def joint_terms(fit: Fit) -> tuple[SmoothTerm, ...]:
    """Return smooth terms of joints that are inputs, over their position and over what acted on them.

    They are not tested, because an error of a joint shows in the measured columns. Where no name explains the error,
    they tell which joint has it.
    """
    formulation, found = fit.model.formulation, []
    roles, inputs, data = roles_of(formulation), inputs_of(formulation), formulation.data
    for joint in (joint for joint in roles.joints if joint.reading in inputs):
        met = (joint.reading, roles.time, joint.direction, joint.torque, joint.temperature or roles.temperature)
        for name in (name for name in dict.fromkeys(met) if name in data and data[name].dtype.kind in "iuf"):
            own = np.asarray(data[name], dtype=float)
            found += _over(joint.reading, name, name, own[np.isfinite(own)], (joint.reading,))
    return tuple(found)


def _over(target: str, name: str, column: str, values: Array, quantities: tuple[str, ...]) -> list[SmoothTerm]:
    """Return a list with the term over one covariate; an empty list where its values, (n,), are all equal."""
    levels = np.unique(values)
    if len(levels) < 2:
        return []
    few = tuple(float(v) for v in levels) if len(levels) <= 4 else ()
    low, high = (float(values.min()),), (float(values.max()),)
    return [
        SmoothTerm(
            target=target,
            covariate=name,
            quantities=quantities,
            low=low,
            high=high,
            covariates=(column,),
            knots=thresholds().curve_terms,
            levels=few,
        )
    ]


def _column(target: str, name: str, formulation: Formulation) -> str:
    """Return the name of the column that holds a covariate of a target: its own column, or one made for the term."""
    if target == WORKSPACE:
        return f"place_{name}"
    return name if name in formulation.data else f"{target} {name}"


def _quantities(target: str, sensors: tuple[Sensor, ...]) -> tuple[str, ...]:
    """Return the readings that show a smooth error of a target: the stated one, or the first where none is stated."""
    own = tuple(s.column for s in sensors if target == s.column or target in s.targets)
    return own or (sensors[0].column,)
