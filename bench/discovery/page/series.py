"""What the drawings of a search are made of: the series behind a report, in plain arrays.

A whitened residual says little to an engineer, and its sign turns with the pose. So the residuals of each reading are
told as the error of the one quantity that an effect acts on (an encoder's angle, a link's length) which would leave
them: with the whitened slopes s of that quantity, s . r / s . s, of weight s . s.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import pi
from typing import final

import numpy as np
import pandas as pd

from bench.discovery.page.words import column_words, effect_words
from bench.measured.units import COLUMN_UNITS
from discrepancy.fitting.fit import Fit, fit
from discrepancy.model.effect import Effect, name_of
from discrepancy.model.model import Model
from discrepancy.report import Report
from problems.base import Array

_MADE = {"move along": "mm", "place_": "mm", "time": "s", "payload": "N", "temperature": "K"}
_ANGLES = ("enc_", "z", "tilt_", "gauge_roll", "gauge_pitch")  # quantities in rad, by their beginning; others are mm
_READING = "deviation"  # what a gauge says: told instead of a quantity that no reading knows by itself


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
    data = before.model.formulation.data
    column = next((name for name in effect.columns if name in data and data[name].dtype.kind in "if"), None)
    gauged = column is None and _READING in before.at.slopes
    quantity = _READING if gauged else _most_changed(effect, before)
    if quantity is None:
        return None
    told, weight = error_of(quantity, before)
    left, _ = error_of(quantity, after)
    unit = "mrad" if quantity.startswith(_ANGLES) else "µm"
    teeth = data.metadata.get("tooth_numbers")
    if column is None:
        values, label = 1e3 * (told - left), f"what the effect changes of it [{unit}]"
    elif effect.family == "cyclic" and isinstance(teeth, list):
        period = 2 * pi / float(teeth[int(effect.target[-1]) - 1])
        values, label = np.mod(data[column], period), f"{column_words(column)} within one tooth [rad]"
    else:
        values, label = np.asarray(data[column], dtype=float), _axis_label(column)
    name = "a smooth correction" if effect.family == "smooth" else effect_words(effect.family, effect.target)
    error = f"error of {column_words(quantity)} [{unit}]"
    return Residuals(name, label, error, values, 1e3 * told, 1e3 * left, 1e-6 * weight)


def _axis_label(column: str) -> str:
    """Return a column, or a covariate that a machine made of several, in words with its unit."""
    name = re.sub(r"^leg \w ", "", column)  # of the rows of one leg
    unit = COLUMN_UNITS.get(name) or next((unit for start, unit in _MADE.items() if name.startswith(start)), "")
    return column_words(name) + (f" [{unit}]" if unit else "")


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
    place = fit.model.formulation.covariates(fit.at.recorded).get("workspace", {})
    if not {"x", "y"} <= set(place):
        return None
    n, c = fit.at.misclosure.shape
    residual = fit.r.reshape(n, c).sum(axis=1) / (np.sqrt(c) * fit.noise.scale)
    return Workspace(np.asarray(place["x"]), np.asarray(place["y"]), residual)
