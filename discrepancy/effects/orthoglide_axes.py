"""What may be wrong with an Orthoglide's drives as they stand: not square to each other, not through one point.

The chapter's assumption (iv). The legs are read where they move along themselves, so a turn of the whole machine is
seen in moves across the legs only, and a shift of all axes that meet again is an offset of the joints.
"""

from __future__ import annotations

from discrepancy.effects.orthoglide_patterns import (
    COMMON,
    CYCLIC,
    MIRRORED,
    PAIRS,
    every,
    member,
    single,
    spread,
)
from discrepancy.family import Cause

_AXES = member("axis", "x") | member("axis", "y") | member("axis", "z")
_SQUARE = (
    _AXES
    | {f"pair {ij}": ({ij: 0.5, ij[::-1]: 0.5},) for ij in PAIRS}
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
    | single("common", COMMON)
    | every()
)
_THROUGH = (
    _AXES
    | {f"pair {i}{j}": ({i + k: 0.5, j + k: -0.5},) for i, j, k in ("xyz", "yzx", "xzy")}
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
)
_ONE_POINT = {"cyclic": ("axis_intersection mirrored",), "mirrored": ("axis_intersection cyclic",)}
_LEAN = "axis i runs along e_i + tau_ij e_j + tau_ik e_k; pair ij: tau_ij = tau_ji = tau / 2"
_SHIFT = "joint i stands at d_ij e_j + d_ik e_k + rho_i u_i; pair ij: the axes pass each other at d along k"

orthogonality = Cause(
    "axis_orthogonality", "orthoglide", "The axes of the drives are not square to each other", _LEAN, "base", (), "rad",
    tuple(_SQUARE), spread("axis_orthogonality", _LEAN, "base", "tilt", "rad", _SQUARE, {}),
    "with moves along the leg only: an axis's lean towards another and that one's towards it; cyclic, mirrored, common",
).enter()  # fmt: skip
intersection = Cause(
    "axis_intersection", "orthoglide", "The axes of the drives do not meet in one point", _SHIFT, "base", (), "mm",
    tuple(_THROUGH), spread("axis_intersection", _SHIFT, "base", "offset", "mm", _THROUGH, _ONE_POINT),
    "always: cyclic and mirrored; what all axes share is an offset of the joints",
).enter()  # fmt: skip
