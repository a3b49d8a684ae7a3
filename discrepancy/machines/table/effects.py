"""The effects that a table has under its own names: a known period, a late column, a drift and a step in time."""

from functools import partial

import numpy as np

from calibench.core.options import suggest
from calibench.core.tables.cells import factor_to_base
from calibench.discrepancy.effects.general import columns
from calibench.discrepancy.effects.general.columns import run_terms
from calibench.discrepancy.effects.general.recipe import Built, clock_of, declared, recipe
from calibench.discrepancy.model.effect import EffectFamily, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.model.roles import RATE, inputs_of, roles_of
from calibench.problems.base import Array

_OF = {"once": 1, "twice": 2}  # harmonics of a known period
_COVERED = 0.8  # of a turn, from which on what repeats with it is looked for: a table read every 60 degrees covers .83


def _known(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    word, _, column = target.rpartition(" in ")
    period = _periods(formulation)[column] / _OF[word]
    needs(formulation.data, column)
    [measured], unit = formulation.readings, formulation.unit

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        phase = 2 * np.pi * np.asarray(data[column], dtype=float) / period
        return {measured: -np.stack([np.cos(phase), np.sin(phase)], axis=-1)}

    return family.linear(target, (column,), {"a": unit, "b": unit}, changes)


def _periods(formulation: Formulation) -> dict[str, float]:
    """Return column -> period: as stated, and a turn for an angle that covers nearly one."""
    data, known = formulation.data, roles_of(formulation).columns
    stated = data.metadata.get("periods") or {}
    for column, period in stated.items():
        if isinstance(period, bool) or not isinstance(period, int | float) or not 0 < period < np.inf:
            raise DataError(f"periods: {column}: {period}: a number above 0, in the unit of the column, is needed")
        if column not in known:
            raise DataError(f"periods: {column}: no column that an error may follow; {suggest(column, known)}")
    found: dict[str, float] = {}
    for column in known:  # a whole turn in the unit of an angle, which covers nearly one
        try:
            base, scale = factor_to_base(column, data.units.get(column, "1"))
        except ValueError:
            continue
        if base == "rad" and column in data and np.ptp(data[column]) > _COVERED * (2 * np.pi / scale):
            found[column] = 2 * np.pi / scale
    return found | {column: float(period) for column, period in stated.items()}


def _lag(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    declared(roles_of(formulation).time, "the table", "time")
    rate = f"{RATE}{target}"
    needs(formulation.data, rate)
    return family.linear(target, (rate,), {"tau": "s"}, lambda q, data: {target: data[rate][:, None]})


def _drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    clock = clock_of(formulation, "the table")
    t, unit = formulation.data[clock], formulation.unit
    origin, span = float(t.min()), float(np.ptp(t))

    def changes(count: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {target: -run_terms((data[clock] - origin) / span)[:, :count]}

    names = ("even", "bend", "turn")
    return tuple(
        family.linear(target, (clock,), dict.fromkeys(names[:count], unit), partial(changes, count))
        for count in (1, 2, 3)
    )


def _step(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    clock = clock_of(formulation, "the table")
    return family.steps(target, clock, formulation.data[clock], {target: ("step", formulation.unit, 1.0)})


FAMILIES = (
    columns.power.enter("table"),
    recipe(
        "known_cycle", "What is measured repeats with a period that is stated",
        "measured -= a cos(2 pi k u / P) + b sin(2 pi k u / P), P stated, k 1 or 2", channel="prediction",
        columns=("the column",), unit="that of the measurement",
        targets="once and twice in the period of each column of periods=, and in a turn of an angle that covers one",
        targets_in=lambda f: tuple(f"{word} in {column}" for column in _periods(f) for word in _OF),
        make=_known, label="cycle of known period",
    ).enter("table"),
    recipe(
        "column_lag", "An input is read too early or too late", "u += tau du/dt", channel="reading",
        columns=("the time",), unit="s", targets="each input but the time",
        targets_in=lambda f: tuple(c for c in inputs_of(f) if c != roles_of(f).time), make=_lag, label="lag",
    ).enter("table"),
    recipe(
        "drift", "What is measured drifts during the run",
        "measured -= even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run",
        channel="prediction", columns=("the time",), unit="that of the measurement", targets="the measured column",
        targets_in=lambda f: tuple(f.readings), make=_drift,
    ).enter("table"),
    recipe(
        "step", "What is measured steps once during the run", "measured += step from a time on", channel="prediction",
        columns=("the time",), unit="that of the measurement", targets="the measured column",
        targets_in=lambda f: tuple(f.readings), make=_step,
    ).enter("table"),
)  # fmt: skip
