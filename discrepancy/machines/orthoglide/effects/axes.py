"""What may be wrong with an Orthoglide's drives as they stand: not square to each other, not through one point.

The chapter's assumption (iv). An axis that leans is taken to lean about the point where all should meet
(axis_orthogonality), or about the middle of its guide (guide_lean), where it passes that point by as well. The legs
are read where they move along themselves, so a turn of the whole machine is seen in moves across the legs only, and a
shift of all axes that meet again is an offset of the joints.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.machines.orthoglide.effects.patterns import (
    COMMON,
    CYCLIC,
    MIRRORED,
    PAIRS,
    along,
    at_both,
    every,
    member,
    single,
    spread,
)
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import geometry

_AXES = member("axis", "x") | member("axis", "y") | member("axis", "z")
_SQUARE = (
    _AXES
    | {f"pair {ij}": ({ij: 0.5, ij[::-1]: 0.5},) for ij in PAIRS}
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
    | single("common", COMMON)
    | every()
)
_PASSING = {f"pair {i}{j}": ({i + k: 0.5, j + k: -0.5},) for i, j, k in ("xyz", "yzx", "xzy")}
_THROUGH = (
    _AXES
    | _PASSING
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
    | {"all": tuple(weights for pair in _PASSING.values() for weights in pair)}
)
_ONE_POINT = {"cyclic": ("axis_intersection mirrored",), "mirrored": ("axis_intersection cyclic",)}
_LEAN = "axis i runs along e_i + tau_ij e_j + tau_ik e_k; pair ij: tau_ij = tau_ji = tau / 2"
_SHIFT = "joint i stands at d_ij e_j + d_ik e_k + rho_i u_i; pair ij: the axes pass each other at d along k"

_GUIDES = _AXES | single("cyclic", CYCLIC) | single("mirrored", MIRRORED)


def _guide(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    (lean,) = _tilt(formulation, target)
    middle = geometry().length + (geometry().stroke_plus + geometry().stroke_minus) / 2

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        tilts = lean.basis(q, data, np.zeros(len(lean.coefficients)))
        return tilts | {name.replace("tilt", "offset"): -middle * tilt for name, tilt in tilts.items()}

    names, units = lean.coefficients, lean.units
    most = lean.largest
    kinds = [f"{kind}_{ij}" for kind in ("tilt", "offset") for weights in _GUIDES[target] for ij in weights]
    return (
        LinearEffect(
            "guide_lean", target, guide.formula, "base", (), names, units, "rad", changes, largest=most,
            along=along(at_both(kinds)),
        ),
    )  # fmt: skip


_tilt = spread("axis_orthogonality", _LEAN, "base", "tilt", "rad", _GUIDES, {})
guide = EffectFamily(
    "guide_lean", "orthoglide", "A guide leans about its own middle",
    "joint i stands at (rho_i - m) (tau_ij e_j + tau_ik e_k) beside its axis, m the middle of the stroke", "base", (),
    "rad", tuple(_GUIDES), _guide,
    "nearly, with moves along the leg only: `axis_intersection`, as the axis passes the common point by",
).enter()  # fmt: skip
orthogonality = EffectFamily(
    "axis_orthogonality", "orthoglide", "The axes of the drives are not square to each other", _LEAN, "base", (), "rad",
    tuple(_SQUARE), spread("axis_orthogonality", _LEAN, "base", "tilt", "rad", _SQUARE, {}),
    "with moves along the leg only: an axis's lean towards another and that one's towards it; cyclic, mirrored, common",
).enter()  # fmt: skip
intersection = EffectFamily(
    "axis_intersection", "orthoglide", "The axes of the drives do not meet in one point", _SHIFT, "base", (), "mm",
    tuple(_THROUGH), spread("axis_intersection", _SHIFT, "base", "offset", "mm", _THROUGH, _ONE_POINT),
    "always: cyclic and mirrored; what all axes share is an offset of the joints",
).enter()  # fmt: skip
