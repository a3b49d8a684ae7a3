"""Two arms as their makers would describe and build them: six axes like a UR10's, seven like a Panda's.

A maker's table is a URDF, written here as text, and read here as numbers: nothing imports the code under test. A built
arm is off its table by every number of every placement; its foot stands anywhere in the hall, turned anyhow, and its
reflector anywhere near the flange: nobody tells a search where.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.independent.arm6 import move, turn

Array = NDArray[np.float64]
HALF = np.pi / 2
GRAVITY = 9.81e-3  # N m for 1 kg and 1 mm


@dataclass(frozen=True)
class Make:
    """A maker's table: of each joint its place [mm] and turn (rpy) behind the one before, limits, masses."""

    name: str
    joints: tuple[str, ...]
    xyz: Array
    rpy: Array
    flange: Array
    low: Array
    high: Array
    mass: Array
    centre: Array

    def urdf(self) -> str:
        """Return the table as URDF, in m and rad."""
        parts = [f'<robot name="{self.name}">', '<link name="foot"/>']
        before = "foot"
        for k, joint in enumerate(self.joints):
            where = " ".join(f"{v / 1000:.9g}" for v in self.centre[k])
            parts.append(
                f'<link name="body_{k}"><inertial><origin xyz="{where}" rpy="0 0 0"/><mass value="{self.mass[k]}"/>'
                '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            )
            xyz, rpy = (" ".join(f"{v:.15g}" for v in row) for row in (self.xyz[k] / 1000, self.rpy[k]))
            parts.append(
                f'<joint name="{joint}" type="revolute"><parent link="{before}"/><child link="body_{k}"/>'
                f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
                f'<limit lower="{self.low[k]}" upper="{self.high[k]}" effort="100" velocity="2"/></joint>'
            )
            before = f"body_{k}"
        tip = " ".join(f"{v / 1000:.9g}" for v in self.flange)
        parts.append(
            f'<link name="flange"/><joint name="plate" type="fixed"><parent link="{before}"/><child link="flange"/>'
            f'<origin xyz="{tip}" rpy="0 0 0"/></joint></robot>'
        )
        return "\n".join(parts)


SIX = Make(
    "six", ("pan", "lift", "elbow", "wrist_a", "wrist_b", "wrist_c"),
    np.array([[0, 0, 127.3], [0, 220.9, 0], [-612.0, 0, -171.9], [-572.3, 0, 114.9], [0, -115.7, 0], [0, 92.2, 0]]),
    np.array([[0, 0, 0], [HALF, 0, 0], [0, 0, 0], [0, 0, 0], [HALF, 0, 0], [-HALF, 0, 0.0]]),
    np.array([0.0, 0, 20.0]),
    np.array([-2.6, -2.3, 0.3, -2.6, -2.4, -3.0]), np.array([2.6, -0.4, 2.3, 0.6, 2.4, 3.0]),
    np.array([7.1, 12.7, 4.27, 2.0, 2.0, 0.4]),
    np.array([[21, 0, -27], [-232, 0, 158], [-332, 0, 68], [0, -7, 18], [0, 7, 18], [0, 0, -26.0]]),
)  # fmt: skip
SEVEN = Make(
    "seven", tuple(f"axis{k}" for k in range(1, 8)),
    np.array([[0, 0, 333.0], [0, 0, 0], [0, -316.0, 0], [82.5, 0, 0], [-82.5, 384.0, 0], [0, 0, 0], [88.0, 0, 0]]),
    np.array([[0, 0, 0], [-HALF, 0, 0], [HALF, 0, 0], [HALF, 0, 0], [-HALF, 0, 0], [HALF, 0, 0], [HALF, 0, 0.0]]),
    np.array([0.0, 0, 107.0]),
    np.array([-2.7, -1.6, -2.7, -2.9, -2.7, 0.2, -2.7]), np.array([2.7, 1.6, 2.7, -0.2, 2.7, 3.5, 2.7]),
    np.array([3.0, 3.1, 2.6, 2.8, 3.0, 1.4, 0.8]),
    np.array([[0, -20, -60], [0, -60, 20], [30, 20, -50], [-40, 60, 20], [0, 30, -100], [60, 0, 0], [10, 0, 60.0]]),
)  # fmt: skip
MAKES = {"six": SIX, "seven": SEVEN}


@dataclass(frozen=True)
class Built:
    """One arm off the line, in one hall: `off` (J, 6) mm and rad beside the table, `foot` (4, 4), reflector (3,) mm."""

    make: Make
    off: Array
    foot: Array
    tool: Array

    @staticmethod
    def drawn(make: Make, rng: np.random.Generator) -> Built:
        """Return one arm: .4 mm and .6 mrad off its table, 3 mrad of zero, its foot and reflector anywhere."""
        n = len(make.joints)
        off = np.concatenate([rng.normal(0, 0.4, (n, 3)), rng.normal(0, 6e-4, (n, 3))], axis=1)
        off[:, 5] += rng.normal(0, 3e-3, n)
        way, angle = rng.normal(size=3), rng.uniform(0, np.pi)
        foot = move(rng.uniform(-3000, 3000, 3)) @ _around(way / np.linalg.norm(way), angle)
        return Built(make, off, foot, rng.uniform(-120, 120, 3))

    def frames(self, angle: Array, grown: Array | None = None, tilt: Array | None = None) -> list[Array]:
        """Return the frame of each joint before it turns, then that of the flange, each (n, 4, 4)."""
        at = np.broadcast_to(self.foot, (len(angle), 4, 4))
        found = []
        for k in range(len(self.make.joints)):
            along = self.make.xyz[k] * (1.0 if grown is None else 1.0 + grown[:, k : k + 1])
            at = at @ move(np.broadcast_to(along, (len(angle), 3))) @ _rpy(self.make.rpy[k])
            at = at @ move(self.off[k, :3]) @ _rpy(self.off[k, 3:])
            if tilt is not None and tilt[:, k].any():
                at = at @ turn(0, tilt[:, k, 0]) @ turn(1, tilt[:, k, 1])
            found.append(at)
            at = at @ turn(2, angle[:, k])
        return [*found, at @ move(self.make.flange)]

    def place(
        self, angle: Array, grown: Array | None = None, tilt: Array | None = None, tool: Array | None = None
    ) -> Array:
        """Return where the reflector is in the tracker's frame, (n, 3) mm; `tool` (n, 3) is how far it has slipped."""
        flange = self.frames(angle, grown, tilt)[-1]
        held = self.tool if tool is None else self.tool + tool
        return np.asarray(flange[:, :3, 3] + np.einsum("nij,...j->ni", flange[:, :3, :3], held) if tool is None else
                          flange[:, :3, 3] + np.einsum("nij,nj->ni", flange[:, :3, :3], held))  # fmt: skip

    def moments(self, angle: Array, payload: Array, mass: Array | None = None) -> Array:
        """Return the moment of gravity at each joint [N m], (n, J, 3), in its frame before it turns."""
        mass = self.make.mass if mass is None else mass
        frames = self.frames(angle)
        n, down = len(angle), -self.foot[:3, 2] * GRAVITY
        bodies = []
        for k in range(len(mass)):
            moved = frames[k] @ turn(2, angle[:, k])
            bodies.append((np.full(n, mass[k]), moved[:, :3, 3] + moved[:, :3, :3] @ self.make.centre[k]))
        bodies.append((payload, frames[-1][:, :3, 3] + frames[-1][:, :3, :3] @ self.tool))
        out = np.zeros((n, len(mass), 3))
        for k in range(len(mass)):
            for weight, where in bodies[k:]:
                out[:, k] += np.cross(where - frames[k][:, :3, 3], weight[:, None] * down)
            out[:, k] = np.einsum("nji,nj->ni", frames[k][:, :3, :3], out[:, k])
        return out


def _rpy(angles: Array) -> Array:
    return np.asarray(turn(2, np.array(angles[2])) @ turn(1, np.array(angles[1])) @ turn(0, np.array(angles[0])))


def _around(axis: Array, angle: float) -> Array:
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    made = np.eye(4)
    made[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return made


@dataclass(frozen=True)
class Day:
    """One run: poses in order, what is carried, how warm it is; a row a reading, `pose` tells which are of one pose."""

    pose: NDArray[np.int64]
    angle: Array
    came: Array
    travel: Array
    speed: Array
    payload: Array
    clock: Array
    warmth: Array

    @property
    def run(self) -> Array:
        """Return the part of the run that is over, 0 to 1, (n,)."""
        return np.asarray((self.clock - self.clock[0]) / np.ptp(self.clock))

    @property
    def hold(self) -> NDArray[np.bool_]:
        """Return which readings are kept back: those of every fifth pose."""
        return np.asarray(self.pose % 5 == 0)


def spent(make: Make, rng: np.random.Generator, poses: int) -> Day:
    """Return a run over `poses`; on half of the runs each is read twice, on half the arm is read as it moves."""
    reads = int(rng.integers(1, 3))
    commanded = rng.uniform(make.low, make.high, (poses, len(make.joints)))
    pose = np.repeat(np.arange(poses), reads)
    moved = np.diff(commanded, axis=0, prepend=np.zeros((1, len(make.joints))))
    speed = np.sign(moved) * rng.uniform(0.02, 0.25, moved.shape) * (rng.random() < 0.5)
    payload = rng.choice([0.0, 2.5, 5.0], poses)
    pause = np.where(np.diff(pose, prepend=-1) != 0, rng.uniform(15, 40, poses)[pose], 2.0)
    clock = np.cumsum(pause)
    part = clock / clock[-1]
    warmth = 21 + rng.uniform(2, 7) * (1 - np.exp(-3 * part))
    warmth = warmth + rng.uniform(0.3, 1.2) * np.sin(2 * np.pi * (part * rng.uniform(0.8, 3) + rng.random()))
    angle = commanded[pose] + rng.normal(0, 2e-4, moved.shape)[pose]
    return Day(pose, angle, np.sign(moved)[pose], np.abs(moved)[pose], speed[pose], payload[pose], clock, warmth)


def stopped(day: Day, rows: NDArray[np.bool_]) -> Day:
    """Return some rows of a run."""
    return replace(day, **{name: getattr(day, name)[rows] for name in day.__dataclass_fields__})
