"""Deformation of a leg under load: its drive twists, its proximal link bends, its distal link stretches.

A twisting drive and a bending proximal link both leave the elbow behind the encoder by what the torque of the motor
winds up: exact twins. Coefficients are positive for what gives way: tau_i is the torque of the motor on its link,
axial_i is above zero in tension.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.effect import Effect, NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array

_JOINTS = ("joint 1", "joint 2", "joint 3")
_LEGS = ("leg 1", "leg 2", "leg 3")


def _compliance(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    return (_turn(formulation, "compliance", target, compliance.formula, f"proximal_bending leg {number(target)}"),)


def _bending(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    return (_turn(formulation, "proximal_bending", target, bending.formula, f"compliance joint {number(target)}"),)


def _turn(formulation: Formulation, family: str, target: str, formula: str, twin: str) -> LinearEffect:
    i = number(target)
    torque = f"tau_{i}"
    needs(formulation.data, torque)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {f"enc_{i}": -data[torque][:, None]}

    unit = "rad/(N mm)"
    return LinearEffect(family, target, formula, "reading", (torque,), ("kappa",), (unit,), unit, changes, (twin,))


def _stretch(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    i = number(target)
    force = f"axial_{i}"
    needs(formulation.data, force)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {f"lb{i}": data[force][:, None]}

    unit = "mm/N"
    return (
        LinearEffect("axial_compliance", target, stretch.formula, "link", (force,), ("k",), (unit,), unit, changes),
    )


def _clearance(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    i = number(target)
    force = f"axial_{i}"
    needs(formulation.data, force)
    if not np.ptp(np.sign(formulation.data[force])) > 0:
        raise NotTestable(f"column {force} never changes its sign", (force,))

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {f"lb{i}": 0.5 * np.sign(data[force])[:, None]}

    return (LinearEffect("clearance", target, clearance.formula, "link", (force,), ("play",), ("mm",), "mm", changes),)


compliance = EffectFamily(
    "compliance", "gpm2002", "A drive twists under its torque", "enc_i -= kappa tau_i", "reading", ("tau_{i}",),
    "rad/(N mm)", _JOINTS, _compliance, "always: `proximal_bending leg i`",
).enter()  # fmt: skip
bending = EffectFamily(
    "proximal_bending", "gpm2002", "A proximal link bends under the torque of its drive", "enc_i -= kappa tau_i",
    "reading", ("tau_{i}",), "rad/(N mm)", _LEGS, _bending, "always: `compliance joint i`",
).enter()  # fmt: skip
stretch = EffectFamily(
    "axial_compliance", "gpm2002", "A distal link gives way to the force along it", "lb_i += k axial_i", "link",
    ("axial_{i}",), "mm/N", _LEGS, _stretch,
).enter()  # fmt: skip
clearance = EffectFamily(
    "clearance", "gpm2002", "The joints of a distal link have play along it", "lb_i += play / 2 * sign(axial_i)",
    "link", ("axial_{i}",), "mm", _LEGS, _clearance,
).enter()  # fmt: skip
