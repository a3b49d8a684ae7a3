"""A chain of moving joints, and its kinematics: where the target is, and how that goes with every placement, by name.

    world -> base:  mount Trans(base_x, base_y, base_z) Rz(base_rz) Ry(base_ry) Rx(base_rx)
    joint J:        origin_J Trans(x_J, y_J, z_J) Rz(rz_J) Ry(ry_J) Rx(rx_J) motion(axis_J, gain_J (q_J + zero_J))
    tool:           tail tool Trans(tool_x, tool_y, tool_z) Rz(tool_rz) Ry(tool_ry) Rx(tool_rx)

Lengths are mm, angles rad, masses kg. All numbers are errors: 0 for the nominal arm, and 1 for a gain; which ones the
observations determine is for `determined` to say. Numbers that differ from row to row are for `walk`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, final

import numpy as np

from calibench.calibration.rigid import Array, Index, cross
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

    `origin`, (4, 4) [mm], goes from the joint before to this one at zero; `axis`, (3,), is a unit vector there. `mass`
    [kg] and its `centre` (3,) [mm] are of all that moves with it.
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

    @cached_property
    def fixed(self) -> tuple[Array, Array, Index]:
        """Return `fixed`, `align` and `sliding` of the kernels: each joint's frame is turned so that its axis is z."""
        turned = []
        for joint in self.joints:
            towards = np.eye(4)
            if joint.axis[2] != 1.0:
                x = np.cross(np.eye(3)[int(np.argmin(np.abs(joint.axis)))], joint.axis)
                x /= np.linalg.norm(x)
                towards[:3, :3] = np.column_stack([x, np.cross(joint.axis, x), joint.axis])
            turned.append(towards)
        fixed = [self.mount, self.joints[0].origin]
        fixed += [back.T @ joint.origin for back, joint in zip(turned, self.joints[1:], strict=False)]
        fixed.append(turned[-1].T @ self.tail @ self.tool)
        flat = np.ascontiguousarray([np.concatenate([f[:3, :3].ravel(), f[:3, 3]]) for f in fixed])
        align = np.ascontiguousarray([t[:3, :3].ravel() for t in turned])
        sliding = np.array([joint.kind == "sliding" for joint in self.joints], dtype=np.int64)
        return flat, align, sliding

    def positions(self, q: Array) -> Array:
        """Return where each joint of the chain stands, (n, J), from the readings q, (n, driven)."""
        gains, offsets = self.following
        return q @ gains.T + offsets


PLACEMENT = ("x", "y", "z", "rx", "ry", "rz")
UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")


def parameter_units(chain: Chain) -> dict[str, str]:
    """Return the unit of each parameter by its name, in the order of the vector: base, each joint (a gain has "")."""
    placed = list(zip(PLACEMENT, UNITS, strict=True))
    units = {f"base_{one}": unit for one, unit in placed}
    for joint in chain.joints:
        own = [*placed, ("zero", "rad" if joint.kind == "rotary" else "mm"), ("gain", "")]
        units |= {f"{one}_{joint.name}": unit for one, unit in own}
    return units | {f"tool_{one}": unit for one, unit in placed}


def nominal(chain: Chain) -> Array:
    """Return the parameters of the arm as it is described: 0, and 1 for a gain."""
    values = np.zeros(12 + 8 * len(chain.joints))
    values[13:-6:8] = 1.0
    return values


def forward(chain: Chain, p: Mapping[str, Any] | Array, q: Array) -> Array:
    """Return where the target is and how it is turned in the world, (n, 4, 4) [mm], at the readings q, (n, columns)."""
    return _poses(chain, p, q, _NONE, oriented=False)[0]


def jacobian(
    chain: Chain, p: Mapping[str, Any] | Array, q: Array, free: Index | None = None, turns: bool = True
) -> Array:
    """Return the derivative of the target's pose in the parameters `free`, or all, (n, 6, k): a screw a parameter.

    Rows 0 to 2 are the shift of the target [mm], rows 3 to 5 its turn as a vector w [rad], both in the world: to first
    order the rotation R becomes (I + [w]x) R. Without `turns` the first three alone.
    """
    every = np.arange(12 + 8 * len(chain.joints), dtype=np.int64)
    return _poses(chain, p, q, every if free is None else free, oriented=turns)[1]


_NONE = np.zeros(0, dtype=np.int64)


def _poses(chain: Chain, p: Mapping[str, Any] | Array, q: Array, free: Index, oriented: bool) -> tuple[Array, Array]:
    # here, as listing the problems must not load the compiler
    from calibench.calibration import _kernels as kernels

    q = np.atleast_2d(np.asarray(q, dtype=float))
    if q.shape[1] != len(chain.driven):
        raise ChainError(
            f"{chain.name}: q has {q.shape[1]} columns; one is needed for each of {', '.join(chain.driven)}"
        )
    stands = np.ascontiguousarray(chain.positions(q))
    if isinstance(p, Mapping):  # what it leaves out is nominal
        names, values = [*parameter_units(chain)], nominal(chain)
        index = {name: k for k, name in enumerate(names)}
        for name, value in p.items():
            if name not in index:
                raise ChainError(f"{chain.name}: {name!r} is no parameter of it; {suggest(name, names)}")
            values[index[name]] = value
    else:
        values, needed = np.ascontiguousarray(p, dtype=float), (12 + 8 * len(chain.joints),)
        if values.shape != needed:
            raise ChainError(f"{chain.name}: {values.shape} parameters were given; {needed} are needed")
    seen, screws = kernels.poses(values, free, *chain.fixed, stands, oriented)
    made = np.zeros((len(q), 4, 4))
    made[:, :3, 3], made[:, :3, 0], made[:, :3, 1] = seen[:, :3], seen[:, 3:6], seen[:, 6:]
    made[:, :3, 2], made[:, 3, 3] = cross(seen[:, 3:6], seen[:, 6:]), 1.0
    return made, screws


POSITION, POSE, SOCKET, GAP = 0, 1, 3, 4  # as digests of data have them
_ROWS = np.array((3, 6, 0, 3, 1))
ARM = 100.0  # mm: of a turn; a tracker that reads .02 mm reads some .01 degree


@final
@dataclass(frozen=True, eq=False)
class Compared:
    """Joints (n, columns), groups (g, 4), values (g, 12) and weights (g, 2), as `_kernels` has them."""

    q: Array
    groups: Index
    values: Array
    weight: Array
    size: int


def targets(q: Array, place: Array, turns: Array | None = None) -> Compared:
    """Return readings of the target's place, (n, 3) [mm], and where they were read its rotations, (n, 3, 3)."""
    kind, weight, values = POSITION, 0.0, place
    if turns is not None:
        kind, weight, values = POSE, ARM, np.concatenate([place, turns.reshape(-1, 9)], axis=1)
    groups = np.column_stack([np.full(len(q), kind), np.arange(len(q)), np.zeros(len(q))])
    return _made(q, groups, values, np.tile((1.0, weight), (len(q), 1)))


def sockets(
    q: Array, socket: Index, gaps: tuple[tuple[int, int, float], ...] = (), gap_weight: float = 1.0,
    beside: Array | None = None,
) -> Compared:  # fmt: skip
    """Return postures with the ball in a socket, (n,) 0, 1, ... without a gap: one unknown point a socket.

    `gaps` are known distances [mm] between two sockets, each weighing `gap_weight` times one residual of the ball.
    `beside`, (n, 3) [mm], is how far from that point the ball is known to sit, in the world.
    """
    n = len(socket)
    values = np.zeros((n + len(gaps), 3))
    if beside is not None:
        values[:n] = beside
    for s in range(int(socket.max()) + 1):
        values[:n][socket == s] -= values[:n][socket == s].mean(axis=0)  # the mean itself is the socket's point
    values[n:, 0] = [distance for *_, distance in gaps]
    groups = [*((SOCKET, i, s) for i, s in enumerate(socket.tolist())), *((GAP, a, b) for a, b, _ in gaps)]
    return _made(q, np.array(groups), values, np.array([(1.0, 0.0)] * n + [(gap_weight, 0.0)] * len(gaps)))


def _made(q: Array, groups: Array | Index, values: Array, weight: Array) -> Compared:
    sizes = _ROWS[groups[:, 0].astype(int)]
    filled = np.zeros((len(groups), 12))
    filled[:, : values.shape[1]] = values
    numbered = np.column_stack([groups, np.cumsum(sizes) - sizes]).astype(np.int64)
    return Compared(np.asarray(q, float), numbered, filled, weight, int(sizes.sum()))


def constants(chain: Chain, readings: Compared, template: Array, free: Index, limit: float) -> tuple[Any, ...]:
    """Return the arguments of the kernels after x."""
    stands, kinds = np.ascontiguousarray(chain.positions(readings.q)), readings.groups[:, 0]
    count = int(readings.groups[kinds == SOCKET, 2].max(initial=-1)) + 1
    compared = (bool((kinds == POSE).any()), readings.groups, readings.values, readings.weight)
    return (template, free, *chain.fixed, stands, *compared, count, float(limit), readings.size)
