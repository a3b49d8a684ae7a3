"""Angle errors of an encoder that repeat with its turn: an eccentric disc, an oval one, teeth; and their common class.

The encoder is taken to read absolute angles. A head at a fixed distance from the axis sees an eccentric disc under the
sine rule: the error is arcsin(epsilon sin(reading + phase)), exactly. An oval disc, as tracks of unequal gain, turns
tan(angle) into (1 + a) / (1 - a) tan(angle); the others are Fourier terms by definition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.discrepancy.machines.gpm2002.effects.gear import LONGER_ARC
from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.effect import Effect, NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array

_JOINTS = ("joint 1", "joint 2", "joint 3")
_RIM = 0.99  # a disc is not further off its axis than this part of its radius


@final
@dataclass(frozen=True, eq=False)
class ExactHarmonic:
    """An error of the encoder of one joint with two coefficients, in the exact form that its cause gives it.

    `exact(angle, c)` returns the error, (n,), rad, and its derivative, (n, 2); to first order it is one Fourier term.
    """

    target: str
    family: str
    formula: str
    exact: Callable[[Any, Array], tuple[Array, Array]]
    channel: str = "reading"
    twins: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ("a", "b")
    units: tuple[str, ...] = ("rad", "rad")
    unit: str = "rad"
    positions: int = 1

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the encoder."""
        return (f"enc_{number(self.target)}",)

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the error of the encoder, (n,), rad."""
        [encoder] = self.columns
        return {encoder: self.exact(q[encoder], c)[0]}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return its derivative, (n, 2)."""
        [encoder] = self.columns
        return {encoder: self.exact(q[encoder], c)[1]}

    def amplitude(self, c: Array) -> float:
        """Return the largest error, rad: eccentricity over radius; half difference of the axes over their mean."""
        return float(np.hypot(c[0], c[1]))


def eccentric_disc(target: str) -> ExactHarmonic:
    """Return the first harmonic: an eccentric disc."""
    return ExactHarmonic(target, "eccentricity", "enc_i += arcsin(a cos enc_i + b sin enc_i)", _off_axis)


def oval_disc(target: str) -> ExactHarmonic:
    """Return the second harmonic, with the overtones that an oval disc gives it."""
    formula = "enc_i += atan2(u, 1 - v), u = a cos 2 enc_i + b sin 2 enc_i, v = b cos 2 enc_i - a sin 2 enc_i"
    return ExactHarmonic(target, "second_harmonic", formula, _oval)


def _off_axis(angle: Any, c: Array) -> tuple[Array, Array]:
    wave = _wave(angle, 1)
    sine = np.clip(wave @ c, -_RIM, _RIM)
    return np.arcsin(sine), wave / np.sqrt(1 - sine**2)[:, None]


def _oval(angle: Any, c: Array) -> tuple[Array, Array]:
    cos, sin = np.cos(2 * angle), np.sin(2 * angle)
    u, v = np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)  # for unit coefficients, each (n, 2)
    sine, rest = u @ c, 1 - v @ c
    return np.arctan2(sine, rest), (u * rest[:, None] + v * sine[:, None]) / (sine**2 + rest**2)[:, None]


def _eccentricity(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, f"enc_{number(target)}")
    return (eccentric_disc(target),)


def _second(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, f"enc_{number(target)}")
    return (oval_disc(target),)


def _unresolved(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, f"enc_{number(target)}")
    return tuple(_harmonic("angle_error", target, angle_error.formula, orders) for orders in ((3,), (1, 2, 3)))


def _cyclic(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, f"enc_{number(target)}")
    teeth = _teeth(formulation.data.metadata, number(target))
    return tuple(_harmonic("cyclic", target, cyclic.formula, orders) for orders in ((teeth,), (teeth, 2 * teeth)))


def _harmonic(family: str, target: str, formula: str, orders: tuple[float, ...]) -> LinearEffect:
    """Return Fourier terms of `orders` in the encoder of one joint."""
    encoder = f"enc_{number(target)}"
    names = tuple(f"{letter}{order:g}" for order in orders for letter in "ab")

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {encoder: np.concatenate([_wave(q[encoder], order) for order in orders], axis=1)}

    units = ("rad",) * len(names)
    return LinearEffect(family, target, formula, "reading", (encoder,), names, units, "rad", changes)


def _wave(angle: Any, order: float) -> Array:
    return np.stack([np.cos(order * angle), np.sin(order * angle)], axis=-1)


def _teeth(metadata: Mapping[str, Any], i: int) -> float:
    """Return the tooth number of joint i: from a list, a mapping (`1`, `joint 1`, `enc_1`) or one number for all."""
    stated = metadata.get("tooth_numbers")
    if isinstance(stated, Mapping):
        stated = next((stated[key] for key in (str(i), f"joint {i}", f"enc_{i}") if key in stated), None)
    elif isinstance(stated, list | tuple | np.ndarray):
        stated = stated[i - 1] if len(stated) >= i else None
    try:
        teeth = float(stated) if stated is not None else 0.0
    except (TypeError, ValueError):
        teeth = 0.0
    if not (np.isfinite(teeth) and teeth > 0):
        raise NotTestable("needs metadata tooth_numbers", ("metadata tooth_numbers",), missing=True)
    return teeth


def _tooth(metadata: Mapping[str, Any], target: str) -> float:
    """Return the angle of one tooth [rad]; 0 where the tooth number is not stated."""
    try:
        return float(2 * np.pi / _teeth(metadata, number(target)))
    except NotTestable:
        return 0.0


eccentricity = EffectFamily(
    "eccentricity", "gpm2002", "The disc of an encoder sits off its axis", eccentric_disc("joint i").formula, "reading",
    ("enc_{i}",), "rad", _JOINTS, _eccentricity, resolved_by=LONGER_ARC,
).enter()  # fmt: skip
second_harmonic = EffectFamily(
    "second_harmonic", "gpm2002", "The disc of an encoder is oval, or tilted",
    oval_disc("joint i").formula, "reading", ("enc_{i}",), "rad", _JOINTS, _second, resolved_by=LONGER_ARC,
).enter()  # fmt: skip
angle_error = EffectFamily(
    "angle_error", "gpm2002", "The encoder of a joint errs smoothly over its turn; the order is not resolved",
    "enc_i += sum over k = 1, 2, 3 of a_k cos k enc_i + b_k sin k enc_i", "reading", ("enc_{i}",), "rad", _JOINTS,
    _unresolved, resolved_by=LONGER_ARC,
).enter()  # fmt: skip
cyclic = EffectFamily(
    "cyclic", "gpm2002", "The teeth of a gear: an error that repeats N times a turn, N as stated",
    "enc_i += sum over k = N, or N and 2 N, of a_k cos k enc_i + b_k sin k enc_i", "reading",
    ("enc_{i}", "metadata.tooth_numbers"), "rad", _JOINTS, _cyclic,
    label="cyclic error at the tooth count", period=_tooth,
).enter()  # fmt: skip
