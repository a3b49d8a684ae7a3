"""A chain of moving joints, and its kinematics: where the target is, and how that goes with every placement, by name.

Lengths are mm, angles rad, masses kg. What is fixed between two moving joints is folded into the placement of the
second one; what is fixed behind the last is the tail. Whatever an arm was described by (URDF, a table of
Denavit-Hartenberg or Hayati rows), it becomes a `Chain`.

    world -> base:  mount Trans(base_x, base_y, base_z) Rz(base_rz) Ry(base_ry) Rx(base_rx)
    joint J:        origin_J Trans(x_J, y_J, z_J) Rz(rz_J) Ry(ry_J) Rx(rx_J) motion(axis_J, gain_J (q_J + zero_J))
    tool:           tail tool Trans(tool_x, tool_y, tool_z) Rz(tool_rz) Ry(tool_ry) Rx(tool_rx)

All are errors: 0 for the nominal arm, and 1 for a gain. Many say the same thing twice (a turn of the placement about
the joint's own axis is its zero); which ones the observations determine is for `determined` to say. A complex step
passes through `forward` and `frames`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, final

import numpy as np

from calibench.calibration.rigid import Array, Numbers, cross, rpy, slide, turn
from calibench.core.options import suggest

Kind = Literal["rotary", "sliding"]


class ChainError(ValueError):
    """A description of an arm that cannot be used; the message is one line that says what to do."""


@final
@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: it stands at ``gain * q + offset``, q the reading of `joint` (offset rad or mm)."""

    joint: str
    gain: float = 1.0
    offset: float = 0.0


@final
@dataclass(frozen=True, eq=False)
class ChainJoint:
    """One moving joint: its placement behind the joint before, its axis, its limits, and what moves with it.

    `origin`, (4, 4) [mm], goes from the frame of the joint before (after its motion; the base for the first) to this
    joint's frame at zero. `axis`, (3,), is a unit vector there. `lower` and `upper` are rad or mm, infinite where there
    is no stop. `mass` [kg] and its `centre` (3,) [mm], in the frame that moves with the joint, hold all that is rigidly
    attached to it; None where the description does not tell it. `link` is the link that it moves.
    """

    name: str
    kind: Kind
    origin: Array
    axis: Array
    lower: float = -np.inf
    upper: float = np.inf
    mimic: Mimic | None = None
    mass: float | None = None
    centre: Array | None = None
    link: str = ""


@final
@dataclass(frozen=True, eq=False)
class Chain:
    """Moving joints from the link `base` to the link `tip`; `tail`, (4, 4) [mm], is fixed behind the last of them.

    `mount` and `tool`, (4, 4) [mm], are where base and target are taken to be before any fit: from the frame of the
    measurement to the base, and from the tip to the target. Both are nothing in a description; `placed` sets them.
    `source` is what messages call the description: URDF, or table.
    """

    joints: tuple[ChainJoint, ...]
    tail: Array
    name: str = "arm"
    base: str = "base"
    tip: str = "tip"
    mount: Array = field(default_factory=lambda: np.eye(4))
    tool: Array = field(default_factory=lambda: np.eye(4))
    source: str = "URDF"

    def __post_init__(self) -> None:
        names = [joint.name for joint in self.joints]
        if not names:
            raise ChainError(f"{self.name}: no joint moves between {self.base} and {self.tip}; take another tip")
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ChainError(f"{self.name}: two joints are named {twice!r}; give each a name of its own")

    def placed(self, mount: Array | None = None, tool: Array | None = None) -> Chain:
        """Return the chain with its base at `mount` and its target at `tool`, (4, 4) [mm]; None keeps one."""
        return replace(self, mount=self.mount if mount is None else mount, tool=self.tool if tool is None else tool)

    @cached_property
    def driven(self) -> tuple[str, ...]:
        """Return the names of the joints that are read, one for each column of q: those that others mimic once."""
        return tuple(dict.fromkeys(j.name if j.mimic is None else j.mimic.joint for j in self.joints))

    @cached_property
    def following(self) -> tuple[Array, Array]:
        """Return gains (J, columns of q) and offsets (J,): the joints of the chain stand at ``gains @ q + offsets``."""
        gains, offsets = np.zeros((len(self.joints), len(self.driven))), np.zeros(len(self.joints))
        for k, joint in enumerate(self.joints):
            follows = joint.mimic or Mimic(joint.name)
            gains[k, self.driven.index(follows.joint)] = follows.gain
            offsets[k] = follows.offset
        return gains, offsets

    def positions(self, q: Array) -> Array:
        """Return where each joint of the chain stands, (n, J), from the readings q, (n, driven)."""
        gains, offsets = self.following
        return q @ gains.T + offsets


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
    numbers = values[6:-6].reshape(-1, 8)
    placed = _placed(np.concatenate([values[None, :6], numbers[:, :6], values[None, -6:]]))
    fixed = _origins(chain) @ placed[1:-1]
    moves = _moves(chain, numbers[:, 7, None] * (chain.positions(q).T + numbers[:, 6, None]))
    poses = [np.broadcast_to(chain.mount @ placed[0], (len(q), 4, 4))]
    for step in fixed[:, None] @ moves:
        poses.append(poses[-1] @ step)
    return np.stack([*poses, poses[-1] @ (chain.tail @ chain.tool @ placed[-1])])


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
    target, numbers = every[-1][:, :3, 3], values[6:-6].reshape(-1, 8)
    before = np.concatenate([
        np.broadcast_to(chain.mount, (1, len(q), 4, 4)),
        every[:-2] @ _origins(chain)[:, None],
        every[-2:-1] @ (chain.tail @ chain.tool),
    ])  # fmt: skip
    screws = _placements(before, np.concatenate([values[None, :6], numbers[:, :6], values[None, -6:]]), target)
    moved = every[1:-1]  # a joint's own motion leaves its axis as it is
    axes = (moved[..., :3, :3] @ np.stack([joint.axis for joint in chain.joints])[:, None, :, None])[..., 0]
    rotary = np.array([joint.kind == "rotary" for joint in chain.joints])[:, None, None]
    rates = np.concatenate([
        np.where(rotary, cross(axes, target - moved[..., :3, 3]), axes), np.where(rotary, axes, 0.0)
    ], axis=-1)[..., None]  # fmt: skip
    stands = (chain.positions(q).T + numbers[:, 6, None])[..., None, None]
    joints = np.concatenate([screws[1:-1], numbers[:, 7, None, None, None] * rates, stands * rates], axis=-1)
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


def _placed(numbers: Numbers) -> Numbers:
    """Return Trans(x, y, z) Rz(rz) Ry(ry) Rx(rx), (K, 4, 4), of x, y, z, rx, ry, rz, (K, 6)."""
    made = rpy(numbers[:, 3], numbers[:, 4], numbers[:, 5])
    made[:, :3, 3] = numbers[:, :3]
    return made


def _placements(before: Array, numbers: Array, target: Array) -> Array:
    """Return the screws, (K, n, 6, 6), of placements `numbers` (K, 6) behind the frames `before`, (K, n, 4, 4)."""
    turned = before[..., :3, :3]
    lever = target - ((turned @ numbers[:, None, :3, None])[..., 0] + before[..., :3, 3])
    cy, sy, cz, sz = np.cos(numbers[:, 4]), np.sin(numbers[:, 4]), np.cos(numbers[:, 5]), np.sin(numbers[:, 5])
    none, one = np.zeros(len(numbers)), np.ones(len(numbers))
    about = np.stack([cz * cy, sz * cy, -sy, -sz, cz, none, none, none, one], axis=-1).reshape(-1, 3, 3)
    w = np.swapaxes(about[:, None] @ np.swapaxes(turned, -1, -2), -1, -2)  # Rz Ry ex, Rz ey and ez, in columns
    shifts = np.swapaxes(cross(np.swapaxes(w, -1, -2), lever[..., None, :]), -1, -2)
    upper = np.concatenate([turned, shifts], axis=-1)
    return np.concatenate([upper, np.concatenate([np.zeros_like(turned), w], axis=-1)], axis=-2)
