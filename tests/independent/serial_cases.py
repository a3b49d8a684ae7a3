"""`case(seed)`: a URDF and a CSV's columns as an owner of an arm has them, and apart from them the truth.

Of the cases 25 % miss nothing, 60 % one fault, 15 % two. A fault is drawn by its visible size: the rms, in sigma of the
tracker, of what calibrating base, tool and all placements leaves of it on the readings that are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.independent.serial import MAKES, Array, Built, Day, spent
from tests.independent.serial_faults import FAMILIES, TEETH, Fault, State, drawn

SHARES = {"none": 0.25, "one": 0.60, "two": 0.15}
VISIBLE = (0.6, 4.0)
LEAST = 0.3


@dataclass(frozen=True)
class Hidden:
    """One fault of the truth, its size, and what is visible of it [sigma]; `outside` is the part off the textbook."""

    family: str
    target: str
    size: float
    visible: float
    outside: float


@dataclass(frozen=True)
class Case:
    """A file: `urdf` text, `columns`, what is stated of it; and the truth: kind, faults, arm, exact readings."""

    urdf: str
    columns: dict[str, Any]
    stated: dict[str, Any]
    kind: str
    faults: tuple[Hidden, ...]
    arm: Built
    exact: Array
    make: str
    poses: int
    sigma: float


def case(
    seed: int,
    *,
    kind: str = "",
    make: str = "",
    poses: int = 0,
    sigma: float = 0.0,
    family: str = "",
    visible: float = 0.0,
) -> Case:
    """Draw the case of `seed`; what is asked for is fixed, all else stays as drawn."""
    geometry, plan, whole, hidden, noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
    drawn_kind, drawn_make = str(whole.choice(list(SHARES), p=list(SHARES.values()))), str(whole.choice(list(MAKES)))
    drawn_poses, drawn_sigma = int(whole.choice([60, 300])), float(whole.choice([0.02, 0.05]))
    kind = kind or ("one" if family else drawn_kind)
    make, poses, sigma = make or drawn_make, poses or drawn_poses, sigma or drawn_sigma
    arm = Built.drawn(MAKES[make], geometry)
    day = spent(arm.make, plan, poses)
    told = {name: bool(plan.random() < 0.5) for name in ("direction", "clock")}
    eye = Eye(arm, day, sigma, _taken(arm, day))
    faults: list[tuple[Fault, Hidden]] = []
    for _ in range(200):
        if len(faults) == ("none", "one", "two").index(kind):
            break
        fault = drawn(family or str(hidden.choice(FAMILIES)), arm, day, hidden)
        goal = visible or float(np.exp(hidden.uniform(*np.log(VISIBLE))))
        if any((f.family, f.target) == (fault.family, fault.target) for f, _ in faults):
            continue
        if (sized := eye.sized(fault, goal)) is not None:
            faults.append((fault, sized))
    state = State.sound(day)
    for fault, of in faults:
        fault.apply(state, of.size)
    readings, at = state.seen(arm, day)
    columns = _columns(arm, day, readings, at + sigma * noise.normal(size=at.shape), told)
    stated = {"sigma_mm": sigma, "teeth": TEETH}
    return Case(arm.make.urdf(), columns, stated, kind, tuple(of for _, of in faults), arm, at, make, poses, sigma)


def _columns(arm: Built, day: Day, readings: Array, at: Array, told: dict[str, bool]) -> dict[str, Any]:
    columns: dict[str, Any] = dict(zip(arm.make.joints, readings.T))
    columns |= {name: at[:, k] for k, name in enumerate("xyz")}
    columns |= {"pose_id": day.pose, "payload_kg": day.payload, "temperature_C": day.warmth}
    columns["split"] = np.where(day.hold, "hold", "train")
    if told["clock"]:
        columns["t_s"] = day.clock
    for k, joint in enumerate(arm.make.joints):
        if told["direction"]:
            columns[f"direction_{joint}"] = day.came[:, k]
        if day.speed.any():
            columns[f"velocity_{joint}"] = day.speed[:, k]
    return columns


@dataclass(frozen=True)
class Eye:
    """What is seen of a fault on the readings that are fitted, after calibration; `taken` is what that explains."""

    arm: Built
    day: Day
    sigma: float
    taken: Array

    def left(self, fault: Fault, size: float) -> Array:
        """Return what calibration leaves, (m,), in sigma."""
        state = State.sound(self.day)
        fault.apply(state, size)
        readings, at = state.seen(self.arm, self.day)
        off = (at - self.arm.place(readings))[~self.day.hold].ravel() / self.sigma
        return np.asarray(off - self.taken @ (self.taken.T @ off))

    def sized(self, fault: Fault, goal: float) -> Hidden | None:
        """Return the fault seen as `goal`, or at its largest; None where that is all but invisible."""
        size = fault.largest / 3
        for _ in range(3):
            seen = _rms(self.left(fault, size))
            if seen < 1e-6:
                return None
            size = min(size * goal / seen, fault.largest)
        left = self.left(fault, size)
        if _rms(left) < LEAST or fault.textbook is None:
            return None
        return Hidden(
            fault.family, fault.target, size, _rms(left), _rms(left - self.left(fault.textbook, size)) / _rms(left)
        )


def _taken(arm: Built, day: Day) -> Array:
    """Return an orthonormal basis of what calibration explains of the fitted readings, by differences."""
    angle = day.angle[~day.hold]
    columns = []
    for k in range(len(arm.make.joints)):
        for i in range(6):
            step = 1e-3 if i < 3 else 1e-7
            ends = []
            for sign in (1, -1):
                bent = arm.off.copy()
                bent[k, i] += sign * step
                ends.append(Built(arm.make, bent, arm.foot, arm.tool).place(angle))
            columns.append((ends[0] - ends[1]).ravel() / (2 * step) / (1 if i < 3 else 1000))
    at = arm.place(angle)
    for i in range(3):
        columns.append(np.broadcast_to(np.eye(3)[i], at.shape).ravel())
        columns.append(np.cross(np.eye(3)[i], at - arm.foot[:3, 3]).ravel() / 1000)
        moved = Built(arm.make, arm.off, arm.foot, arm.tool + np.eye(3)[i])
        columns.append((moved.place(angle) - at).ravel())
    left, size, _ = np.linalg.svd(np.stack(columns, axis=-1), full_matrices=False)
    return np.asarray(left[:, size > 1e-6 * size[0]])


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(left**2)))
