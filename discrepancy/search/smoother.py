"""The model where no named effect fits: smooth functions of the covariates, with length and size set by likelihood.

A component adds an unknown function of one covariate (or of the place) to one reading: a Gaussian process in the basis
of its domain's cosines (Solin and Sarkka 2020), with amplitude and length by marginal likelihood and the calibration's
parameters integrated out. Components are added one after the other, while they also predict the fitted poses better
when those are left out in turn. Outside the range of the fitted rows a function is constant.

An error without a name, described so that the user can act: which number errs, over what, how much, in what shape.

Where no formula fits, smooth functions were fitted. Each is a function of one covariate, so words can describe its
shape: an error at one place by that place; over an angle that was read over its whole turn as waves a turn; over
anything else as a line, a bend, an S, or by its number of waves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calibench.core.tables.cells import between
from calibench.core.words import plain
from calibench.discrepancy.diagnostics.score import projected_scores
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, smooth_columns
from calibench.discrepancy.fitting.fit import Fit, fit, project_off, reading_order
from calibench.discrepancy.model.effect import Effect, has_free_period
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.noise.whiten import whitener
from calibench.discrepancy.report import Nearest, Shortest, Unnamed
from calibench.discrepancy.search.select import Tests, best_of_each
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import folds
from calibench.problems.base import Array

_WAVES, _SIDE = 60, 9  # cosines over a covariate, and along each side of the workspace
_MARGIN = 0.15  # of the range, by which the cosines' domain is wider at either end
_LENGTHS = (0.015, 0.03, 0.06, 0.12, 0.25, 0.5)  # of the range
_SIZES = np.geomspace(0.03, 100.0, 15)  # amplitudes tried, in sigma
_PASSES = 3
_NOTHING = 1e-12  # part of the largest variance of a weight: cosines below it are left out


@final
@dataclass(frozen=True, eq=False)
class Component:
    """A smooth function of columns, mapped from [low, high], that changes one quantity; `weights` of its cosines."""

    target: str
    covariate: str
    quantity: str
    columns: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    count: int
    levels: tuple[float, ...] = ()
    weights: Array = field(default_factory=lambda: np.zeros(0))

    def waves(self, data: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the cosines at each row, (n, m), and their frequencies, (m,), in radians per range.

        A row with a missing value has 0. A covariate of a few levels has a column for each.
        """
        values = [np.asarray(data[name], dtype=float) for name in self.columns]
        if self.levels:
            return np.stack([values[0] == level for level in self.levels], axis=-1).astype(float), np.zeros(
                len(self.levels)
            )
        order = np.arange(self.count) * np.pi / (1 + 2 * _MARGIN)
        one, squares = np.ones((len(values[0]), 1)), np.zeros(1)
        for value, low, high in zip(values, self.low, self.high):
            s = (np.clip(value, low, high) - low) / (high - low) + _MARGIN
            s = np.where(np.isfinite(s), s, 0.0)
            one = (one[:, :, None] * np.cos(s[:, None] * order)[:, None, :]).reshape(len(s), -1)
            squares = (squares[:, None] + order**2).ravel()
        one[~np.all(np.isfinite(values), axis=0)] = 0.0  # rows that are not the target's
        return one[:, 1:], np.sqrt(squares[1:])  # a constant would be an offset, which calibration has


@final
@dataclass(frozen=True, eq=False)
class Smooth:
    """An `Effect` without a name and without coefficients: the sum of its components as they were found.

    It holds the formulation and the parameters at which it was found, because a place is computed from both.
    """

    components: tuple[Component, ...]
    formulation: Formulation
    x: Array
    target: str = "all"
    family: str = "smooth"
    channel: str = "reading"
    formula: str = "smooth functions of what was met"
    columns: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    twins: tuple[str, ...] = ()
    unit: str = "rad"
    positions: int = 1

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,)."""
        missing = {name for one in self.components for name in one.columns if name not in data}
        if missing:
            data = data.with_columns(smooth_columns(self.formulation.on(data), self.x))
        found: dict[str, Array] = {}
        for one in self.components:
            change = one.waves(data.columns)[0] @ one.weights
            found[one.quantity] = found.get(one.quantity, 0.0) + change
        return found

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n, 0)."""
        return {one.quantity: np.zeros((len(data), 0)) for one in self.components}

    def amplitude(self, c: Array) -> float:
        """Return the length of the weights."""
        return float(np.sqrt(sum(float(one.weights @ one.weights) for one in self.components)))


def fit_smooth(base: Fit, terms: tuple[SmoothTerm, ...]) -> Fit:
    """Return the fit with the smooth functions that these data support; `base` itself where none predicts.

    Scores of heavy-tailed noise are clipped, and smooth errors with them, so another pass fits the remaining error.
    """
    current = base
    for _ in range(_PASSES if np.isfinite(base.noise.t_degrees) else 1):
        after = _once(current, terms)
        if after is current:
            break
        current = after
    return current


def _once(base: Fit, terms: tuple[SmoothTerm, ...]) -> Fit:
    at, c = base.at, base.at.misclosure.shape[1]
    n = len(at.misclosure)
    some = np.unique(
        np.linspace(0, n - 1, min(n, thresholds().drawn_rows // c)).round().astype(int)
    )  # of very many readings, a part tells the same
    data = at.model.formulation.data
    whiten = at.whiten
    if len(some) < n:
        whiten = whitener(
            at.reading_slopes[some], at.sigma[some], base.noise.autocorrelation, reading_order(data)[some]
        )
        data = data.rows(some)
    r, J = whiten(at.misclosure[some]), whiten(at.columns[some])
    on, y, gain = projected_scores(replace(base, r=r, J=J)), base.noise.scores(r), base.noise.gain
    size = np.sqrt((J**2).sum(axis=0))
    J = J / np.where(size > 0, size, 1.0)
    fold = np.repeat(folds(data, thresholds().folds), c)
    pose = np.unique(data["pose_id"] if data.has("pose_id") else np.arange(len(data)), return_inverse=True)[1]
    pose = np.repeat(pose, c)

    tried: list[_Tried] = []
    for component in (one for term in terms for one in _components(term, len(some))):
        waves, frequencies = component.waves(data.columns)
        raw = whiten(at.slopes[component.quantity][some][:, :, None] * waves[:, None, :]) * gain
        tried.append(_Tried(component, raw, project_off(raw, on.Q), _variances(component, frequencies, raw)))
    chosen: list[tuple[_Tried, Array]] = []
    best = _crossed(J, np.zeros((len(y), 0)), 1.0, y, fold)
    while len(chosen) < thresholds().smooth_most:
        B = _columns(chosen, len(y))
        rest = _rest(B, on.y, on.degrees)
        free = [one for one in tried if all(one is not other for other, _ in chosen)]
        if not free:
            break
        found = [_likeliest(one, B / rest, on.y / rest, on.degrees, 1 / rest**2) for one in free]
        worth, one, variances = max(found, key=lambda fitted: fitted[0])
        if worth < thresholds().smooth_gain:
            break
        trial = [*chosen, (one, variances * rest**2)]
        raw = np.concatenate([one.raw * np.sqrt(v) for one, v in trial], axis=1)
        error = _crossed(J, raw, _rest(_columns(trial, len(y)), on.y, on.degrees), y, fold)
        gained = np.bincount(pose, best - error)
        if not gained.sum() > thresholds().smooth_sure * np.sqrt(np.sum(gained**2)):
            break
        best, chosen = error, trial
    if not chosen:
        return base
    B = _columns(chosen, len(y))
    w = -np.linalg.solve(_rest(B, on.y, on.degrees) ** 2 * np.eye(B.shape[1]) + B.T @ B, B.T @ on.y)
    smooth: list[Component] = []
    k = 0
    for one, v in chosen:
        smooth.append(replace(one.component, weights=np.asarray(w[k : k + len(v)] * np.sqrt(v))))
        k += len(v)
    columns = tuple(name for component in smooth for name in component.columns)
    effect = Smooth(tuple(smooth), base.model.formulation, base.x, smooth[0].target, columns=columns)
    after = fit(base.model.with_effects(effect), base.noise, base.x)
    return after if after.cost < base.cost else base


def _columns(chosen: list[tuple[_Tried, Array]], n: int) -> Array:
    """Return the chosen components' columns, projected off calibration, each scaled to a weight of variance 1."""
    return np.concatenate([np.zeros((n, 0)), *(one.seen * np.sqrt(v) for one, v in chosen)], axis=1)


def _rest(B: Array, y: Array, degrees: int) -> float:
    """Return the rms of the part of y that smooth columns B do not explain: the noise, which is 1, and other causes."""
    G, b, total = B.T @ B, B.T @ y, float(y @ y)
    square = max(1.0, total / degrees)
    for _ in range(10 if B.shape[1] else 0):
        square = max(1.0, (total - float(b @ np.linalg.solve(square * np.eye(len(b)) + G, b))) / degrees)
    return float(np.sqrt(square))


def _components(term: SmoothTerm, n: int) -> list[Component]:
    # as many as the poses can tell, and no more
    count = min(_WAVES, max(4, n // 4)) if len(term.covariates) == 1 else _SIDE
    return [
        Component(
            target=term.target,
            covariate=term.covariate,
            quantity=quantity,
            columns=term.covariates,
            low=term.low,
            high=term.high,
            count=count,
            levels=term.levels,
        )
        for quantity in term.quantities
    ]


@final
@dataclass(frozen=True, eq=False)
class _Tried:
    """A component's cosines in the scores: `raw` (N, m), and projected off calibration, `seen`."""

    component: Component
    raw: Array
    seen: Array
    variances: Array  # (lengths, m) of the weights, for an amplitude of 1


def _variances(component: Component, frequencies: Array, raw: Array) -> Array:
    """Return the variances of the weights, (lengths, m), that make a component's rms about 1 in the scores."""
    shapes = [np.exp(-0.5 * (frequencies * length) ** 2) for length in _LENGTHS[: 1 if component.levels else None]]
    middle = np.sqrt(np.mean(raw**2)) or 1.0
    return np.stack([shape / shape.sum() for shape in shapes]) / middle**2


def _likeliest(one: _Tried, B: Array, y: Array, degrees: int, least: float) -> tuple[float, _Tried, Array]:
    """Return the gain in log-likelihood of a component beside the chosen ones, B, at its best length and size.

    All is relative to the unexplained part so far. The unexplained part afterwards is profiled out; its least value is
    `least`.
    """
    G, b, total = one.seen.T @ one.seen, one.seen.T @ y, float(y @ y)
    if B.shape[1]:
        known = cho_factor(np.eye(B.shape[1]) + B.T @ B)
        C, d = B.T @ one.seen, B.T @ y
        solved = cho_solve(known, np.column_stack([C, d]))
        G, b, total = G - C.T @ solved[:, :-1], b - C.T @ solved[:, -1], total - float(d @ solved[:, -1])
    found = (-np.inf, 0.0, 0)
    for length, variances in enumerate(one.variances):
        some = variances > _NOTHING * variances.max()  # a long length has few cosines
        roots = np.sqrt(variances[some])
        values, vectors = np.linalg.eigh(roots[:, None] * G[np.ix_(some, some)] * roots)
        squares = (vectors.T @ (roots * b[some])) ** 2
        a = _SIZES[:, None] ** 2
        sizes = 1 + a * np.maximum(values, 0)
        left = total - (a * squares / sizes).sum(axis=1)
        rest = np.maximum(least, left / degrees)
        worth = -0.5 * (degrees * np.log(rest) + left / rest - total + np.log(sizes).sum(axis=1))
        k = int(np.argmax(worth))
        found = max(found, (float(worth[k]), _SIZES[k], length), key=lambda solved: solved[0])
    return found[0], one, found[1] ** 2 * one.variances[found[2]]


def _crossed(J: Array, B: Array, rest: float, y: Array, fold: Array) -> Array:
    """Return the squared errors of y, (N,), at poses left out in turn, predicted by calibration J and columns B."""
    X = np.concatenate([J, B], axis=1)
    held = np.concatenate([np.full(J.shape[1], 1e-9), np.full(B.shape[1], rest**2)])
    whole, right = X.T @ X, X.T @ y
    errors = np.empty(len(y))
    for k in range(thresholds().folds):
        out = fold == k
        part = X[out]
        w = np.linalg.solve(whole - part.T @ part + np.diag(held), right - part.T @ y[out])
        errors[out] = (y[out] - part @ w) ** 2
    return errors


NEAR = 0.3  # of what is more than noise: a formula that explains less is no hint
_GRID = 400  # places over the range
_TURN = 0.75  # part of a turn that must be covered for waves a turn to be told
_ORDERS = 8  # waves a turn
_POWERS = ("a line", "a bend", "an S")
_TOLD = 0.8  # share of a course's variance that waves a turn, or line, bend and S, must explain to be told
_SMALL = 0.2  # part of the largest error of its kind: a smaller one is not told
_PLACE = 0.35  # part of the range: an error of which `_TOLD` of the squares lie in less is at one place
_TELLS = 0.1  # share of a course's variance: a smaller one is not told


def unnamed_of(final: Fit) -> tuple[Unnamed, ...]:
    """Return the smooth functions of a fit, the largest relative to the noise first; () where it has none."""
    smooth = [effect for effect in final.model.effects if isinstance(effect, Smooth)]
    parts: dict[tuple[str, str], list[Component]] = {}
    for one in (one for effect in smooth for one in effect.components):
        parts.setdefault((one.quantity, one.covariate), []).append(one)
    shown = [_described_as(own, final.model.formulation) for own in parts.values()]
    return tuple(one for one in shown if one.size >= _SMALL * max(o.size for o in shown if o.unit == one.unit))


def nearest_of(tests: Tests) -> Nearest | None:
    """Return the formula that explains most of the excess over the noise, and its share.

    It is None where no formula explains any.
    """
    best = best_of_each(tests.names, tests.on)[:1]
    excess = tests.on.total - tests.on.degrees
    if not best or not best[0].m or excess <= 0:
        return None
    [one] = best
    return Nearest(one.name, one.effect.family, one.effect.target, float(np.clip((one.T - one.m) / excess, 0.0, 1.0)))


def shortest_of(candidates: Sequence[Effect]) -> tuple[Shortest, ...]:
    """Return, for each column in which waves of any period are searched for, the shortest period."""
    found: dict[str, Shortest] = {}
    for effect in (e for e in candidates if has_free_period(e)):
        period = effect.period(np.zeros(len(effect.coefficients)))  # type: ignore[attr-defined]
        column = effect.columns[0]
        if column not in found or period < found[column].period:
            found[column] = Shortest(column, float(period), effect.period_unit)  # type: ignore[attr-defined]
    return tuple(found.values())


def _described_as(parts: Sequence[Component], formulation: Formulation) -> Unnamed:
    first = parts[0]
    unit, one = _unit_of(first.quantity, formulation)
    if len(first.columns) > 1 or first.levels:
        values = sum(part.waves(_rows(first, formulation))[0] @ part.weights for part in parts)
        return Unnamed(first.quantity, first.covariate, float(np.ptp(values)) / one, unit)
    grid = np.linspace(first.low[0], first.high[0], _GRID)
    values = np.asarray(sum(part.waves({first.columns[0]: grid})[0] @ part.weights for part in parts))
    place = _place(grid, values, *_unit_of(first.covariate, formulation))
    course = _course(grid, values, _turn_of(first.covariate, formulation), place)
    return Unnamed(first.quantity, first.covariate, float(np.ptp(values)) / one, unit, course)


def _rows(part: Component, formulation: Formulation) -> Mapping[str, Array]:
    return {name: np.asarray(formulation.data[name], dtype=float) for name in part.columns}


def _place(grid: Array, values: Array, unit: str, one: float) -> str:
    """Return in words where on an even grid a function lies that is flat elsewhere; "" where it is not at one place.

    `unit` is that of the grid in words, `one` of it in the grid's own.
    """
    squares = np.concatenate([[0.0], np.cumsum((values - np.median(values)) ** 2)])
    ends = np.searchsorted(squares, squares[:-1] + _TOLD * squares[-1])
    widths = np.where(ends < len(squares), ends - np.arange(len(grid)), len(grid) + 1)
    first = int(np.argmin(widths))
    if widths[first] > _PLACE * len(grid):
        return ""
    last = min(first + int(widths[first]), len(grid)) - 1
    low, high = (float(grid[k]) / one for k in (first, last))
    what = "end" if first == 0 or last == len(grid) - 1 else "place"
    return f"most of it at one {what}, from {plain(low, 3)} to {plain(high, 3)}{f' {unit}' if unit else ''}"


def _course(grid: Array, values: Array, turn: float, place: str) -> str:
    """Return the shape of a function on an even grid in words; `turn` is that of its argument, 0 where it has none.

    Shares are shares of its variance. `place` tells where it is not flat, "" if that is everywhere.
    """
    y = values - values.mean()
    if not float(y @ y) > 0:
        return ""
    if turn and np.ptp(grid) > _TURN * turn and not place:
        angle = 2 * np.pi * grid / turn
        waves = [np.stack([np.cos(k * angle), np.sin(k * angle)], axis=-1) for k in range(1, _ORDERS + 1)]
        c = np.linalg.lstsq(np.concatenate([np.ones((len(y), 1)), *waves], axis=1), y, rcond=None)[0][1:]
        powers = [len(y) / 2 * float(np.hypot(*c[2 * k : 2 * k + 2]) ** 2) for k in range(_ORDERS)]
        if float(np.sum((y - np.concatenate(waves, axis=1) @ c) ** 2)) < (1 - _TOLD) * float(y @ y):
            return _shares(powers, [_times(k) for k in range(1, _ORDERS + 1)])
    s = np.linspace(-1, 1, len(y))
    Q = np.linalg.qr(np.vander(s, len(_POWERS) + 1, increasing=True))[0]
    powers = [float(p) for p in (Q.T @ y)[1:] ** 2]
    if sum(powers) > _TOLD * float(y @ y):
        return _shares(powers, _POWERS)
    if place:
        return place
    turns = int((np.diff(np.sign(np.diff(values))) != 0).sum())
    return f"about {(turns + 1) / 2:g} waves over the range"


def _times(k: int) -> str:
    return {1: "once a turn", 2: "twice a turn"}.get(k, f"{k} times a turn")


def _shares(powers: Sequence[float], words: Sequence[str]) -> str:
    total = sum(powers)
    ranked = sorted(((p / total, word) for p, word in zip(powers, words)), reverse=True)
    return ", ".join(f"{100 * share:.0f} % {word}" for share, word in ranked if share > _TELLS)


def _turn_of(covariate: str, formulation: Formulation) -> float:
    """Return the turn of the rotary joint whose reading the covariate is, in its unit; 0 for any other covariate."""
    turns = {"rad": 2 * np.pi, "deg": 360.0}
    joints = {joint.reading: joint for joint in roles_of(formulation).joints if joint.kind == "rotary"}
    return turns.get(joints[covariate].unit, joints[covariate].period) if covariate in joints else 0.0


def _unit_of(quantity: str, formulation: Formulation) -> tuple[str, float]:
    """Return the unit in which a quantity is reported, and one of it in the quantity's own unit."""
    joint = next((joint for joint in roles_of(formulation).joints if joint.reading == quantity), None)
    if joint is not None:
        return (joint.told, between(quantity, joint.told, joint.unit)) if joint.told else (joint.unit, 1.0)
    sensor = next((sensor for sensor in formulation.sensors if sensor.column == quantity), None)
    return (sensor.unit if sensor else "") or formulation.data.units.get(quantity, ""), 1.0
