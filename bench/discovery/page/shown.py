"""What the drawings of a search show, from its `Report` alone: plain values, which another process can draw.

A whitened residual has no direct meaning for an engineer, and its sign depends on the pose. So the residuals of each
reading are shown as the error of the one quantity that an effect changes (an encoder's angle, a link's length) which
would cause them: with the whitened slopes s of that quantity, s . r / s . s, of weight s . s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any, NamedTuple, final

import numpy as np

from calibench.bench.discovery.page.words import compared, floor_holds_the_gap, in_small_units, noise_words
from calibench.core.tables.cells import between
from calibench.core.words import plain
from calibench.discrepancy.diagnostics.noise import outliers_under
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.labels import effect_label, quantity_label, quantity_of
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import WORKSPACE
from calibench.discrepancy.model.measured import sensor_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.report import Finding, Report
from calibench.discrepancy.search.form import Modulated, forms_of
from calibench.problems.base import Array


class Shown(NamedTuple):
    """A drawing to be made: the `name` of its files, and of the `drawing` of `figures` that takes these `values`."""

    name: str
    drawing: str
    values: tuple[Any, ...]


def shown_by(report: Report, series: Series) -> Iterator[Shown]:
    """Yield the drawings of a page, in its order."""
    machine = report.machine
    if report.where:
        yield Shown("where", "where_map", (machine, report.where, report.words))
    if series.workspace:
        yield Shown("workspace", "workspace_map", series.workspace)
    if series.candidates:
        yield Shown("candidates", "candidate_chart", (machine, series.candidates))
    for number, residuals in enumerate(series.residuals, start=1):
        yield Shown(f"residuals_{number}", "residual_chart", (residuals,))
    if np.isfinite(report.gap.held_out_before) and report.gap.noise_floor > 0:
        said = (compared(report), noise_words(report), not floor_holds_the_gap(report))
        yield Shown("gap", "gap_chart", (report.gap, *said))
    made = {
        "outlier": ("outliers_in_time", _outliers), "quantisation": ("steps_of_the_sensor", _steps),
        "heavy_tails": ("tails_of_the_residuals", _tails),
    }  # fmt: skip
    blamed = [finding for finding in report.findings if finding.family in made]
    for number, finding in enumerate(blamed, start=1):
        drawing, values = made[finding.family]
        yield Shown(f"noise_{number}", drawing, values(report, finding))


def _outliers(report: Report, finding: Finding) -> tuple[Any, ...]:
    """Return the error that each reading of the sensor implies over time, and which are taken for outlying."""
    fit = report.model.fit
    sensor = sensor_of(fit.model.formulation.sensors, finding.target)
    encoder, data = sensor.column, fit.model.formulation.data
    label = sensor.label or quantity_label(report.machine, encoder)
    error, weight = error_of(encoder, fit)
    factor, unit = in_small_units(sensor.unit, error)
    timed = data.has("t_s")
    at = np.asarray(data["t_s"] if timed else np.arange(len(data)), dtype=float)
    outlying = outliers_under(fit.model, fit.x, finding.target).weights > 0.5
    stated = factor * float(np.median(fit.model.formulation.sigma[encoder]))
    known = weight if outlying.all() else weight[~outlying]
    sure = ~outlying & (weight >= np.quantile(known, 0.25))  # others hardly know this encoder
    return timed, at, factor * error, outlying, sure, stated, label, unit


def _steps(report: Report, finding: Finding) -> tuple[Any, ...]:
    """Return how far the sensor's readings lie from the nearest step: all at 0 where it is read in such steps."""
    formulation, step = report.before.fit.model.formulation, finding.amplitude.value
    sensor = sensor_of(formulation.sensors, finding.target)
    factor, unit = in_small_units(sensor.unit, step)
    label = sensor.label or quantity_label(report.machine, sensor.column)
    turns = np.asarray(formulation.data[sensor.column]) / step
    origin = np.angle(np.exp(2j * np.pi * turns).mean()) / (2 * np.pi)
    return (turns - origin + 0.5) % 1.0 - 0.5, label, f"{plain(factor * step, 4)} {unit}".rstrip()


def _tails(report: Report, finding: Finding) -> tuple[Any, ...]:
    """Return the sizes of the residuals, the largest first, in deviations of a Gaussian of the same median."""
    size = np.sort(np.abs(report.before.fit.r))[::-1]
    return (size / (float(np.median(size)) / 0.6745),)


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
class Series:
    """`candidates`: columns effect, family, target, gain, p, visible_fraction, in_set, chosen, or none. `workspace`:
    where the tool stood, x and y [mm], and the whitened residual without an effect, (n,) each; () where none is told.
    """

    candidates: Mapping[str, Sequence[Any]]
    residuals: tuple[Residuals, ...] = ()
    workspace: tuple[Array, ...] = ()


def series_of(report: Report) -> Series:
    """Return what the drawings of `report` show: a chart an effect, in the order of the findings."""
    chosen = {finding.effect for finding in report.findings}
    inside = {rival.effect for finding in report.findings for rival in finding.set} | chosen
    keys = ("effect", "family", "target", "gain", "p", "visible_fraction")
    table = {key: [getattr(c, key) for c in report.candidates] for key in keys}
    table |= {"in_set": [c.effect in inside for c in report.candidates]}
    table |= {"chosen": [c.effect in chosen for c in report.candidates]}

    implied = implied_errors(report)
    periods = {finding.effect: finding.period for finding in report.findings}
    charts = [_residuals(each, periods.get(name_of(each.effect), 0.0)) for each in implied]
    if any(each.effect.family == "smooth" for each in implied):  # one correction, however many curves
        charts = list({(chart.label, chart.error): chart for chart in reversed(charts)}.values())[::-1]

    fit = report.before.fit
    workspace: tuple[Array, ...] = ()
    place = fit.model.formulation.covariates(fit.at.recorded).get(WORKSPACE, {})
    if {"x", "y"} <= set(place):
        n, c = fit.at.misclosure.shape
        residual = fit.r.reshape(n, c).sum(axis=1) / (np.sqrt(c) * fit.noise.scale)
        x, y = np.asarray(place["x"]), np.asarray(place["y"])
        there = np.isfinite(x) & np.isfinite(y)  # readings of another kind, of two places, have none
        workspace = x[there], y[there], residual[there]
    return Series(table if report.candidates else {}, tuple(charts), workspace)


def _residuals(implied: Implied, period: float) -> Residuals:
    """Return an implied error in the unit and words of a drawing, over one `period` of its column; 0 is without one.

    An effect that depends on no column is drawn over its own signature: what it changes, calibrated anew, of each
    reading.
    """
    effect, quantity, column = implied.effect, implied.quantity, implied.column
    at = implied.without
    formulation = at.model.formulation
    data, machine, roles = formulation.data, formulation.data.machine, roles_of(formulation)

    def unit_of(name: str) -> str:
        """Return the unit of a quantity as its sensor, parameter, joint, machine or file states it; "" for none."""
        stated = {joint.reading: joint.unit for joint in roles.joints}
        stated |= {p.name: p.unit for p in formulation.parameters}
        stated |= {s.column: s.unit for s in formulation.sensors if s.unit}
        return stated.get(name) or quantity_of(machine, name).unit or data.units.get(name, "")

    def words(name: str) -> str:
        """Return a quantity in words: those of its sensor, or what the machine declares."""
        labels = {sensor.column: sensor.label for sensor in formulation.sensors if sensor.label}
        return labels.get(name) or quantity_label(machine, name, words_of(roles))

    joint = next((j for j in roles.joints if j.reading == quantity and j.told), None)
    if joint is not None:  # it declares in what its errors are drawn
        factor, unit = between(quantity, joint.unit, joint.told), joint.told
    else:
        factor, unit = in_small_units(unit_of(quantity), implied.before)
    if column is None:
        values = factor * (implied.before - implied.after)
        label, own = "what the effect changes of it", unit
    elif period > 0:
        values = np.mod(data[column], period)
        label, own = f"{words(column)} within one period", quantity_of(machine, column).unit
    else:
        values, name = np.asarray(data[column], dtype=float), column
        for target in formulation.covariates(at.at.recorded):
            name = name.removeprefix(f"{target} ")  # of the rows of one target
        label, own = words(name), unit_of(name)
    unnamed = {"smooth": "a smooth correction", "formula": "the formula"}.get(effect.family)
    name = unnamed or effect_label(machine, effect.family, effect.target)
    return Residuals(
        effect=name, label=f"{label} [{own}]" if own else label,
        error=f"error of {words(quantity)}{f' [{unit}]' if unit else ''}", values=values,
        before=factor * implied.before, after=factor * implied.after, weight=factor**-2 * implied.weight,
    )  # fmt: skip


class Implied(NamedTuple):
    """The error of `quantity` that each reading implies, (n,), in its own unit, `before` and `after` the effect.

    `column` is the data column that the effect depends on; None where there is none. `without` is the fit of all other
    effects but this one. `weight`, (n,), is that of `before`.
    """

    effect: Effect
    quantity: str
    column: str | None
    without: Fit
    before: Array
    after: Array
    weight: Array


def implied_errors(report: Report) -> list[Implied]:
    """Return one for each effect that changes a quantity, in the order of the findings.

    Each is against the model with all others but without it and its forms, which is fitted anew. Curves of a smooth
    correction are one correction, however many: they are against the model without any effect.
    """
    before, after = report.before.fit, report.model.fit
    rank = {finding.effect: k for k, finding in enumerate(report.findings)}
    whole = [effect for effect in after.model.effects if not isinstance(effect, Modulated)]
    together = len(whole) == 1 or any(effect.family == "smooth" for effect in whole)
    implied = []
    for effect in sorted(whole, key=lambda effect: rank.get(name_of(effect), len(rank))):
        without = before
        if not together:  # the final model fitted again without one of its effects and its forms
            out = [effect, *forms_of(effect, after.model.effects)]
            kept = [all(other is not one for one in out) for other in after.model.effects]
            ends = np.cumsum([len(other.coefficients) for other in after.model.effects])[:-1]
            parts = np.split(after.x[len(after.model.formulation.parameters) :], ends)
            x = np.concatenate([after.x[: len(after.model.formulation.parameters)], *compress(parts, kept)])
            effects = tuple(compress(after.model.effects, kept))
            without = fit(Model(after.model.formulation, effects), after.noise, x, near=False)
        formulation = without.model.formulation
        data = formulation.data
        column = next((name for name in effect.columns if name in data and data[name].dtype.kind in "if"), None)
        alone = column is None and len(formulation.readings) == 1  # no reading knows a quantity by itself
        quantity = formulation.readings[0] if alone else None
        if not alone:  # the quantity through which a unit of the effect moves the residuals most, if any
            c, slopes = np.zeros(len(effect.coefficients)), without.at.slopes
            basis = effect.basis(without.at.recorded, data, c)
            if not len(c):  # what is fixed to the last has no slopes, only itself
                shift = effect.shift(without.at.recorded, data, c)
                basis = {name: change[:, None] for name, change in shift.items()}
            moves = {
                name: float(np.sum((slopes[name][:, :, None] * change[:, None, :]) ** 2))
                for name, change in basis.items()
                if name in slopes
            }
            if moves and max(moves.values()) > 0:
                quantity = max(moves, key=moves.__getitem__)
        if quantity is not None:
            error, weight = error_of(quantity, without)
            implied.append(Implied(effect, quantity, column, without, error, error_of(quantity, after)[0], weight))
    return implied


def error_of(quantity: str, fit: Fit) -> tuple[Array, Array]:
    """Return the error of `quantity` that each reading implies, and the weight of that, (n,) each."""
    n, c = fit.at.misclosure.shape
    r = fit.r.reshape(n, c)
    s = fit.at.whiten(fit.at.slopes[quantity][:, :, None]).reshape(n, c)
    weight = (s**2).sum(axis=1)
    return -(s * r).sum(axis=1) / np.maximum(weight, 1e-300), weight / fit.noise.scale**2
