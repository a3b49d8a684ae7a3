"""What may be wrong with an Orthoglide's linear drives as they move: their scale, and play."""

from __future__ import annotations

from discrepancy.data import MeasuredData
from discrepancy.effect import Effect
from discrepancy.family import Cause
from discrepancy.linear import Linear
from discrepancy.machine import Formulation, Quantities
from discrepancy.machines.orthoglide_table import rows_of
from problems.base import Array
from problems.orthoglide_kinematics import AXES, geometry

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

    return (Linear("scale", target, scale.formula, "reading", (), ("kappa",), ("1",), "1", changes),)


def _backlash(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        at_posture, at_zero = rows_of(data).senses()
        return _joints(target, -0.5 * at_posture, -0.5 * at_zero)

    return (Linear("backlash", target, backlash.formula, "reading", ("pass",), ("play",), ("mm",), "mm", changes),)


def _joints(target: str, at_posture: Array, at_zero: Array) -> dict[str, Array]:
    """Return the changes of the joints in `target`, from changes of all three, shape (n, 3), at both moments."""
    changes = {f"joint_{AXES[i]}": at_posture[:, i : i + 1] for i in axes_in(target)}
    return changes | {f"joint_{AXES[i]}_zero": at_zero[:, i : i + 1] for i in axes_in(target)}


scale = Cause(
    "scale", "orthoglide", "The scale of an encoder, or the pitch of a screw, is not the stated one",
    "joint i goes (1 + kappa) (rho_i - L) from Zero", "reading", (), "1", _TARGETS, _scale,
).enter()  # fmt: skip
backlash = Cause(
    "backlash", "orthoglide", "A drive has play and trails on the side it came from",
    "joint i stands at rho_i - play / 2 * sign(last move of i)", "reading", ("pass",), "mm", _TARGETS, _backlash,
    "what every move ends with in the same sense is an offset of the joint: both passes are needed",
).enter()  # fmt: skip
