"""Errors of a joint that repeat: an eccentric disc, an oval one, teeth, a screw, balls of a bearing, a wave gear.

A rotary joint is taken to read absolute angles. A head at a fixed distance from the axis reads an eccentric disc with
the error arcsin(epsilon sin(reading + phase)), exactly, by the sine rule. An oval disc, or tracks of unequal gain, turn
tan(angle) into (1 + a) / (1 - a) tan(angle). All other errors are Fourier terms by definition.
A period that nobody states is fitted, as that of a `Cycle`. On a rotary joint only waves above the third order a turn
are tried; lower orders have names of their own, and so have those of a stated period and of stated teeth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np

from calibench.discrepancy.effects.general.columns import LONGEST, ORDINALS, scanned
from calibench.discrepancy.effects.general.joints import LONGER_ARC, largest_error, told_in, unstated
from calibench.discrepancy.effects.general.recipe import Built, each, named, of_joints
from calibench.discrepancy.model.effect import EffectFamily, LinearEffect, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import Joint, roles_of
from calibench.problems.base import Array

_RIM = 0.99  # a disc is not further off its axis than this part of its radius
NAMED_ORDERS = 3  # a turn: up to the third, a wave is an angle error


Exact = Callable[[Any, Array], tuple[Array, Array]]


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
    columns: tuple[str, ...]
    unit: str
    units: tuple[str, ...]
    exact: Exact
    radians: float = 1.0
    largest: float = np.inf
    one: float = 1.0
    channel: str = "reading"
    twins: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ("a", "b")
    positions: int = 1

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        error, _ = self.exact(q[self.reading] * self.radians, c * (self.one * self.radians))
        return {self.reading: error / self.radians}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        return {self.reading: self.one * self.exact(q[self.reading] * self.radians, c * (self.one * self.radians))[1]}

    def amplitude(self, c: Array) -> float:
        """Return the largest error: eccentricity over radius; half difference of the axes over their mean."""
        return float(np.hypot(c[0], c[1]))


def _off_axis(angle: Any, c: Array) -> tuple[Array, Array]:
    wave = _wave(angle, 1)
    sine = np.clip(wave @ c, -_RIM, _RIM)
    return np.arcsin(sine), wave / np.sqrt(1 - sine**2)[:, None]


def _oval(angle: Any, c: Array) -> tuple[Array, Array]:
    cos, sin = np.cos(2 * angle), np.sin(2 * angle)
    u, v = np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)  # for unit coefficients, each (n, 2)
    sine, rest = u @ c, 1 - v @ c
    return np.arctan2(sine, rest), (u * rest[:, None] + v * sine[:, None]) / (sine**2 + rest**2)[:, None]


def _exact(form: Exact, order: float, family: EffectFamily, formulation: Formulation, target: str) -> Built:
    """Return an error of the exact `form` of a disc, of a sliding joint its Fourier term."""
    [joint] = named(roles_of(formulation).joints, target)
    needs(formulation.data, joint.reading)
    turn = turn_of(joint, formulation)
    if joint.kind == "sliding":
        return fourier(family, formulation, joint, (order,))
    unit, one = told_in(joint)
    return ExactHarmonic(
        family.name, target, family.formula, reading=joint.reading, columns=(joint.reading,), unit=unit,
        units=(unit,) * 2, exact=form, radians=2 * np.pi / turn if joint.unit != "rad" else 1.0,
        largest=largest_error(joint) / one, one=one,
    )  # fmt: skip


def _unresolved(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    needs(formulation.data, joint.reading)
    return tuple(fourier(family, formulation, joint, orders) for orders in ((3.0,), (1.0, 2.0, 3.0)))


def _cyclic(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    needs(formulation.data, joint.reading)
    turn_of(joint, formulation)  # of a screw without a stated pitch, teeth alone say nothing
    if not joint.teeth > 0:
        raise unstated(joint, "number of teeth", "teeth", formulation)
    both = ((joint.teeth,), (joint.teeth, 2 * joint.teeth))
    return tuple(fourier(family, formulation, joint, orders) for orders in both)


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


_of_reading = partial(of_joints, columns=("the reading",))
eccentricity = _of_reading(
    "eccentricity", "The disc of an encoder sits off its axis",
    "reading_i += arcsin(a cos theta_i + b sin theta_i), theta_i = reading_i", targets="each rotary joint",
    targets_in=each("joints", "rotary"), make=partial(_exact, _off_axis, 1.0), resolved_by=LONGER_ARC,
)  # fmt: skip
screw_error = _of_reading(
    "screw_error", "A screw, or a scale, errs once a period",
    "reading_i += a cos theta_i + b sin theta_i, theta_i = 2 pi reading_i / period", targets="each sliding joint",
    targets_in=each("joints", "sliding"), make=partial(_exact, _off_axis, 1.0), resolved_by=LONGER_ARC,
    label="periodic screw error",
)  # fmt: skip
second_harmonic = _of_reading(
    "second_harmonic", "The disc of an encoder is oval, or tilted; a screw errs twice a turn",
    "reading_i += atan2(u, 1 - v), u = a cos 2 theta_i + b sin 2 theta_i, v = b cos 2 theta_i - a sin 2 theta_i; "
    "sliding: u", make=partial(_exact, _oval, 2.0), resolved_by=LONGER_ARC,
)  # fmt: skip
_THREE = "reading_i += sum over k = 1, 2, 3 of a_k cos k theta_i + b_k sin k theta_i"
angle_error = _of_reading(
    "angle_error", "The encoder of a joint errs smoothly over its turn; the order is not resolved", _THREE,
    targets="each rotary joint", targets_in=each("joints", "rotary"), make=_unresolved, resolved_by=LONGER_ARC,
)  # fmt: skip
position_error = _of_reading(
    "position_error", "A scale or a screw errs smoothly over its period; the order is not resolved",
    f"{_THREE}, theta_i = 2 pi reading_i / period", targets="each sliding joint",
    targets_in=each("joints", "sliding"), make=_unresolved, resolved_by=LONGER_ARC,
)  # fmt: skip
cyclic = of_joints(
    "cyclic", "The teeth of a gear: an error that repeats N times a turn, N as stated",
    "reading_i += sum over k = N, or N and 2 N, of a_k cos k theta_i + b_k sin k theta_i",
    columns=("the reading", "the number of teeth"), make=_cyclic, label="cyclic error at the tooth count",
)  # fmt: skip


_FINEST = 64.0  # waves a turn: finer ones are teeth, whose number is known


def _waves(k: int, family: EffectFamily, formulation: Formulation, target: str) -> Built:
    """Return the k-th wave of a joint, which is tried once the one before it is found."""
    [joint] = named(roles_of(formulation).joints, target)
    needs(formulation.data, joint.reading)
    longest, shortest = LONGEST * float(np.ptp(formulation.data[joint.reading])), 0.0
    # frequencies whose waves have names of their own, in waves per unit of the reading
    others = [order / joint.period for order in range(1, NAMED_ORDERS + 1)] if joint.period else []
    if joint.kind == "rotary":
        turn = turn_of(joint, formulation)
        longest, shortest = min(longest, turn / NAMED_ORDERS), turn / _FINEST
        others = [order * joint.teeth / turn for order in (1, 2)] if joint.teeth else []
    unit, one = told_in(joint)
    found = scanned(
        family, formulation.data, target, (joint.reading, joint.reading), ("reading", unit), factor=one,
        after=f"{PERIODIC[k - 1]} {target}" if k else "", longest=longest, shortest=shortest,
        largest=largest_error(joint) / one, period_unit=joint.unit,
    )  # fmt: skip
    found = tuple(wave for wave in found if all(abs(1 / wave.start - f) * wave.reach >= 1 for f in others))
    if not found:
        raise NotTestable(f"too few readings of {joint.name} differ for a wave to be seen")
    return found


PERIODIC = tuple(f"{words}periodic_error".replace(" ", "_") for words in ORDINALS)
WAVES = tuple(
    _of_reading(
        PERIODIC[k], f"A joint errs {f'in a {words}' if words else 'with a '}period that nobody knows",
        "reading_i += a cos(2 pi reading_i / P) + b sin(2 pi reading_i / P), P fitted",
        targets="each joint; periods that are stated have names of their own", make=partial(_waves, k),
    )
    for k, words in enumerate(ORDINALS)
)  # fmt: skip
