"""What the drawings of a search are made of: the series behind a report, in plain arrays.

A whitened residual says little to an engineer, and its sign turns with the pose. So the residuals of each reading are
told as the error of the one quantity that an effect acts on (an encoder's angle, a link's length) which would leave
them: with the whitened slopes s of that quantity, s . r / s . s, of weight s . s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import pandas as pd

from calibench.bench.discovery.page.quantity import in_small_units
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.labels import effect_label, quantity_label, quantity_of
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import WORKSPACE, Formulation
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.registries import family_of
from calibench.discrepancy.report import Report
from calibench.problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class Residuals:
    """The error of one quantity that each reading implies, (n,), without and with the effects, and its weight.

    `effect` is its name in words; `values`, (n,), is what it depends on; `label` and `error` say what stands on the
    two axes.
    """

    effect: str
    label: str
    error: str
    values: Array
    before: Array
    after: Array
    weight: Array


@final
@dataclass(frozen=True, eq=False)
class Workspace:
    """Where the tool stood [mm] and the whitened residual without an effect, (n,) each."""

    x: Array
    y: Array
    residual: Array


@final
@dataclass(frozen=True, eq=False)
class Series:
    """`candidates`: effect, family, target, gain, in_set, chosen. `workspace` is None where there is none to draw."""

    candidates: pd.DataFrame
    residuals: tuple[Residuals, ...] = ()
    workspace: Workspace | None = None


def series_of(report: Report) -> Series:
    """Return what the drawings of `report` show."""
    return Series(_candidates(report), _residuals(report), _workspace(report))


def _candidates(report: Report) -> pd.DataFrame:
    chosen = {finding.effect for finding in report.findings}
    inside = {rival.effect for finding in report.findings for rival in finding.set} | chosen
    table = pd.DataFrame(
        {
            "effect": [c.effect for c in report.candidates],
            "family": [c.family for c in report.candidates],
            "target": [c.target for c in report.candidates],
            "gain": [c.gain for c in report.candidates],
            "p": [c.p for c in report.candidates],
            "visible_fraction": [c.visible_fraction for c in report.candidates],
        }
    )
    return table.assign(in_set=table["effect"].isin(inside), chosen=table["effect"].isin(chosen))


def _residuals(report: Report) -> tuple[Residuals, ...]:
    """Return a chart an effect, in the order of the findings, each against the model with all others but not it."""
    before, after = report.before.fit, report.model.fit
    rank = {finding.effect: k for k, finding in enumerate(report.findings)}
    effects = sorted(after.model.effects, key=lambda effect: rank.get(name_of(effect), len(rank)))
    if any(effect.family == "smooth" for effect in effects):  # one correction, however many curves
        drawn = [residuals for effect in effects if (residuals := _implied(effect, before, after))]
        return tuple({(residuals.label, residuals.error): residuals for residuals in reversed(drawn)}.values())[::-1]
    alone = len(effects) == 1
    each = (_implied(effect, before if alone else _without(effect, after), after) for effect in effects)
    return tuple(residuals for residuals in each if residuals is not None)


def _without(effect: Effect, final: Fit) -> Fit:
    """Return the final model fitted again without one of its effects."""
    model = final.model
    kept = tuple(other for other in model.effects if other is not effect)
    start = len(model.formulation.parameters)
    coefficients = []
    for other in model.effects:
        end = start + len(other.coefficients)
        coefficients.append(final.x[start:end] if other is not effect else final.x[:0])
        start = end
    x = np.concatenate([final.x[: len(model.formulation.parameters)], *coefficients])
    return fit(Model(model.formulation, kept), final.noise, x, near=False)


def _implied(effect: Effect, before: Fit, after: Fit) -> Residuals | None:
    """Return what the residuals say of the quantity that `effect` changes most; None where it changes none.

    An effect that depends on no column is drawn over its own trace: what it changes, calibrated anew, of each reading.
    """
    formulation = before.model.formulation
    data, machine = formulation.data, formulation.data.machine
    column = next((name for name in effect.columns if name in data and data[name].dtype.kind in "if"), None)
    alone = formulation.readings[0] if len(formulation.readings) == 1 else None  # no reading knows a quantity by itself
    quantity = alone if column is None and alone else _most_changed(effect, before)
    if quantity is None:
        return None
    told, weight = error_of(quantity, before)
    left, _ = error_of(quantity, after)
    factor, unit = in_small_units(_unit_of(quantity, formulation))
    family = family_of(machine, effect.family)
    period = family.period(data.metadata, effect.target) if family and family.period else 0.0
    if column is None:
        values, label = factor * (told - left), _with_unit("what the effect changes of it", unit)
    elif period:
        own = quantity_of(machine, column).unit
        values, label = (
            np.mod(data[column], period),
            _with_unit(f"{_words(column, formulation)} within one period", own),
        )
    else:
        values, label = np.asarray(data[column], dtype=float), _axis_label(column, before)
    name = "a smooth correction" if effect.family == "smooth" else effect_label(machine, effect.family, effect.target)
    error = _with_unit(f"error of {_words(quantity, formulation)}", unit)
    return Residuals(name, label, error, values, factor * told, factor * left, factor**-2 * weight)


def _unit_of(quantity: str, formulation: Formulation) -> str:
    """Return the unit of a quantity as a sensor, a parameter or the machine declares it; "" where none does."""
    stated = {p.name: p.unit for p in formulation.parameters} | {
        s.column: s.unit for s in formulation.sensors if s.unit
    }
    return stated.get(quantity) or quantity_of(formulation.data.machine, quantity).unit


def _words(quantity: str, formulation: Formulation) -> str:
    """Return a quantity in words: those of its sensor, or what the machine declares."""
    labels = {sensor.column: sensor.label for sensor in formulation.sensors if sensor.label}
    return labels.get(quantity) or quantity_label(formulation.data.machine, quantity)


def _with_unit(words: str, unit: str) -> str:
    return f"{words} [{unit}]" if unit else words


def _axis_label(column: str, at: Fit) -> str:
    """Return a column, or a covariate that a machine made of several, in words with its unit."""
    formulation = at.model.formulation
    name = column
    for target in formulation.covariates(at.at.recorded):
        name = name.removeprefix(f"{target} ")  # of the rows of one target
    return _with_unit(_words(name, formulation), _unit_of(name, formulation))


def _most_changed(effect: Effect, at: Fit) -> str | None:
    """Return the quantity through which a unit of the effect moves the residuals most."""
    c = np.zeros(len(effect.coefficients))
    basis = effect.basis(at.at.recorded, at.model.formulation.data, c)
    if not len(c):  # what is fixed to the last has no slopes, only itself
        shift = effect.shift(at.at.recorded, at.model.formulation.data, c)
        basis = {name: change[:, None] for name, change in shift.items()}
    weight = {
        name: float(np.sum((at.at.slopes[name][:, :, None] * change[:, None, :]) ** 2))
        for name, change in basis.items()
        if name in at.at.slopes
    }
    return max(weight, key=lambda name: weight[name]) if weight and max(weight.values()) > 0 else None


def error_of(quantity: str, fit: Fit) -> tuple[Array, Array]:
    """Return the error of `quantity` that each reading implies, and the weight of that, (n,) each."""
    n, c = fit.at.misclosure.shape
    r = fit.r.reshape(n, c)
    s = fit.at.whiten(fit.at.slopes[quantity][:, :, None]).reshape(n, c)
    weight = (s**2).sum(axis=1)
    return -(s * r).sum(axis=1) / np.maximum(weight, 1e-300), weight / fit.noise.scale**2


def _workspace(report: Report) -> Workspace | None:
    """Return the place of each reading and the mean of its residuals; None where the machine tells no place."""
    fit = report.before.fit
    place = fit.model.formulation.covariates(fit.at.recorded).get(WORKSPACE, {})
    if not {"x", "y"} <= set(place):
        return None
    n, c = fit.at.misclosure.shape
    residual = fit.r.reshape(n, c).sum(axis=1) / (np.sqrt(c) * fit.noise.scale)
    return Workspace(np.asarray(place["x"]), np.asarray(place["y"]), residual)
