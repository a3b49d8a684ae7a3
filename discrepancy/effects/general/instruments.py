"""What may be wrong with an instrument that measures from outside: its scale, and readings that come late."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.effects.general.recipe import Built, declared, each_instrument, instrument_of, recipe
from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array


def _scale(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    columns = instrument_of(formulation, target).columns
    needs(formulation.data, *columns)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: -np.asarray(q[name])[:, None] for name in columns}

    return (LinearEffect(family.name, target, family.formula, "prediction", columns, ("k",), ("1",), "1", changes),)


def _lag(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    instrument = instrument_of(formulation, target)
    declared("".join(instrument.velocity[:1]), target, "velocity of what it measures")
    needs(formulation.data, *instrument.velocity)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: data[v][:, None] for name, v in zip(instrument.columns, instrument.velocity)}

    columns = instrument.velocity
    return (LinearEffect(family.name, target, family.formula, "prediction", columns, ("tau",), ("s",), "s", changes),)


scale = recipe(
    "instrument_scale", "An instrument reads too large or too small", "measured -= k measured", "prediction",
    ("what it measures",), "1", "each instrument", each_instrument, _scale, label="scale error",
)  # fmt: skip
lag = recipe(
    "instrument_lag", "An instrument is read too early or too late", "measured_i += tau velocity_i", "prediction",
    ("the velocity of what it measures",), "s", "each instrument", each_instrument, _lag, label="timing lag",
)  # fmt: skip
