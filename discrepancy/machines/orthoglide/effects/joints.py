"""What may be wrong with an Orthoglide's linear drives as they move and warm up: their scale, play, and their zeros."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.machines.orthoglide.effects.patterns import along
from calibench.discrepancy.machines.orthoglide.validate import rows_of
from calibench.discrepancy.model.effect import Along, Alternative, Effect, HeldBack
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, geometry

_TARGETS = ("axis x", "axis y", "axis z", "all")


def axes_in(target: str) -> tuple[int, ...]:
    """Return the numbers of the axes in a target: (1,) for `axis y` or `leg y`, (0, 1, 2) for `all`."""
    return (0, 1, 2) if target == "all" else (AXES.index(target[-1]),)


def _scale(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        rows = rows_of(data)
        return _joints(
            target, rows.joints(rows.level) - geometry().length, rows.joints(rows.against) - geometry().length
        )

    return (
        LinearEffect(
            "scale", target, scale.formula, "reading", (), ("kappa",), ("1",), "1", changes, along=_along(target)
        ),
    )


def _backlash(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        at_posture, at_zero = rows_of(data).senses()
        return _joints(target, -0.5 * at_posture, -0.5 * at_zero)

    return (
        LinearEffect(
            "backlash", target, backlash.formula, "reading", ("pass",), ("play",), ("mm",), "mm", changes,
            along=_along(target),
        ),
    )  # fmt: skip


def _thermal(formulation: Formulation, target: str) -> HeldBack:
    needs(formulation.data, "temp_K", "zero_temp_K")

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        now, then = (np.tile(np.asarray(data[name])[:, None], 3) for name in ("temp_K", "zero_temp_K"))
        return _joints(target, now, then)

    columns = ("temp_K", "zero_temp_K")
    effect = LinearEffect(
        "thermal_drives", target, thermal.formula, "base", columns, ("a",), ("mm/K",), "mm/K", changes
    )
    why = "leaves nearly the signature of thermal_legs: it is not looked for by itself, but held against what is named"
    return HeldBack(why, (Alternative(effect),))


def _along(target: str) -> Along:
    """Return the positions of the carriages in `target` that are used where the joints have errors, at both moments."""
    return along({name: name for i in axes_in(target) for name in (f"joint_{AXES[i]}", f"joint_{AXES[i]}_zero")})


def _joints(target: str, at_posture: Array, at_zero: Array) -> dict[str, Array]:
    """Return the changes of the joints in `target`, from changes of all three, shape (n, 3), at both moments."""
    changes = {f"joint_{AXES[i]}": at_posture[:, i : i + 1] for i in axes_in(target)}
    return changes | {f"joint_{AXES[i]}_zero": at_zero[:, i : i + 1] for i in axes_in(target)}


scale = EffectFamily(
    "scale", "orthoglide", "The scale of an encoder, or the pitch of a screw, is not the stated one",
    "joint i goes (1 + kappa) (rho_i - L) from Zero", "reading", (), "1", _TARGETS, _scale, label="encoder-scale error",
).enter()  # fmt: skip
backlash = EffectFamily(
    "backlash", "orthoglide", "A drive has play and trails on the side it came from",
    "joint i stands at rho_i - play / 2 * sign(last move of i)", "reading", ("pass",), "mm", _TARGETS, _backlash,
    "what every move ends with in the same sense is an offset of the joint: both passes are needed",
).enter()  # fmt: skip
thermal = EffectFamily(
    "thermal_drives", "orthoglide", "The zeros of the drives move as frame and screws warm up",
    "joint i stands at rho_i + a temp_K", "base", ("temp_K", "zero_temp_K"), "mm/K", _TARGETS, _thermal,
    "nearly, with moves along the leg only: `thermal_legs` with the opposite sign; at constant temperature: drho",
    label="thermal shift", label_of_all="thermal shift of all drives",
).enter()  # fmt: skip
