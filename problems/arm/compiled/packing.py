"""A chain as the kernels take it: constant frames, with each joint's own turned so that its axis is z."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.readings import Readings
from calibench.problems.base import Array

Index = NDArray[np.int64]


def packed_chain(chain: Chain) -> tuple[Array, Array, Index]:
    """Return `fixed` (J + 2, 12), `align` (J, 9) and `sliding` (J,): what `_kernels` needs of a chain."""
    turned = [_towards(joint.axis) for joint in chain.joints]
    fixed = [chain.mount, chain.joints[0].origin]
    for k, joint in enumerate(chain.joints[1:]):
        fixed.append(turned[k].T @ joint.origin)
    fixed.append(turned[-1].T @ chain.tail @ chain.tool)
    flat = [np.concatenate([f[:3, :3].ravel(), f[:3, 3]]) for f in fixed]
    align = [t[:3, :3].ravel() for t in turned]
    sliding = np.array([joint.kind == "sliding" for joint in chain.joints], dtype=np.int64)
    return np.ascontiguousarray(flat), np.ascontiguousarray(align), sliding


def constants(chain: Chain, readings: Readings, template: Array, free: Index, limit: float) -> tuple[Any, ...]:
    """Return the arguments of the kernels after x."""
    fixed, align, sliding = packed_chain(chain)
    stands = np.ascontiguousarray(chain.positions(readings.q))
    compared = readings.packed()
    ends = (readings.sockets, float(limit), readings.size)
    return (template, free, fixed, align, sliding, stands, readings.oriented, *compared, *ends)


def _towards(axis: Array) -> Array:
    """Return a rotation (4, 4) that turns z into `axis`; nothing where it is z."""
    made = np.eye(4)
    if axis[2] == 1.0:
        return made
    least = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(least, axis)
    x /= np.linalg.norm(x)
    made[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
    return made
