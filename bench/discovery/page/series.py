"""The series behind the drawings of a search, in plain arrays, units and words.

Nothing is fitted here: `discovery.implied` computes the implied errors of a quantity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import pandas as pd

from calibench.bench.discovery.implied import Implied, implied_errors
from calibench.bench.discovery.page.quantity import in_small_units, largest
from calibench.core.tables.units import between
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.labels import effect_label, quantity_label, quantity_of
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.machine import WORKSPACE, Formulation
from calibench.discrepancy.model.roles import roles_of, words_of
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
    """Return a chart an effect, in the order of the findings; curves over the same axes are drawn once."""
    implied = implied_errors(report)
    periods = {finding.effect: finding.period for finding in report.findings}
    drawn = [_drawn(each, periods.get(name_of(each.effect), 0.0)) for each in implied]
    if any(each.effect.family == "smooth" for each in implied):  # one correction, however many curves
        return tuple({(residuals.label, residuals.error): residuals for residuals in reversed(drawn)}.values())[::-1]
    return tuple(drawn)


def _drawn(implied: Implied, period: float) -> Residuals:
    """Return an implied error in the unit and words of a drawing, over one `period` of its column; 0 is without one.

    An effect that depends on no column is drawn over its own signature: what it changes, calibrated anew, of each
    reading.
    """
    effect, quantity, column = implied.effect, implied.quantity, implied.column
    formulation = implied.without.model.formulation
    data, machine = formulation.data, formulation.data.machine
    factor, unit = _drawn_in(quantity, formulation, largest(implied.before))
    if column is None:
        values = factor * (implied.before - implied.after)
        label = _with_unit("what the effect changes of it", unit)
    elif period > 0:
        own = quantity_of(machine, column).unit
        values = np.mod(data[column], period)
        label = _with_unit(f"{_words(column, formulation)} within one period", own)
    else:
        values, label = np.asarray(data[column], dtype=float), _axis_label(column, implied.without)
    name = "a smooth correction" if effect.family == "smooth" else effect_label(machine, effect.family, effect.target)
    error = _with_unit(f"error of {_words(quantity, formulation)}", unit)
    before, after = factor * implied.before, factor * implied.after
    return Residuals(name, label, error, values, before, after, factor**-2 * implied.weight)


def _drawn_in(quantity: str, formulation: Formulation, size: float) -> tuple[float, str]:
    """Return the factor to the unit in which errors of a quantity are drawn, and its name; a joint may declare it.

    `size` is the largest of the errors.
    """
    joint = next((j for j in roles_of(formulation).joints if j.reading == quantity and j.told), None)
    if joint is not None:
        return between(quantity, joint.unit, joint.told), joint.told
    return in_small_units(_unit_of(quantity, formulation), size)


def _unit_of(quantity: str, formulation: Formulation) -> str:
    """Return the unit of a quantity as its joint, sensor, parameter, machine or file states it; "" where none does."""
    stated = {joint.reading: joint.unit for joint in roles_of(formulation).joints}
    stated |= {p.name: p.unit for p in formulation.parameters}
    stated |= {s.column: s.unit for s in formulation.sensors if s.unit}
    told = stated.get(quantity) or quantity_of(formulation.data.machine, quantity).unit
    return told or formulation.data.units.get(quantity, "")


def _words(quantity: str, formulation: Formulation) -> str:
    """Return a quantity in words: those of its sensor, or what the machine declares."""
    labels = {sensor.column: sensor.label for sensor in formulation.sensors if sensor.label}
    words = words_of(roles_of(formulation))
    return labels.get(quantity) or quantity_label(formulation.data.machine, quantity, words)


def _with_unit(words: str, unit: str) -> str:
    return f"{words} [{unit}]" if unit else words


def _axis_label(column: str, at: Fit) -> str:
    """Return a column, or a covariate that a machine made of several, in words with its unit."""
    formulation = at.model.formulation
    name = column
    for target in formulation.covariates(at.at.recorded):
        name = name.removeprefix(f"{target} ")  # of the rows of one target
    return _with_unit(_words(name, formulation), _unit_of(name, formulation))


def _workspace(report: Report) -> Workspace | None:
    """Return the place of each reading that has one, and the mean of its residuals; None where no place is told."""
    fit = report.before.fit
    place = fit.model.formulation.covariates(fit.at.recorded).get(WORKSPACE, {})
    if not {"x", "y"} <= set(place):
        return None
    n, c = fit.at.misclosure.shape
    residual = fit.r.reshape(n, c).sum(axis=1) / (np.sqrt(c) * fit.noise.scale)
    x, y = np.asarray(place["x"]), np.asarray(place["y"])
    there = np.isfinite(x) & np.isfinite(y)  # readings of another kind, of two places, have none
    return Workspace(x[there], y[there], residual[there])
