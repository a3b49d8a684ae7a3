"""Errors of any driven joint: its scale, play, compliance of its drive, late readings, its zero.

Coefficients are in the unit of the joint's reading, or in the unit in which its errors are reported (`Joint.told`). The
scale is about the reading zero; a scale about any other reading is the same with another zero.
"""

from functools import partial

import numpy as np

from calibench.core.tables.cells import between
from calibench.discrepancy.effects.general.lengths import reference_of, time_constants, warmth
from calibench.discrepancy.effects.general.recipe import Built, declared, each, named, of_joints
from calibench.discrepancy.labels import quantity_of
from calibench.discrepancy.model.effect import Effect, EffectFamily, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import Joint, roles_of
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

LONGER_ARC = "readings over a longer range of {target}"  # the measurement that separates smooth errors of one encoder


def largest_error(joint: Joint) -> float:
    """Return the error in the unit of a joint beyond which its sensor would have been replaced."""
    return thresholds().largest_angle if joint.unit == "rad" else np.inf


def largest_slope(joint: Joint, column: Array, one: float) -> float:
    """Return the coefficient of a column, (n,), at which the error of the joint is as large as errors may be."""
    furthest = float(np.max(np.abs(np.nan_to_num(np.asarray(column, dtype=float))), initial=0.0))
    return largest_error(joint) / one / furthest if furthest > 0 else np.inf


def told_in(joint: Joint) -> tuple[str, float]:
    """Return the unit in which errors of a joint are reported, and one of it in the unit of its reading."""
    return (joint.told, between(joint.reading, joint.told, joint.unit)) if joint.told else (joint.unit, 1.0)


def unstated(joint: Joint, what: str, option: str, formulation: Formulation, unit: str = "") -> NotTestable:
    """Return the error for a number of a joint that nobody states; its message names the way to state it."""
    stated = description_of(formulation.data.machine).stated
    way, of_unit = "", f", in {unit}" if unit else ""
    if stated is None:  # a machine of its owner's design
        way = f": Joint({option}=...){of_unit}"
    elif option in [one.key for one in stated]:
        way = f"; {option}= states it"
    return NotTestable(f"nobody states the {what} of {joint.name}{way}", (), missing=True)


def _scale(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    needs(formulation.data, joint.reading)
    return family.linear(
        target, (joint.reading,), {"k": "1"}, lambda q, data: {joint.reading: np.asarray(q[joint.reading])[:, None]},
        largest=thresholds().largest_scale,
    )  # fmt: skip


def _backlash(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    direction = declared(joint.direction, joint.name, "direction")
    needs(formulation.data, direction)
    unit, one = told_in(joint)

    def changes(count: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        came = np.asarray(data[direction], dtype=float)
        columns = [-0.5 * came, np.where(came == 0, 1.0, 0.0)]
        return {joint.reading: one * np.stack(columns[:count], axis=-1)}

    most = thresholds().largest_play if joint.unit == "rad" else np.inf  # a slide may have any
    still = int((np.asarray(formulation.data[direction]) == 0).sum())  # rows whose side of the play is not known
    return tuple(
        family.linear(
            target, (direction,), dict.fromkeys(("play", "before its first move")[:k], unit), partial(changes, k),
            largest=most / one, measure=lambda c: float(c[0]),
        )
        for k in ((1, 2) if still > 1 else (1,))
    )  # fmt: skip


def _compliance(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    torque = declared(joint.torque, joint.name, "torque" if joint.kind == "rotary" else "force")
    run = formulation.data
    needs(run, torque)
    name, one = told_in(joint)
    largest = np.inf
    if joint.unit == "rad":  # how far the drive winds up under its load; and the compliance of any, in N mm
        most = float(np.max(np.abs(np.nan_to_num(np.asarray(run[torque], dtype=float))), initial=0.0))
        wound = thresholds().largest_windup / most if most > 0 else np.inf
        unit = run.units.get(torque) or quantity_of(run.machine, torque).unit
        largest = min(wound, thresholds().softest_drive if unit == "N mm" else np.inf) / one
    return family.linear(
        target, (torque,), {"kappa": f"{name}/{'(N mm)' if joint.kind == 'rotary' else 'N'}"},
        lambda q, data: {joint.reading: -one * data[torque][:, None]}, largest=largest,
    )  # fmt: skip


def _lag(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    joints = named(roles_of(formulation).joints, target)
    columns = tuple(declared(joint.velocity, joint.name, "velocity") for joint in joints)
    needs(formulation.data, *columns)
    most = min(largest_slope(joint, formulation.data[joint.velocity], 1.0) for joint in joints)
    return family.linear(
        target, columns, {"tau": "s"},
        lambda q, data: {joint.reading: data[joint.velocity][:, None] for joint in joints},
        largest=min(most, thresholds().largest_lag),
    )  # fmt: skip


def _zero(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    roles, run = roles_of(formulation), formulation.data
    column = declared(joint.temperature or roles.temperature, joint.name, "temperature")
    needs(run, column)
    name, one = told_in(joint)
    zero_at = reference_of(formulation, column, joint.reading)

    def changes(late: float, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {joint.reading: one * (warmth(data, late, column, roles.time, run) - zero_at)[:, None]}

    per_kelvin = thresholds().largest_warm_zero if joint.unit == "rad" else np.inf  # a slide may move any way
    forms: list[Effect] = []
    for late in time_constants(run, roles.time):
        steepest = largest_slope(joint, warmth(run, late, column, roles.time, run) - zero_at, one)
        most = min(steepest, per_kelvin / one)
        forms.append(family.linear(target, (column,), {"a": f"{name}/K"}, partial(changes, late), largest=most))
    return tuple(forms)


scale = of_joints(
    "gear", "A gear ratio, the pitch of a screw, or the scale of an encoder is not the stated one",
    "reading_i += k reading_i", columns=("the reading",), unit="1", make=_scale, label="scale error",
    resolved_by=LONGER_ARC, bounds=("largest_scale",),
)  # fmt: skip
backlash = of_joints(
    "backlash", "A drive has play", "reading_i -= play / 2 * direction_i", columns=("the direction",), make=_backlash,
    never_negative="play", bounds=("largest_play",),
)  # fmt: skip
compliance = of_joints(
    "compliance", "A drive gives way to its torque, or its force", "reading_i -= kappa torque_i",
    columns=("the torque",), unit="that of the joint by N mm, or by N", make=_compliance, never_negative="compliance",
    bounds=("softest_drive", "largest_windup"),
)  # fmt: skip
lag = of_joints(
    "lag", "A joint, or all of them, are read too early or too late", "reading_i += tau velocity_i",
    columns=("the velocity",), unit="s", targets="each joint, all", targets_in=each("joints", and_all=True), make=_lag,
    label="timing lag", label_of_all="timing lag of all joints", bounds=("largest_lag", "largest_angle"),
)  # fmt: skip
zero = of_joints(
    "thermal_zero", "The zero of a joint moves with temperature", "reading_i += a T, T follows the temperature",
    columns=("the temperature",), unit="that of the joint by K", make=_zero, label="thermal shift of the zero",
    bounds=("largest_warm_zero", "largest_angle"),
)  # fmt: skip
