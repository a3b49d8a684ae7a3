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
from calibench.problems.arm.chains.rigid import Numbers, rpy, shift, slide, turn
from calibench.problems.base import Array

PLACEMENT = ("x", "y", "z", "rx", "ry", "rz")
UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
_X, _Y, _Z = np.eye(3)


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
    names = parameter_names(chain)
    if not isinstance(p, Mapping):
        given = np.asarray(p)
        if given.shape != (len(names),):
            raise ChainError(f"{chain.name}: {given.shape} parameters were given; ({len(names)},) are needed")
        return given
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
    stands = chain.positions(q)
    at = np.broadcast_to(chain.mount @ _placed(values[:6]), (len(q), 4, 4))
    found = [at]
    for k, joint in enumerate(chain.joints):
        own = values[6 + 8 * k : 14 + 8 * k]
        move = turn if joint.kind == "rotary" else slide
        at = at @ (joint.origin @ _placed(own[:6])) @ move(joint.axis, own[7] * (stands[:, k] + own[6]))
        found.append(at)
    return np.stack([*found, at @ (chain.tail @ chain.tool @ _placed(values[-6:]))])


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
    target, stands = every[-1][:, :3, 3], chain.positions(q)
    found = np.zeros((len(q), 6, len(values)))
    world = np.broadcast_to(chain.mount, every[0].shape)
    _placement(found[:, :, :6], world, values[:6], target)
    for k, joint in enumerate(chain.joints):
        own, columns = values[6 + 8 * k : 14 + 8 * k], found[:, :, 6 + 8 * k : 14 + 8 * k]
        placed = every[k] @ joint.origin
        _placement(columns[:, :, :6], placed, own[:6], target)
        axis = every[k + 1][:, :3, :3] @ joint.axis  # its own motion leaves the axis as it is
        rate = np.zeros((len(q), 6))
        if joint.kind == "rotary":
            rate[:, :3], rate[:, 3:] = np.cross(axis, target - every[k + 1][:, :3, 3]), axis
        else:
            rate[:, :3] = axis
        columns[:, :, 6] = own[7] * rate
        columns[:, :, 7] = (stands[:, k] + own[6])[:, None] * rate
    _placement(found[:, :, -6:], every[-2] @ chain.tail @ chain.tool, values[-6:], target)
    return found


def _placed(own: Numbers) -> Numbers:
    """Return Trans(x, y, z) Rz(rz) Ry(ry) Rx(rx) of x, y, z, rx, ry, rz."""
    return shift(own[0], own[1], own[2]) @ rpy(own[3], own[4], own[5])


def _placement(columns: Array, frame: Array, own: Array, target: Array) -> None:
    """Write the screws, (n, 6, 6), of a placement that stands behind `frame`, (n, 4, 4)."""
    turned = frame[:, :3, :3]
    lever = target - (turned @ own[:3] + frame[:, :3, 3])
    columns[:, :3, :3] = turned
    about_z = rpy(0, 0, own[5])[:3, :3]
    about_y = about_z @ rpy(0, own[4], 0)[:3, :3]
    for k, axis in ((3, about_y @ _X), (4, about_z @ _Y), (5, _Z)):
        w = turned @ axis
        columns[:, :3, k], columns[:, 3:, k] = np.cross(w, lever), w
