"""A chain of moving joints, as the arm's mathematics needs it: placements, axes, limits and masses from base to tip.

Lengths are mm, angles rad, masses kg. What is fixed between two moving joints is folded into the placement of the
second one; what is fixed behind the last is the tail. Whatever an arm was described by (URDF, a table of
Denavit-Hartenberg or Hayati rows), it becomes this.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, final

import numpy as np

from calibench.problems.base import Array

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
    `told` is what messages call the description: URDF, or table.
    """

    joints: tuple[ChainJoint, ...]
    tail: Array
    name: str = "arm"
    base: str = "base"
    tip: str = "tip"
    mount: Array = field(default_factory=lambda: np.eye(4))
    tool: Array = field(default_factory=lambda: np.eye(4))
    told: str = "URDF"

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

    @property
    def massless(self) -> tuple[str, ...]:
        """Return the links whose mass is not told; gravity is known only where there is none."""
        return tuple(j.link or j.name for j in self.joints if j.mass is None or j.centre is None)

    def masses(self) -> tuple[Array, Array]:
        """Return masses (J,) [kg] and centres (J, 3) [mm] in the joints' moving frames.

        Raises `ChainError` where one is not told.
        """
        if self.massless:
            raise ChainError(
                f"{self.name}: no mass is told of {', '.join(self.massless)}; give each an <inertial> with mass and "
                "origin, or leave out what needs gravity"
            )
        return (
            np.array([j.mass for j in self.joints], dtype=float),
            np.array([j.centre for j in self.joints], dtype=float),
        )
