"""What may be wrong with the gauges of an Orthoglide's measurement: they drift, are misread, lean, or stand elsewhere.

A gauge is named as the chapter names its reading: `gauge y_x` reads the direction y at the leg x.
"""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from calibench.core.counted import plain
from calibench.discrepancy.fitting.projection import project_off
from calibench.discrepancy.machines.orthoglide.validate import rows_of
from calibench.discrepancy.model.effect import Alternative, Effect, HeldBack, NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs_there
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton
from calibench.problems.orthoglide.kinematics import AXES

_GAUGES = tuple(f"gauge {d}_{leg}" for leg in AXES for d in AXES if d != leg)
_LEGS = tuple(f"leg {leg}" for leg in AXES)


def _drift(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs_there(formulation.data, "t_s", "zero_t_s")
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {"deviation": -(_at(data, target) * (data["t_s"] - data["zero_t_s"]))[:, None]}

    columns = ("t_s", "zero_t_s")
    return (LinearEffect("drift", target, drift.formula, "reading", columns, ("rate",), ("mm/s",), "mm/s", changes),)


def _zero(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    if (formulation.data["against_mm"] != 0).all():
        raise NotTestable("no reading is compared with Zero")
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {"deviation": (_at(data, target) * (data["against_mm"] == 0))[:, None]}

    return (LinearEffect("zero_reading", target, zero.formula, "reading", (), ("z",), ("mm",), "mm", changes),)


def _tilt(formulation: Formulation, target: str) -> tuple[Effect, ...] | HeldBack:
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        at, none = _at(data, target), np.zeros(len(data))
        return {"gauge_roll": np.column_stack([at, none]), "gauge_pitch": np.column_stack([none, at])}

    names, units = ("roll", "pitch"), ("rad", "rad")
    most = thresholds().largest_angle
    effect = LinearEffect("gauge_tilt", target, tilt.formula, "reading", (), names, units, "rad", changes, largest=most)
    return _felt(effect, formulation, _LEANING)


def _place(formulation: Formulation, target: str) -> tuple[Effect, ...] | HeldBack:
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {"gauge_shift": _at(data, target)[:, None]}

    effect = LinearEffect("gauge_placement", target, place.formula, "reading", (), ("g",), ("mm",), "mm", changes)
    return _felt(effect, formulation, _ELSEWHERE)


def _felt(effect: LinearEffect, formulation: Formulation, largest: float) -> tuple[Effect, ...] | HeldBack:
    """Return the effect; held back where even the largest that a gauge can have would not show in these readings.

    The question is asked at the calibrated machine: legs that stand as they should look the same from anywhere. A
    coefficient whose largest possible size does not show is left out, because its fitted value would be arbitrary.
    """
    model, x, J = calibrated(formulation)
    q, true = model.quantities(x)
    left = signature(effect, np.zeros(len(effect.coefficients)), q, formulation.slopes(true), formulation)[:, 0, :]
    left = project_off(left, np.linalg.qr(J)[0])
    sigma = float(np.max(formulation.sigma["deviation"]))
    shown = np.linalg.norm(left, axis=0)
    seen = float(shown.max())
    effect = _restricted(effect, (shown * _BEYOND * largest >= _SHOWS * sigma) | (shown == seen))
    if largest * seen < _SHOWS * sigma:
        needed = f"it takes {plain(_SHOWS * sigma / seen, 3)} {effect.unit}" if seen > 0 else "no size would"
        why = f"even {largest:g} {effect.unit} would not show in these readings: {needed}"
        return HeldBack(why, (Alternative(effect, _BEYOND * largest),))
    return (effect,)


def _restricted(effect: LinearEffect, kept: NDArray[np.bool_]) -> LinearEffect:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: change[:, kept] for name, change in effect.changes(q, data).items()}

    def some(words: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(word for word, k in zip(words, kept) if k)

    if kept.all():
        return effect
    return replace(effect, coefficients=some(effect.coefficients), units=some(effect.units), changes=changes)


def calibrated(formulation: Formulation) -> tuple[Model, Array, Array]:
    """Return the model without effects, its least squares x and Jacobian there, (n, p).

    Further calls return the same objects.
    """
    if formulation not in _CALIBRATED:
        model = Model(formulation)
        x = gauss_newton(
            lambda x: model.residuals(x)[:, 0], lambda x: model.jacobian(x)[:, 0, :], model.start, rank_tolerance=1e-9
        )
        _CALIBRATED[formulation] = model, x, model.jacobian(x)[:, 0, :]
    return _CALIBRATED[formulation]


_CALIBRATED: WeakKeyDictionary[Formulation, tuple[Model, Array, Array]] = WeakKeyDictionary()
_LEANING, _ELSEWHERE = 0.1, 10.0  # rad, mm: the most a gauge on a stand can be out of true, or off its mark
_SHOWS = 4.0  # standard deviations
_BEYOND = 3.0  # times that: what is named is held against gauges out of true by up to this


def _at(data: MeasuredData, target: str) -> Array:
    """Return 1 in the rows that a target's gauges read, 0 elsewhere, shape (n,)."""
    rows, place = rows_of(data), target[-3:]
    if target == "all":
        return np.ones(len(data))
    if target.startswith("leg"):
        return np.asarray(rows.leg == AXES.index(target[-1]), dtype=float)
    return np.asarray((rows.direction == AXES.index(place[0])) & (rows.leg == AXES.index(place[2])), dtype=float)


def _meets(data: MeasuredData, target: str) -> None:
    if not _at(data, target).any():
        raise NotTestable(f"no reading of {target}")


drift = EffectFamily(
    "drift", "orthoglide", "The reading of a gauge drifts away from its Zero",
    "deviation read = true + rate (t_s - zero_t_s)", "reading", ("t_s", "zero_t_s"), "mm/s", (*_LEGS, "all"), _drift,
).enter()  # fmt: skip
zero = EffectFamily(
    "zero_reading", "orthoglide", "The Zero of a gauge was misread", "deviation read = true - z", "reading", (), "mm",
    (*_GAUGES, "all"), _zero,
).enter()  # fmt: skip
tilt = EffectFamily(
    "gauge_tilt", "orthoglide", "A gauge does not read along its direction",
    "it reads along d turned by roll about the leg, and by pitch towards the leg's tool end", "reading", (), "rad",
    (*_GAUGES, "all"), _tilt, "nearly unseen where deviations are small: it scales them",
).enter()  # fmt: skip
place = EffectFamily(
    "gauge_placement", "orthoglide", "A gauge stands elsewhere on its leg than stated",
    "the gauge's plane cuts the leg's axis g further from the origin", "reading", (), "mm",
    (*_GAUGES, *_LEGS, "all"), _place, "nearly unseen in moves along the leg: a parallel leg looks the same anywhere",
).enter()  # fmt: skip
