"""A hidden effect as physics: what it does to members, drives, encoders or the tracker; and the machine under effects.

Each part of an `Effect` takes its amplitude a and returns the disturbance itself, never a derivative of it. At a = 0
all of them vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.gpm2002.design import Plan
from benchmarks.blind.gpm2002.machine import OFFSETS, Array
from benchmarks.blind.gpm2002.statics import Rest, settle


@dataclass(frozen=True)
class State:
    """The machine at rest: its plan, its members as they are in each row (n, 15), where it stands, its nominal self."""

    plan: Plan
    members: Array
    rest: Rest
    still: Rest


@dataclass(frozen=True)
class Effect:
    """A named cause on one target; `typical` and `largest` amplitudes in `unit` are what such machines may have.

    body(a, plan, machine) -> members' change (n, 15); windup(a, tau) -> (n, 3) [rad]; stretch(a, N) -> (n, 3) [mm];
    read(a, state) -> (n, 3) [rad] added to what the encoders say; see(a, state) -> (n, 2) [mm] added to the tracker;
    coarsen(a, readings) -> readings. `needs` are the columns without which no one could name it; `known` says whether
    the catalogue has it; `gauge` names the data that cannot see it in principle ("angles" or nothing).
    """

    family: str
    target: str
    unit: str
    typical: float
    largest: float
    needs: tuple[str, ...] = ()
    known: bool = True
    gauge: str = ""
    body: Callable[[float, Plan, Array], Array] | None = None
    windup: Callable[[float, Array], Array] | None = None
    stretch: Callable[[float, Array], Array] | None = None
    read: Callable[[float, State], Array] | None = None
    see: Callable[[float, State], Array] | None = None
    coarsen: Callable[[float, Array], Array] | None = None


Dose = tuple[Effect, float]


@dataclass(frozen=True)
class Signals:
    """What the sensors would say without noise: readings (n, 3) [rad], tracker (n, 2) [mm]; and the rest behind it."""

    readings: Array
    tracker: Array
    rest: Rest


def run(machine: Array, plan: Plan, still: Rest, doses: Sequence[Dose]) -> Signals:
    """Drive `machine`, shape (15,), through `plan` with effects at their amplitudes; `still` is its rest without."""
    bodies = [(e.body, a) for e, a in doses if e.body is not None]
    members = np.broadcast_to(machine, (len(plan.t), 15))
    for body, a in bodies:
        members = members + body(a, plan, machine)
    windups = [(e.windup, a) for e, a in doses if e.windup is not None]
    stretches = [(e.stretch, a) for e, a in doses if e.stretch is not None]
    rest = still
    if bodies or windups or stretches:
        rest = settle(
            members,
            plan.position,
            plan.branch,
            plan.load,
            plan.preload,
            (lambda tau: sum(f(a, tau) for f, a in windups)) if windups else None,
            (lambda n: sum(f(a, n) for f, a in stretches)) if stretches else None,
        )
    state = State(plan, members, rest, still)
    readings, tracker = rest.motor_angles - machine[OFFSETS], rest.position.copy()
    errors = [e.read(a, state) for e, a in doses if e.read is not None]
    return Signals(readings + sum(errors), tracker + sum(e.see(a, state) for e, a in doses if e.see is not None), rest)


def coarsened(readings: Array, doses: Sequence[Dose]) -> Array:
    """Return what the counters pass on of readings (n, 3) with their noise."""
    for effect, a in doses:
        if effect.coarsen is not None:
            readings = effect.coarsen(a, readings)
    return readings


def one_joint(i: int, values: Array) -> Array:
    """Return values (n,) in column i of an array (n, 3) that is zero elsewhere."""
    column = np.zeros((len(values), 3))
    column[:, i] = values
    return column
