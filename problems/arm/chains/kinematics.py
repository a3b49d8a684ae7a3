"""Forward kinematics of a chain, and its Jacobian in every parameter of a placement, by name.

    world -> base:  mount Trans(base_x, base_y, base_z) Rz(base_rz) Ry(base_ry) Rx(base_rx)
    joint J:        origin_J Trans(x_J, y_J, z_J) Rz(rz_J) Ry(ry_J) Rx(rx_J) motion(axis_J, gain_J (q_J + zero_J))
    tool:           tail tool Trans(tool_x, tool_y, tool_z) Rz(tool_rz) Ry(tool_ry) Rx(tool_rx)

All are errors: 0 for the nominal arm, and 1 for a gain. [mm, rad]. Many say the same thing twice (a turn of the
placement about the joint's own axis is its zero); which ones the observations determine is `gauge`'s to say.
A complex step passes through `forward` and `frames`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibench.core.options import suggest
from calibench.problems.arm.chains.chain import Chain, ChainError
from calibench.problems.arm.chains.rigid import Numbers, cross, rpy, slide, turn
from calibench.problems.base import Array

PLACEMENT = ("x", "y", "z", "rx", "ry", "rz")
UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")


def parameter_names(chain: Chain) -> tuple[str, ...]:
    """Return the names of all parameters of a chain, in the order of the vector: base, each joint, tool."""
    names = [f"base_{one}" for one in PLACEMENT]
    for joint in chain.joints:
        names += [f"{one}_{joint.name}" for one in (*PLACEMENT, "zero", "gain")]
    return (*names, *(f"tool_{one}" for one in PLACEMENT))


def parameter_units(chain: Chain) -> tuple[str, ...]:
    """Return the units of all parameters; that of a gain is empty."""
    units = list(UNITS)
    for joint in chain.joints:
        units += [*UNITS, "rad" if joint.kind == "rotary" else "mm", ""]
    return (*units, *UNITS)


def nominal(chain: Chain) -> Array:
    """Return the parameters of the arm as it is described: 0, and 1 for a gain."""
    values = np.zeros(12 + 8 * len(chain.joints))
    values[13:-6:8] = 1.0
    return values


def vector(chain: Chain, p: Mapping[str, Any] | Numbers) -> Numbers:
    """Return parameters as a vector in the order of `parameter_names`; what a mapping leaves out is nominal.

    Raises `ChainError` for a name that the chain does not have, or a vector of another length.
    """
    if not isinstance(p, Mapping):
        given, needed = np.asarray(p), (12 + 8 * len(chain.joints),)
        if given.shape != needed:
            raise ChainError(f"{chain.name}: {given.shape} parameters were given; {needed} are needed")
        return given
    names = parameter_names(chain)
    values = nominal(chain).astype(np.result_type(np.float64, *p.values()))
    index = {name: k for k, name in enumerate(names)}
    for name, value in p.items():
        if name not in index:
            raise ChainError(f"{chain.name}: {name!r} is no parameter of it; {suggest(name, names)}")
        values[index[name]] = value
    return values


def frames(chain: Chain, p: Mapping[str, Any] | Numbers, q: Numbers) -> Numbers:
    """Return frames in the world, (J + 2, n, 4, 4): of the base, of each joint after its motion, and of the target.

    `q`, (n, columns), are the readings of ``chain.driven`` [rad or mm].
    """
    values, q = vector(chain, p), np.atleast_2d(np.asarray(q))
    if q.shape[1] != len(chain.driven):
        raise ChainError(
            f"{chain.name}: q has {q.shape[1]} columns; one is needed for each of {', '.join(chain.driven)}"
        )
    own = values[6:-6].reshape(-1, 8)
    placed = _placed(np.concatenate([values[None, :6], own[:, :6], values[None, -6:]]))
    fixed = _origins(chain) @ placed[1:-1]
    moves = _moves(chain, own[:, 7, None] * (chain.positions(q).T + own[:, 6, None]))
    found = [np.broadcast_to(chain.mount @ placed[0], (len(q), 4, 4))]
    for step in fixed[:, None] @ moves:
        found.append(found[-1] @ step)
    return np.stack([*found, found[-1] @ (chain.tail @ chain.tool @ placed[-1])])


def forward(chain: Chain, p: Mapping[str, Any] | Numbers, q: Numbers) -> Numbers:
    """Return where the target is and how it is turned in the world, (n, 4, 4) [mm], at the readings q, (n, columns)."""
    poses: Numbers = frames(chain, p, q)[-1]
    return poses


def jacobian(chain: Chain, p: Mapping[str, Any] | Array, q: Array) -> Array:
    """Return the derivative of the target's pose in all parameters, (n, 6, P): a screw a parameter.

    Rows 0 to 2 are the shift of the target [mm], rows 3 to 5 its turn as a vector w [rad], both in the world: to first
    order the rotation R becomes (I + [w]x) R.
    """
    values, q = np.asarray(vector(chain, p), dtype=float), np.atleast_2d(np.asarray(q, dtype=float))
    every = frames(chain, values, q)
    target, own = every[-1][:, :3, 3], values[6:-6].reshape(-1, 8)
    before = np.concatenate([
        np.broadcast_to(chain.mount, (1, len(q), 4, 4)),
        every[:-2] @ _origins(chain)[:, None],
        every[-2:-1] @ (chain.tail @ chain.tool),
    ])  # fmt: skip
    screws = _placements(before, np.concatenate([values[None, :6], own[:, :6], values[None, -6:]]), target)
    moved = every[1:-1]  # a joint's own motion leaves its axis as it is
    axes = (moved[..., :3, :3] @ np.stack([joint.axis for joint in chain.joints])[:, None, :, None])[..., 0]
    rotary = np.array([joint.kind == "rotary" for joint in chain.joints])[:, None, None]
    rates = np.concatenate([
        np.where(rotary, cross(axes, target - moved[..., :3, 3]), axes), np.where(rotary, axes, 0.0)
    ], axis=-1)[..., None]  # fmt: skip
    stands = (chain.positions(q).T + own[:, 6, None])[..., None, None]
    joints = np.concatenate([screws[1:-1], own[:, 7, None, None, None] * rates, stands * rates], axis=-1)
    return np.concatenate([screws[0], *joints, screws[-1]], axis=-1)


def _origins(chain: Chain) -> Array:
    """Return where each joint stands behind the one before, (J, 4, 4)."""
    return np.stack([joint.origin for joint in chain.joints])


def _moves(chain: Chain, by: Numbers) -> Numbers:
    """Return the motions of the joints, (J, n, 4, 4), by angles and ways (J, n)."""
    axes = np.stack([joint.axis for joint in chain.joints])[:, None]
    moves = turn(axes, by)
    for k, joint in enumerate(chain.joints):
        if joint.kind != "rotary":
            moves[k] = slide(joint.axis, by[k])
    return moves


def _placed(own: Numbers) -> Numbers:
    """Return Trans(x, y, z) Rz(rz) Ry(ry) Rx(rx), (K, 4, 4), of x, y, z, rx, ry, rz, (K, 6)."""
    made = rpy(own[:, 3], own[:, 4], own[:, 5])
    made[:, :3, 3] = own[:, :3]
    return made


def _placements(before: Array, own: Array, target: Array) -> Array:
    """Return the screws, (K, n, 6, 6), of placements `own` (K, 6) behind the frames `before`, (K, n, 4, 4)."""
    turned = before[..., :3, :3]
    lever = target - ((turned @ own[:, None, :3, None])[..., 0] + before[..., :3, 3])
    cy, sy, cz, sz = np.cos(own[:, 4]), np.sin(own[:, 4]), np.cos(own[:, 5]), np.sin(own[:, 5])
    none, one = np.zeros(len(own)), np.ones(len(own))
    about = np.stack([cz * cy, sz * cy, -sy, -sz, cz, none, none, none, one], axis=-1).reshape(-1, 3, 3)
    w = np.swapaxes(about[:, None] @ np.swapaxes(turned, -1, -2), -1, -2)  # Rz Ry ex, Rz ey and ez, in columns
    shifts = np.swapaxes(cross(np.swapaxes(w, -1, -2), lever[..., None, :]), -1, -2)
    upper = np.concatenate([turned, shifts], axis=-1)
    return np.concatenate([upper, np.concatenate([np.zeros_like(turned), w], axis=-1)], axis=-2)
