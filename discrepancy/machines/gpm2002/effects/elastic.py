"""Deformation of a leg under load: its drive twists, its proximal link bends, its distal link stretches.

A twisting drive and a bending proximal link both leave the elbow behind the encoder by what the torque of the motor
winds up: exact twins. Coefficients are positive for what gives way: tau_i is the torque of the motor on its link,
axial_i is above zero in tension.
"""

from __future__ import annotations

from dataclasses import replace

from calibench.discrepancy.effects.general import joints, lengths
from calibench.discrepancy.effects.general.recipe import Built, Recipe
from calibench.discrepancy.machines.gpm2002.roles import JOINTS, LEGS, distal, joint_of
from calibench.discrepancy.model.family import EffectFamily, number
from calibench.discrepancy.model.machine import Formulation


def _of_leg(made: Recipe, part: str) -> Recipe:
    """Return a recipe whose target is a leg; the general recipe asks for the joint or the length of that leg."""

    def make(family: EffectFamily, formulation: Formulation, target: str) -> Built:
        own = joint_of(target) if part == "joint" else distal(target)
        built = made.make(family, formulation, own)
        assert isinstance(built, tuple)
        return tuple(replace(effect, target=target) for effect in built)  # type: ignore[type-var]

    return Recipe(made.words, make)


compliance = joints.compliance.enter(
    "gpm2002", JOINTS, lambda formulation, target: (f"proximal_bending leg {number(target)}",),
    cause="A drive twists under its torque", formula="enc_i -= kappa tau_i", columns=("tau_{i}",), unit="rad/(N mm)",
    twins="always: `proximal_bending leg i`",
)  # fmt: skip
bending = _of_leg(joints.compliance, "joint").enter(
    "gpm2002", LEGS, lambda formulation, target: (f"compliance joint {number(target)}",), name="proximal_bending",
    cause="A proximal link bends under the torque of its drive", formula="enc_i -= kappa tau_i", columns=("tau_{i}",),
    unit="rad/(N mm)", twins="always: `compliance joint i`",
)  # fmt: skip
stretch = _of_leg(lengths.stretch, "length").enter(
    "gpm2002", LEGS, cause="A distal link gives way to the force along it", formula="lb_i += k axial_i",
    columns=("axial_{i}",),
)  # fmt: skip
clearance = _of_leg(lengths.clearance, "length").enter(
    "gpm2002", LEGS, cause="The joints of a distal link have play along it",
    formula="lb_i += play / 2 * sign(axial_i)", columns=("axial_{i}",),
)  # fmt: skip
