"""Errors of a joint that repeat with an unknown period: a screw, teeth, balls of a bearing, a wave gear.

The period is fitted, as that of a `Cycle`. On a rotary joint only waves above the third order a turn are tried. Lower
orders have names of their own, and so have the orders of a stated period and of stated teeth: a screw of known pitch
may still have a coupling, a belt, or a scale with another error. Waves of a joint come one after another: the second is
tried once the first is found.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.effects.general.columns import LONGEST, scanned
from calibench.discrepancy.effects.general.harmonics import NAMED_ORDERS, turn_of
from calibench.discrepancy.effects.general.joints import largest_error, told_in
from calibench.discrepancy.effects.general.recipe import Built, Make, Recipe, joints_of, recipe
from calibench.discrepancy.model.effect import NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import Joint, roles_of

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


def _wave(k: int) -> Recipe:
    words = _ORDINALS[k]
    return recipe(
        _family(k), f"A joint errs {f'in a {words}' if words else 'with a '}period that nobody knows",
        "reading_i += a cos(2 pi reading_i / P) + b sin(2 pi reading_i / P), P fitted", "reading", ("the reading",),
        "that of the joint", "each joint; periods that are stated have names of their own",
        _joints, _of(_family(k - 1) if k else ""),
    )  # fmt: skip


def _family(k: int) -> str:
    return (_ORDINALS[k] + _NAME).replace(" ", "_")


WAVES = tuple(_wave(k) for k in range(len(_ORDINALS)))
PERIODIC = tuple(_family(k) for k in range(len(_ORDINALS)))
