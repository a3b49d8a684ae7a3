"""Smooth terms: tests, by Chebyshev polynomials, for a smooth disagreement of any shape over a covariate or the space.

A smooth term is an effect without a name: an unknown smooth function of one covariate that is added to one reading (or
a function of the place, added to each constraint). It detects what the catalogue lacks, tells where it is, and is the
model that is used where no named effect fits.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import final

import numpy as np

from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import linear_shift, size
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import drifts_of, inputs_of, roles_of
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
    columns: tuple[str, ...] = field(init=False)
    coefficients: tuple[str, ...] = field(init=False)
    units: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        one = len(self.levels) - 1 if self.levels else self.knots ** len(self.low) - 1
        one = one if self.mix is None else self.mix.shape[1]
        names = tuple(f"{q} s{k}" for q in self.quantities for k in range(one))
        vars(self).update(columns=self.covariates, coefficients=names, units=(self.unit,) * len(names))

    shift = linear_shift
    amplitude = staticmethod(size)

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        values = [np.asarray(data[name], dtype=float) for name in self.covariates]
        if self.levels:
            one = np.stack([values[0] == level for level in self.levels[1:]], axis=-1).astype(float)
        else:
            curves = (curve(value, low, high, self.knots) for value, low, high in zip(values, self.low, self.high))
            one = products(curves)[:, 1:]  # the constant is the offset's
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


def curve(values: Array, low: float, high: float, knots: int) -> Array:
    """Return `knots` Chebyshev polynomials of values (n,) mapped from [low, high], (n, knots); constant outside."""
    s = np.clip(2 * (values - low) / (high - low) - 1, -1, 1) if high > low else np.zeros(len(values))
    return np.cos(np.arange(knots) * np.arccos(s)[:, None])


def products(values: Iterable[Array]) -> Array:
    """Return the products of columns, one of each of `values`, (n, k) each: (n, k1 k2 ...)."""
    found, *others = values
    for value in others:
        found = (found[:, :, None] * value[:, None, :]).reshape(len(found), -1)
    return found


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
    """Return the smooth terms of a fit, whose data must have the columns of `smooth_columns`.

    They act on readings, which show the errors of all parts, and on parameters that may change, whose errors have
    another sign in other readings.
    """
    formulation, data = fit.model.formulation, fit.model.formulation.data
    roles, sensors, found = roles_of(formulation), formulation.sensors, []
    for target, covariates in formulation.covariates(fit.at.recorded).items():
        columns = {name: _column(target, name, formulation) for name in covariates}
        if target != WORKSPACE:
            # the readings that show a smooth error of the target: the stated ones, or the first where none is stated
            own = tuple(s.column for s in sensors if target == s.column or target in s.targets)
            quantities = own or (sensors[0].column,)
            found += [_term(target, name, quantities, (column,), data) for name, column in columns.items()]
            continue
        for sensor in (sensor for sensor in sensors if sensor.over_place):
            shown = next(iter(sensor.targets), sensor.column)
            found.append(_term(shown, "place", (sensor.column,), (*columns.values(),), data, over_place=True))
    met = [c for c in drifts_of(roles) if c in data and data[c].dtype.kind in "iuf"]
    for column in met if roles.parameters else ():
        found += [_term(name, column, (name,), (column,), data) for name in roles.parameters]
    return tuple(term for term in found if term is not None)


def joint_terms(fit: Fit) -> tuple[SmoothTerm, ...]:
    """Return smooth terms of joints that are inputs, over their position and over what acted on them."""
    formulation, found = fit.model.formulation, []
    roles, inputs, data = roles_of(formulation), inputs_of(formulation), formulation.data
    for joint in (joint for joint in roles.joints if joint.reading in inputs):
        met = (joint.reading, roles.time, joint.direction, joint.torque, joint.temperature or roles.temperature)
        names = [name for name in dict.fromkeys(met) if name in data and data[name].dtype.kind in "iuf"]
        found += [_term(joint.reading, name, (joint.reading,), (name,), data) for name in names]
    return tuple(term for term in found if term is not None)


def _term(
    target: str, name: str, quantities: tuple[str, ...], columns: tuple[str, ...], data: MeasuredData,
    over_place: bool = False,
) -> SmoothTerm | None:  # fmt: skip
    """Return the term over a covariate of one column, None where it never varies; or over the place, of several."""
    levels: tuple[float, ...] = ()
    values = [np.asarray(data[column], dtype=float) for column in columns]
    if not over_place:
        values = [values[0][np.isfinite(values[0])]]
        distinct = np.unique(values[0])
        if len(distinct) < 2:
            return None
        levels = tuple(float(v) for v in distinct) if len(distinct) <= 4 else ()
    return SmoothTerm(
        target=target, covariate=name, quantities=quantities, low=tuple(float(v.min()) for v in values),
        high=tuple(float(v.max()) for v in values), covariates=columns,
        knots=thresholds().map_terms if over_place else thresholds().curve_terms, levels=levels,
    )  # fmt: skip


def _column(target: str, name: str, formulation: Formulation) -> str:
    """Return the name of the column that holds a covariate of a target: its own column, or one made for the term."""
    if target == WORKSPACE:
        return f"place_{name}"
    return name if name in formulation.data else f"{target} {name}"
