"""An error without a name, described so that the user can act: which number errs, over what, how much, in what shape.

Where no formula fits, smooth functions were fitted. Each is a function of one covariate, so words can describe its
shape: an error at one place by that place; over an angle that was read over its whole turn as waves a turn; over
anything else as a line, a bend, an S, or by its number of waves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibench.core.counted import plain
from calibench.core.tables.units import between
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import Effect, has_free_period
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.report import Nearest, Shortest, Unnamed
from calibench.discrepancy.search.select import Tests, best_of_each
from calibench.discrepancy.search.smoother import Component, Smooth
from calibench.problems.base import Array

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
    told = [_told(own, final.model.formulation) for own in parts.values()]
    return tuple(one for one in told if one.size >= _SMALL * max(o.size for o in told if o.unit == one.unit))


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


def _told(parts: Sequence[Component], formulation: Formulation) -> Unnamed:
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
    told = sorted(((p / total, word) for p, word in zip(powers, words)), reverse=True)
    return ", ".join(f"{100 * share:.0f} % {word}" for share, word in told if share > _TELLS)


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
