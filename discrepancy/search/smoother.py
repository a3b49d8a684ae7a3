"""The model where no named effect fits: smooth functions of the covariates, with length and size set by likelihood.

A component adds an unknown function of one covariate (or of the place) to one reading: a Gaussian process in the basis
of its domain's cosines (Solin and Sarkka 2020), with amplitude and length by marginal likelihood. Components are added
one after the other, while they also predict left-out poses better. Outside the fitted rows a function is constant.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calibench.core.tables.cells import between
from calibench.core.words import plain
from calibench.discrepancy.diagnostics.score import projected_scores
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, smooth_columns
from calibench.discrepancy.fitting.fit import Fit, fit, once, project_off, thinned
from calibench.discrepancy.fitting.journal import kept_step
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.report import Unnamed
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import errors_left_out, folds
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
    variances: Array = field(default_factory=lambda: np.zeros(0))  # of the weights, before the data

    def waves(self, data: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the cosines at each row, (n, m), and their frequencies, (m,), in radians per range."""
        values = [np.asarray(data[name], dtype=float) for name in self.columns]
        if self.levels:
            each = np.stack([values[0] == level for level in self.levels], axis=-1)
            return each.astype(float), np.zeros(len(self.levels))
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
        missing = {name for one in self.components for name in one.columns if name not in data}
        if missing:
            data = data.with_columns(smooth_columns(self.formulation.on(data), self.x))
        found: dict[str, Array] = {}
        for one in self.components:
            change = one.waves(data.columns)[0] @ one.weights
            found[one.quantity] = found.get(one.quantity, 0.0) + change
        return found

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        return {one.quantity: np.zeros((len(data), 0)) for one in self.components}

    def amplitude(self, c: Array) -> float:
        return float(np.sqrt(sum(float(one.weights @ one.weights) for one in self.components)))


def fit_smooth(base: Fit, terms: tuple[SmoothTerm, ...]) -> Fit:
    """Return the fit with the smooth functions that these data support; `base` itself where none predicts."""
    current = base
    # scores of heavy-tailed noise are clipped, and smooth errors with them: another pass fits the remaining error
    for _ in range(_PASSES if np.isfinite(base.noise.t_degrees) else 1):
        after = once(partial(_once, current, terms), (current, *terms))
        if after is current:
            break
        current = after
    return current


def _once(base: Fit, terms: tuple[SmoothTerm, ...]) -> Fit:
    smooth = kept_step(lambda: _components(base, terms), ("smooth", len(terms), base.x, base.r))
    if not smooth:
        return base
    columns = tuple(name for component in smooth for name in component.columns)
    effect = Smooth(smooth, base.model.formulation, base.x, smooth[0].target, columns=columns)
    after = fit(base.model.with_effects(effect), base.noise, base.x)
    return after if after.cost < base.cost else base


def _components(base: Fit, terms: tuple[SmoothTerm, ...]) -> tuple[Component, ...]:
    """Return the smooth functions that these data support beside a fit, with their weights."""
    part, t = thinned(base), thresholds()
    at, on, y, gain = part.at, projected_scores(part), base.noise.scores(part.r), base.noise.gain
    n, c = at.misclosure.shape
    J, data, whiten = part.J, part.model.formulation.data, at.whiten
    fold = np.repeat(folds(data, t.folds), c)
    pose = np.unique(data["pose_id"] if data.has("pose_id") else np.arange(len(data)), return_inverse=True)[1]
    pose = np.repeat(pose, c)

    def raw_of(component: Component, waves: Array) -> Array:  # its cosines in the scores
        return whiten(at.slopes[component.quantity][:, :, None] * waves[:, None, :]) * gain

    # each component with its cosines projected off calibration, and the variances of their weights, (lengths, m), for
    # an rms of about 1 in the scores
    tried: list[tuple[Component, Array, Array]] = []
    squares: list[Array] = []  # their products with each other
    for term, quantity in ((one, quantity) for one in terms for quantity in one.quantities):
        # as many cosines as the poses can tell, and no more
        count = min(_WAVES, max(4, n // 4)) if len(term.covariates) == 1 else _SIDE
        component = Component(
            target=term.target, covariate=term.covariate, quantity=quantity, columns=term.covariates, low=term.low,
            high=term.high, count=count, levels=term.levels,
        )  # fmt: skip
        waves, frequencies = component.waves(data.columns)
        raw = raw_of(component, waves)
        shapes = [np.exp(-0.5 * (frequencies * length) ** 2) for length in _LENGTHS[: 1 if term.levels else None]]
        middle = np.sqrt(np.mean(raw**2)) or 1.0
        variances = np.stack([shape / shape.sum() for shape in shapes]) / middle**2
        tried.append((component, seen := project_off(raw, on.Q), variances))
        squares.append(seen.T @ seen)

    # the most likely ones in turn, with the variance of each weight; `B` are their columns scaled to a variance of 1
    chosen: dict[int, Array] = {}
    B, raws = np.zeros((len(y), 0)), np.zeros((len(y), 0))
    best = errors_left_out(J, y, fold) ** 2
    while len(chosen) < min(t.smooth_most, len(tried)):
        rest = _rest(B, on.y, on.degrees)
        scaled, y_scaled = B / rest, on.y / rest
        known = cho_factor(np.eye(B.shape[1]) + scaled.T @ scaled) if B.shape[1] else None
        fitted = {
            k: _beside(seen, squares[k], lengths, scaled, y_scaled, known, on.degrees, 1 / rest**2)
            for k, (_, seen, lengths) in enumerate(tried)
            if k not in chosen
        }
        k = max(fitted, key=lambda k: fitted[k][0])
        if fitted[k][0] < t.smooth_gain:
            break
        variances = fitted[k][1] * rest**2
        component, seen, _ = tried[k]
        raw = raw_of(component, component.waves(data.columns)[0])
        more = np.concatenate([B, seen * np.sqrt(variances)], axis=1)
        further = np.concatenate([raws, raw * np.sqrt(variances)], axis=1)
        error = errors_left_out(J, y, fold, further, _rest(more, on.y, on.degrees) ** 2) ** 2
        gained = np.bincount(pose, best - error)
        if not gained.sum() > t.smooth_sure * np.sqrt(np.sum(gained**2)):
            break
        best, B, raws = error, more, further
        chosen[k] = variances
    if not chosen:
        return ()

    w = -np.linalg.solve(_rest(B, on.y, on.degrees) ** 2 * np.eye(B.shape[1]) + B.T @ B, B.T @ on.y)
    ends = np.cumsum([len(v) for v in chosen.values()])[:-1]
    return tuple(
        replace(tried[k][0], weights=np.asarray(own * np.sqrt(v)), variances=np.asarray(v))
        for (k, v), own in zip(chosen.items(), np.split(w, ends))
    )


def left_out(at: Fit, fold: Array) -> Array:
    """Return the errors, in scores, of each fold of rows (n,) predicted by the others, smooth functions learned anew.

    Parameters and coefficients are free in each fold, to first order; weights of cosines are held by their variances.
    """
    data, c, gain = at.at.model.formulation.data, at.at.misclosure.shape[1], at.noise.gain
    own = [(e, one) for e in at.model.effects if isinstance(e, Smooth) for one in e.components]
    y, columns = at.noise.scores(at.r), [np.empty((len(at.r), 0))]
    for effect, one in own:
        there = all(name in data for name in one.columns)
        met = data if there else data.with_columns(smooth_columns(effect.formulation.on(data), effect.x))
        raw = at.at.whiten(at.at.slopes[one.quantity][:, :, None] * one.waves(met.columns)[0][:, None, :]) * gain
        some = one.variances > _NOTHING * max(float(one.variances.max()), 1e-300)
        y = y - raw[:, some] @ one.weights[some]
        columns.append(raw[:, some] * np.sqrt(one.variances[some]))
    return errors_left_out(at.J, y, np.repeat(fold, c), np.concatenate(columns, axis=1))


def _rest(B: Array, y: Array, degrees: int) -> float:
    """Return the rms of the part of y that smooth columns B do not explain: the noise, which is 1, and other causes."""
    G, b, total = B.T @ B, B.T @ y, float(y @ y)
    square = max(1.0, total / degrees)
    for _ in range(10 if B.shape[1] else 0):
        square = max(1.0, (total - float(b @ np.linalg.solve(square * np.eye(len(b)) + G, b))) / degrees)
    return float(np.sqrt(square))


def _beside(
    seen: Array, G: Array, lengths: Array, B: Array, y: Array, known: tuple[Array, bool] | None, degrees: int,
    least: float,
) -> tuple[float, Array]:  # fmt: skip
    """Return the gain in log-likelihood of a component, of its likeliest length and size, and its weights' variances.

    It is that of cosines `seen` (N, m), of square `G`, whose weights have the variances of one of `lengths`, beside the
    chosen columns B of scores y; `known` is the factor of the latter.
    """
    b, total, a = seen.T @ y, float(y @ y), _SIZES[:, None] ** 2
    if known is not None:
        C, d = B.T @ seen, B.T @ y
        solved = cho_solve(known, np.column_stack([C, d]))
        G, b, total = G - C.T @ solved[:, :-1], b - C.T @ solved[:, -1], total - float(d @ solved[:, -1])
    best, likeliest = -np.inf, lengths[0]
    for variances in lengths:
        some = variances > _NOTHING * variances.max()  # a long length has few cosines
        roots = np.sqrt(variances[some])
        values, vectors = np.linalg.eigh(roots[:, None] * G[np.ix_(some, some)] * roots)
        squares = (vectors.T @ (roots * b[some])) ** 2
        grown = 1 + a * np.maximum(values, 0)
        left = total - (a * squares / grown).sum(axis=1)
        rest = np.maximum(least, left / degrees)
        worth = -0.5 * (degrees * np.log(rest) + left / rest - total + np.log(grown).sum(axis=1))
        k = int(np.argmax(worth))
        if worth[k] > best:
            best, likeliest = float(worth[k]), _SIZES[k] ** 2 * variances
    return best, likeliest


NEAR = 0.3  # of what is more than noise: a formula that explains less is no hint
_GRID = 400  # places over the range
_TURN = 0.75  # part of a turn that must be covered for waves a turn to be told
_ORDERS = 8  # waves a turn
_TURNS = ("once a turn", "twice a turn", *(f"{k} times a turn" for k in range(3, _ORDERS + 1)))
_POWERS = ("a line", "a bend", "an S")
_TOLD = 0.8  # share of a course's variance that waves a turn, or line, bend and S, must explain to be told
_SMALL = 0.2  # part of the largest error of its kind: a smaller one is not told
_PLACE = 0.35  # part of the range: an error of which `_TOLD` of the squares lie in less is at one place
_TELLS = 0.1  # share of a course's variance: a smaller one is not told
_TURNS_BACK = 0.1  # of its range, by which a curve must turn back for another wave


def unnamed_of(final: Fit) -> tuple[Unnamed, ...]:
    """Return the smooth functions of a fit, the largest relative to the noise first; () where it has none."""
    formulation, data = final.model.formulation, final.model.formulation.data
    smooth = [effect for effect in final.model.effects if isinstance(effect, Smooth)]
    parts: dict[tuple[str, str], list[Component]] = {}
    for one in (one for effect in smooth for one in effect.components):
        parts.setdefault((one.quantity, one.covariate), []).append(one)
    shown = []
    for (quantity, covariate), own in parts.items():
        first, course = own[0], ""
        unit, one_unit = _unit_of(quantity, formulation)
        if len(first.columns) > 1 or first.levels:
            rows = {name: np.asarray(data[name], dtype=float) for name in first.columns}
            values = np.asarray(sum(part.waves(rows)[0] @ part.weights for part in own))
        else:
            grid = np.linspace(first.low[0], first.high[0], _GRID)
            values = np.asarray(sum(part.waves({first.columns[0]: grid})[0] @ part.weights for part in own))
            # the turn of the rotary joint whose reading the covariate is
            joints = [j for j in roles_of(formulation).joints if j.kind == "rotary" and j.reading == covariate]
            turns = [{"rad": 2 * np.pi, "deg": 360.0}.get(j.unit, j.period) for j in joints]
            course = _course(
                grid, values, turns[-1] if turns else 0.0, _place(grid, values, *_unit_of(covariate, formulation))
            )
        shown.append(Unnamed(quantity, covariate, float(np.ptp(values)) / one_unit, unit, course))
    return tuple(one for one in shown if one.size >= _SMALL * max(o.size for o in shown if o.unit == one.unit))


def _place(grid: Array, values: Array, unit: str, one: float) -> str:
    """Return in words where on an even grid a function lies that is flat elsewhere; "" where it is not at one place."""
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
    """Return the shape of a function on an even grid in words; `turn` is that of its argument, 0 where it has none."""
    y = values - values.mean()
    if not float(y @ y) > 0:
        return ""
    if turn and np.ptp(grid) > _TURN * turn and not place:
        angle = 2 * np.pi * grid / turn
        waves = [np.stack([np.cos(k * angle), np.sin(k * angle)], axis=-1) for k in range(1, _ORDERS + 1)]
        c = np.linalg.lstsq(np.concatenate([np.ones((len(y), 1)), *waves], axis=1), y, rcond=None)[0][1:]
        powers = [len(y) / 2 * float(np.hypot(*c[2 * k : 2 * k + 2]) ** 2) for k in range(_ORDERS)]
        if float(np.sum((y - np.concatenate(waves, axis=1) @ c) ** 2)) < (1 - _TOLD) * float(y @ y):
            return _shares(powers, _TURNS)
    s = np.linspace(-1, 1, len(y))
    Q = np.linalg.qr(np.vander(s, len(_POWERS) + 1, increasing=True))[0]
    powers = [float(p) for p in (Q.T @ y)[1:] ** 2]
    if sum(powers) > _TOLD * float(y @ y):
        return _shares(powers, _POWERS)
    if place:
        return place
    turns, way, low, high, least = 0, 0, values[0], values[0], _TURNS_BACK * np.ptp(values)
    for value in values:
        low, high = min(low, value), max(high, value)
        if (way >= 0 and high - value > least) or (way <= 0 and value - low > least):
            turns, way = turns + abs(way), -1 if high - value > least and way >= 0 else 1
            low = high = value
    return f"about {(turns + 1) / 2:g} waves over the range"


def _shares(powers: Sequence[float], words: Sequence[str]) -> str:
    total = sum(powers)
    ranked = sorted(((p / total, word) for p, word in zip(powers, words)), reverse=True)
    return ", ".join(f"{100 * share:.0f} % {word}" for share, word in ranked if share > _TELLS)


def _unit_of(quantity: str, formulation: Formulation) -> tuple[str, float]:
    """Return the unit in which a quantity is reported, and one of it in the quantity's own unit."""
    joint = next((joint for joint in roles_of(formulation).joints if joint.reading == quantity), None)
    if joint is not None:
        return (joint.told, between(quantity, joint.told, joint.unit)) if joint.told else (joint.unit, 1.0)
    sensor = next((sensor for sensor in formulation.sensors if sensor.column == quantity), None)
    return (sensor.unit if sensor else "") or formulation.data.units.get(quantity, ""), 1.0
