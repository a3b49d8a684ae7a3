"""Errors of an instrument that measures from outside: its scale, and readings that come late."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.effects.general.recipe import Built, declared, each_instrument, instrument_of, recipe
from calibench.discrepancy.model.effect import NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


def _scale(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    columns = instrument_of(formulation, target).columns
    needs(formulation.data, *columns)
    if _own_noise(formulation, columns) > 1:
        raise NotTestable("what it measures is too near to its noise: each error would be explained by itself", columns)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: -np.asarray(q[name])[:, None] for name in columns}

    return (
        LinearEffect(
            family.name, target, family.formula, "prediction", columns, ("k",), ("1",), "1", changes,
            largest=thresholds().largest_scale,
        ),
    )  # fmt: skip


def _own_noise(formulation: Formulation, columns: tuple[str, ...]) -> float:
    """Return the gain, in twice the log-likelihood, that noise alone gives to the scale of noisy readings.

    The noise is in the reading and in its error, so the two correlate: n values whose rms is R sigma gain n / R^2 where
    nothing is wrong.
    """
    n = len(formulation.data) * len(columns)
    size = sum(
        float(np.mean((np.asarray(formulation.data[c]) / np.asarray(formulation.sigma[c])) ** 2)) for c in columns
    )
    return n * len(columns) / size if size > 0 else np.inf


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
