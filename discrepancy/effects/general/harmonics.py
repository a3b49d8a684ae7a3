"""Errors of a joint that repeat with its turn: an eccentric disc, an oval one, teeth; and the class that they share.

A rotary joint is taken to read absolute angles. A head at a fixed distance from the axis reads an eccentric disc with
the error arcsin(epsilon sin(reading + phase)), exactly, by the sine rule. An oval disc, or tracks of unequal gain, turn
tan(angle) into (1 + a) / (1 - a) tan(angle). All other errors are Fourier terms by definition; over the stated period
of a sliding joint, all are.

Errors of a joint that repeat with an unknown period: a screw, teeth, balls of a bearing, a wave gear.

The period is fitted, as that of a `Cycle`. On a rotary joint only waves above the third order a turn are tried. Lower
orders have names of their own, and so have the orders of a stated period and of stated teeth: a screw of known pitch
may still have a coupling, a belt, or a scale with another error. Waves of a joint come one after another: the second is
tried once the first is found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np

from calibench.discrepancy.effects.general.columns import LONGEST, scanned
from calibench.discrepancy.effects.general.joints import LONGER_ARC, largest_error, told_in, unstated
from calibench.discrepancy.effects.general.recipe import Built, Make, Recipe, each_joint, joints_of, recipe
from calibench.discrepancy.model.effect import EffectFamily, LinearEffect, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import Joint, roles_of
from calibench.problems.base import Array

_RIM = 0.99  # a disc is not further off its axis than this part of its radius
NAMED_ORDERS = 3  # a turn: up to the third, a wave is an angle error


@final
@dataclass(frozen=True, eq=False)
class ExactHarmonic:
    """An error of the reading of one rotary joint with two coefficients, in the exact form of its cause.

    `exact(angle, c)` returns the error, (n,), rad, and its derivative, (n, 2); to first order it is one Fourier term.
    `radians` are the radians in a unit of the reading, `one` is one of `unit` in the unit of the reading.
    """

    family: str
    target: str
    formula: str
    reading: str
    unit: str
    exact: Callable[[Any, Array], tuple[Array, Array]]
    radians: float = 1.0
    largest: float = np.inf
    one: float = 1.0
    channel: str = "reading"
    twins: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ("a", "b")
    positions: int = 1

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the reading."""
        return (self.reading,)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each coefficient."""
        return (self.unit,) * 2

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the error of the reading, (n,)."""
        return {self.reading: self._exact(q, c)[0] / self.radians}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return its derivative, (n, 2)."""
        return {self.reading: self.one * self._exact(q, c)[1]}

    def amplitude(self, c: Array) -> float:
        """Return the largest error: eccentricity over radius; half difference of the axes over their mean."""
        return float(np.hypot(c[0], c[1]))

    def _exact(self, q: Quantities, c: Array) -> tuple[Array, Array]:
        return self.exact(q[self.reading] * self.radians, c * (self.one * self.radians))


def _off_axis(angle: Any, c: Array) -> tuple[Array, Array]:
    wave = _wave(angle, 1)
    sine = np.clip(wave @ c, -_RIM, _RIM)
    return np.arcsin(sine), wave / np.sqrt(1 - sine**2)[:, None]


def _oval(angle: Any, c: Array) -> tuple[Array, Array]:
    cos, sin = np.cos(2 * angle), np.sin(2 * angle)
    u, v = np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)  # for unit coefficients, each (n, 2)
    sine, rest = u @ c, 1 - v @ c
    return np.arctan2(sine, rest), (u * rest[:, None] + v * sine[:, None]) / (sine**2 + rest**2)[:, None]


def _eccentricity(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    return _exact(family, formulation, target, _off_axis, 1.0)


def _second(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    return _exact(family, formulation, target, _oval, 2.0)


def _exact(
    family: EffectFamily, formulation: Formulation, target: str,
    form: Callable[[Any, Array], tuple[Array, Array]], order: float,
) -> Built:  # fmt: skip
    [joint] = joints_of(formulation, target)
    needs(formulation.data, joint.reading)
    turn = turn_of(joint, formulation)
    if joint.kind == "sliding":
        return (fourier(family, formulation, joint, (order,)),)
    radians, most = 2 * np.pi / turn if joint.unit != "rad" else 1.0, largest_error(joint)
    unit, one = told_in(joint)
    return (
        ExactHarmonic(
            family.name,
            target,
            family.formula,
            reading=joint.reading,
            unit=unit,
            exact=form,
            radians=radians,
            largest=most / one,
            one=one,
        ),
    )


def _unresolved(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = joints_of(formulation, target)
    needs(formulation.data, joint.reading)
    return tuple(fourier(family, formulation, joint, orders) for orders in ((3.0,), (1.0, 2.0, 3.0)))


def _cyclic(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = joints_of(formulation, target)
    needs(formulation.data, joint.reading)
    turn_of(joint, formulation)  # of a screw without a stated pitch, teeth alone say nothing
    if not joint.teeth > 0:
        raise unstated(joint, "number of teeth", "teeth", formulation)
    each = ((joint.teeth,), (joint.teeth, 2 * joint.teeth))
    return tuple(fourier(family, formulation, joint, orders) for orders in each)


def fourier(family: EffectFamily, formulation: Formulation, joint: Joint, orders: tuple[float, ...]) -> LinearEffect:
    """Return Fourier terms of `orders` a turn, or a stated period, in the reading of one joint."""
    names = tuple(f"{letter}{order:g}" for order in orders for letter in "ab")
    turn = turn_of(joint, formulation)
    radians = 1.0 if joint.unit == "rad" else 2 * np.pi / turn
    unit, one = told_in(joint)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        angle = q[joint.reading] if radians == 1.0 else np.asarray(q[joint.reading]) * radians
        return {joint.reading: one * np.concatenate([_wave(angle, order) for order in orders], axis=-1)}

    return family.linear(
        joint.name, (joint.reading,), dict.fromkeys(names, unit), changes, largest=largest_error(joint) / one
    )


def turn_of(joint: Joint, formulation: Formulation) -> float:
    """Return the length after which a joint repeats, in its unit; `NotTestable` where nobody says."""
    known = {"rad": 2 * np.pi, "deg": 360.0} if joint.kind == "rotary" else {}
    turn = known.get(joint.unit, joint.period)
    if not turn:
        raise unstated(joint, "period", "period", formulation, joint.unit)
    return turn


def _wave(angle: Any, order: float) -> Array:
    return np.stack([np.cos(order * angle), np.sin(order * angle)], axis=-1)


def _each(kind: str, formulation: Formulation) -> tuple[str, ...]:
    return tuple(joint.name for joint in roles_of(formulation).joints if joint.kind == kind)


eccentricity = recipe(
    "eccentricity", "The disc of an encoder sits off its axis",
    "reading_i += arcsin(a cos theta_i + b sin theta_i), theta_i = reading_i", channel="reading",
    columns=("the reading",), unit="that of the joint", targets="each rotary joint",
    targets_in=partial(_each, "rotary"), make=_eccentricity, resolved_by=LONGER_ARC,
)  # fmt: skip
screw_error = recipe(
    "screw_error", "A screw, or a scale, errs once a period",
    "reading_i += a cos theta_i + b sin theta_i, theta_i = 2 pi reading_i / period", channel="reading",
    columns=("the reading",), unit="that of the joint", targets="each sliding joint",
    targets_in=partial(_each, "sliding"), make=_eccentricity, resolved_by=LONGER_ARC, label="periodic screw error",
)  # fmt: skip
second_harmonic = recipe(
    "second_harmonic", "The disc of an encoder is oval, or tilted; a screw errs twice a turn",
    ("reading_i += atan2(u, 1 - v), u = a cos 2 theta_i + b sin 2 theta_i, v = b cos 2 theta_i - a sin 2 theta_i; "
        "sliding: u"), channel="reading", columns=("the reading",), unit="that of the joint", targets="each joint",
    targets_in=each_joint, make=_second, resolved_by=LONGER_ARC,
)  # fmt: skip
angle_error = recipe(
    "angle_error", "The encoder of a joint errs smoothly over its turn; the order is not resolved",
    "reading_i += sum over k = 1, 2, 3 of a_k cos k theta_i + b_k sin k theta_i", channel="reading",
    columns=("the reading",), unit="that of the joint", targets="each rotary joint",
    targets_in=partial(_each, "rotary"), make=_unresolved, resolved_by=LONGER_ARC,
)  # fmt: skip
position_error = recipe(
    "position_error", "A scale or a screw errs smoothly over its period; the order is not resolved",
    "reading_i += sum over k = 1, 2, 3 of a_k cos k theta_i + b_k sin k theta_i, theta_i = 2 pi reading_i / period",
    channel="reading", columns=("the reading",), unit="that of the joint", targets="each sliding joint",
    targets_in=partial(_each, "sliding"), make=_unresolved, resolved_by=LONGER_ARC,
)  # fmt: skip
cyclic = recipe(
    "cyclic", "The teeth of a gear: an error that repeats N times a turn, N as stated",
    "reading_i += sum over k = N, or N and 2 N, of a_k cos k theta_i + b_k sin k theta_i", channel="reading",
    columns=("the reading", "the number of teeth"), unit="that of the joint", targets="each joint",
    targets_in=each_joint, make=_cyclic, label="cyclic error at the tooth count",
)  # fmt: skip


_NAME = "periodic_error"
_FINEST = 64.0  # waves a turn: finer ones are teeth, whose number is known
_ORDINALS = ("", "second ", "third ", "fourth ")


def _joints(formulation: Formulation) -> tuple[str, ...]:
    return tuple(joint.name for joint in roles_of(formulation).joints)


def _named(joint: Joint, formulation: Formulation) -> tuple[float, ...]:
    """Return the frequencies of a joint whose waves have names of their own, in waves per unit of its reading."""
    if joint.kind == "sliding":
        return tuple(k / joint.period for k in range(1, NAMED_ORDERS + 1)) if joint.period else ()
    return tuple(k * joint.teeth / turn_of(joint, formulation) for k in (1, 2)) if joint.teeth else ()


def _of(after: str) -> Make:
    """Return the function that builds the waves of a joint.

    They are tried once the family `after` is found for the joint, or at once if `after` is "".
    """

    def build(family: EffectFamily, formulation: Formulation, target: str) -> Built:
        [joint] = joints_of(formulation, target)
        needs(formulation.data, joint.reading)
        longest = LONGEST * float(np.ptp(formulation.data[joint.reading]))
        shortest = 0.0
        if joint.kind == "rotary":
            turn = turn_of(joint, formulation)
            longest, shortest = min(longest, turn / NAMED_ORDERS), turn / _FINEST
        unit, one = told_in(joint)
        found = scanned(
            family, formulation.data, target, (joint.reading, joint.reading), ("reading", unit), factor=one,
            after=f"{after} {target}" if after else "", longest=longest, shortest=shortest,
            largest=largest_error(joint) / one, period_unit=joint.unit,
        )  # fmt: skip
        named = _named(joint, formulation)
        found = tuple(wave for wave in found if all(abs(1 / wave.start - f) * wave.span >= 1 for f in named))
        if not found:
            raise NotTestable(f"too few readings of {joint.name} differ for a wave to be seen")
        return found

    return build


def _wave_recipe(k: int) -> Recipe:
    words = _ORDINALS[k]
    return recipe(
        _family(k), f"A joint errs {f'in a {words}' if words else 'with a '}period that nobody knows",
        "reading_i += a cos(2 pi reading_i / P) + b sin(2 pi reading_i / P), P fitted", channel="reading",
        columns=("the reading",), unit="that of the joint",
        targets="each joint; periods that are stated have names of their own", targets_in=_joints,
        make=_of(_family(k - 1) if k else ""),
    )  # fmt: skip


def _family(k: int) -> str:
    return (_ORDINALS[k] + _NAME).replace(" ", "_")


WAVES = tuple(_wave_recipe(k) for k in range(len(_ORDINALS)))
PERIODIC = tuple(_family(k) for k in range(len(_ORDINALS)))
