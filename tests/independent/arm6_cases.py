"""`case(seed)`: a file that a workshop measured on its six-axis arm, and apart from it the truth.

20 % of the cases miss nothing, 40 % one fault, 15 % two, 25 % one that no catalogue has. A fault is drawn by its
visible size: the rms, in sigma of the tracker, of what calibrating the geometry leaves of it.

    case(7).columns, case(7).sigma      what the workshop has on disk
    case(7).truth                       what was hidden; no search may read it
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tests.independent.arm6 import AXES, Array, Build, Calibration, Day, built, nominal, spent, torques
from tests.independent.arm6_faults import FAMILIES, FOREIGN, Fault, State, drawn

Kind = Literal["none", "one", "two", "outside"]
SHARES: dict[Kind, float] = {"none": 0.20, "one": 0.40, "two": 0.15, "outside": 0.25}
VISIBLE = (0.4, 4.0)
LEAST = 0.3  # what stays below this at the largest size anybody would believe is drawn anew


@dataclass(frozen=True)
class Hidden:
    """One fault of the truth: its names, its size in its own unit, and what is visible of it [sigma].

    `outside` is how much of that is not the textbook's form, 0 to 1 and more: calibration may take the form away and
    leave what is off it. Of a tracker's scale, where all lengths are fitted, it leaves nothing else.
    """

    family: str
    target: str
    size: float
    visible: float
    outside: float


@dataclass(frozen=True)
class Truth:
    """What was hidden. `noise` is gauss or t4."""

    seed: int
    kind: Kind
    faults: tuple[Hidden, ...]
    noise: str
    rows: int

    @property
    def visible(self) -> float:
        """Return the visible size of the smallest fault, 0 where there is none."""
        return min((f.visible for f in self.faults), default=0.0)


@dataclass(frozen=True)
class Case:
    """A measured file: `columns`, the stated `sigma` of the tracker [mm], `teeth` of the gears; and the truth."""

    columns: dict[str, Any]
    sigma: float
    teeth: int
    truth: Truth


def case(
    seed: int, *, kind: Kind | None = None, poses: int | None = None, family: str | None = None,
    visible: float | None = None,
) -> Case:  # fmt: skip
    """Draw the case of `seed`; what is asked for is fixed, all else stays as drawn."""
    geometry, plan, whole, hidden, noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
    drawn_kind = str(whole.choice(list(SHARES), p=list(SHARES.values())))
    kind = kind or (drawn_kind if family is None else "outside" if family in FOREIGN else "one")  # type: ignore[assignment]
    sigma = float(whole.choice([0.02, 0.05]))
    law = str(whole.choice(["gauss", "t4"], p=[0.75, 0.25]))
    teeth = int(whole.integers(40, 120))
    build, day = built(geometry), spent(plan, poses or int(plan.integers(60, 121)))

    pool = list(FOREIGN) if kind == "outside" else list(FAMILIES)
    wanted = {"none": 0, "one": 1, "two": 2, "outside": 1}[kind]
    faults: list[tuple[Fault, Hidden]] = []
    eye = Eye.of(build, day, sigma)
    for _ in range(200):
        if len(faults) == wanted:
            break
        fault = drawn(family or str(hidden.choice(pool)), build, day, hidden, teeth)
        goal = visible or float(np.exp(hidden.uniform(*np.log(VISIBLE))))
        if any((f.family, f.target) == (fault.family, fault.target) for f, _ in faults):
            continue
        if (sized := eye.sized(fault, goal)) is not None:
            faults.append((fault, sized))

    state = State.sound(len(day.pose))
    for fault, told in faults:
        fault.apply(state, told.size)
    readings, at = state.seen(build, day)
    shaken = noise.normal(size=at.shape) if law == "gauss" else noise.standard_t(4, size=at.shape) / np.sqrt(2)
    truth = Truth(seed, kind, tuple(told for _, told in faults), law, len(day.pose))  # type: ignore[arg-type]
    return Case(_columns(day, readings, at + sigma * shaken), sigma, teeth, truth)


@dataclass(frozen=True)
class Eye:
    """What is seen of a fault on the readings that are fitted, after the geometry was calibrated."""

    build: Build
    day: Day
    sigma: float
    calibration: Calibration

    @staticmethod
    def of(build: Build, day: Day, sigma: float) -> Eye:
        """Return the eye for one arm and day."""
        return Eye(build, day, sigma, Calibration.of(build, day.angle[~day.hold] - build.zero))

    def left(self, fault: Fault, size: float) -> Array:
        """Return what calibration leaves, (n, 3), in sigma."""
        state = State.sound(len(self.day.pose))
        fault.apply(state, size)
        readings, at = state.seen(self.build, self.day)
        fitted = ~self.day.hold
        return self.calibration.left_of(readings[fitted], at[fitted]) / self.sigma

    def sized(self, fault: Fault, goal: float) -> Hidden | None:
        """Return the fault seen as `goal`, or at its largest; None where that is all but invisible."""
        size = fault.largest / 3
        for _ in range(3):
            seen = _rms(self.left(fault, size))
            if seen < 1e-6:
                return None
            size = min(size * goal / seen, fault.largest)
        left = self.left(fault, size)
        if _rms(left) < LEAST:
            return None
        told = 0.0 if fault.textbook is None else self.left(fault.textbook, size)
        return Hidden(fault.family, fault.target, size, _rms(left), _rms(left - told) / _rms(left))


def _rms(left: Array) -> float:
    return float(np.sqrt(np.mean(left**2)))


def _columns(day: Day, readings: Array, at: Array) -> dict[str, Any]:
    """Return the file's columns, under the workshop's names; torques are the controller's, from the maker's table."""
    asked = torques(nominal(), day.angle, day.payload)
    columns: dict[str, Any] = {"pose_id": day.pose, "visit_id": day.visit}
    columns["split"] = np.where(day.hold, "hold", "train")
    columns |= {"clock_s": day.clock, "hall_K": day.warmth, "load_kg": day.payload}
    columns |= {f"leica_{c}": at[:, k] for k, c in enumerate("xyz")}
    for k, axis in enumerate(AXES):
        columns[axis] = readings[:, k]
        columns |= {f"from_{axis}": day.came[:, k], f"pace_{axis}": day.speed[:, k], f"Nm_{axis}": asked[:, k]}
    return columns
