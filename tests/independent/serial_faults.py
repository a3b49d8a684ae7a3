"""What is hidden in an arm of `serial`: each fault with its own physics, its form 5 to 15 % off the textbook's.

How a form is off is drawn at random: `off` mixes in a lag, a ramp, a stiffening, so that what is new varies by that
part of what the textbook's varies by.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np

from tests.independent.arm6 import move, turn
from tests.independent.arm6_faults import lagged, off
from tests.independent.serial import Array, Built, Day

JOINT = ("eccentricity", "second", "teeth", "compliance", "play", "gain", "drift", "slip", "zero", "lag", "bending")
FAMILIES = (*JOINT, "growth", "base_drift", "base_shift", "tool_slip", "scale")
TEETH = 101


@dataclass
class State:
    """The arm through the run: joints beside their readings [rad], links longer, axes leaning, tool and base."""

    beside: Array
    grown: Array
    tilt: Array
    tool: Array
    told: list[Callable[[Array], Array]] = field(default_factory=list)

    @staticmethod
    def sound(day: Day) -> State:
        """Return the state without any fault."""
        n, joints = day.angle.shape
        return State(*(np.zeros((n, *shape)) for shape in ((joints,), (joints,), (joints, 2), (3,))))

    def seen(self, arm: Built, day: Day) -> tuple[Array, Array]:
        """Return the readings of the joints (n, J) and of the tracker (n, 3), without noise."""
        at = arm.place(day.angle, self.grown, self.tilt, self.tool)
        for tale in self.told:
            at = tale(at)
        return day.angle - self.beside, at


@dataclass(frozen=True)
class Fault:
    """One fault at one place; `largest` is what would be odd, `textbook` the same in the textbook's form."""

    family: str
    target: str
    largest: float
    apply: Callable[[State, float], None]
    textbook: Fault | None = None


def drawn(family: str, arm: Built, day: Day, rng: np.random.Generator) -> Fault:
    """Return a fault of `family` at a joint or link of chance."""
    joints = len(arm.make.joints)
    at = int(rng.integers(0, joints))
    if family == "growth":
        at = int(rng.choice(np.flatnonzero(np.linalg.norm(arm.make.xyz, axis=1) > 100)))
    if family == "compliance":
        at = int(rng.integers(1, joints - 1))  # gravity asks nothing of an upright joint, and little of the last
    if family == "bending":
        at = int(rng.integers(0, 4))
    again = deepcopy(rng)
    fault = _known(family, at, arm, day, rng, False)
    return replace(fault, textbook=_known(family, at, arm, day, again, True))


def _known(family: str, k: int, arm: Built, day: Day, rng: np.random.Generator, exact: bool) -> Fault:
    part = rng.uniform(0.05, 0.15) * (not exact)
    target, q, run = arm.make.joints[k], day.angle[:, k], day.run
    one, two = rng.uniform(0, 2 * np.pi, 2)
    when, slide = rng.uniform(0.25, 0.75), rng.uniform(0.03, 0.1)
    late = lagged(day.warmth, day.clock, rng.uniform(0.05, 0.2) * day.clock[-1])
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    step = off((run >= when).astype(float), np.clip((run - when) / slide, 0, 1), part)

    def joint(form: Array, largest: float) -> Fault:
        return Fault(family, target, largest, lambda s, a: _add(s.beside, k, a * form))

    if family == "eccentricity":
        ripple = np.cos(2 * q + two)

        def eccentric(s: State, a: float) -> None:
            s.beside[:, k] += off(np.arctan2(a * np.sin(q - one), 1 - a * np.cos(q - one)), ripple, part)

        return Fault(family, target, 5e-3, eccentric)
    if family == "second":
        return joint(off(np.cos(2 * q + one), np.cos(3 * q + two), part), 3e-3)
    if family == "teeth":
        return joint(off(np.cos(TEETH * q + one), np.cos(2 * TEETH * q + two), part), 2e-3)
    if family in ("compliance", "bending"):
        held = (
            arm.moments(day.angle, day.payload, arm.make.mass * rng.uniform(0.95, 1.05, len(arm.make.mass)))[:, k] / 100
        )
        if family == "compliance":
            return joint(off(held[:, 2], held[:, 2] * np.abs(held[:, 2]), part), 1e-2)
        lean = np.stack([off(held[:, i], held[:, i] * np.abs(held[:, i]), part) for i in (0, 1)], axis=-1)
        return Fault(family, target, 1e-2, lambda s, a: _add(s.tilt, k, a * lean))
    if family == "play":
        settled = np.exp(-day.travel[:, k] / 0.15)
        return joint(off(-day.came[:, k] / 2, day.came[:, k] * settled, part), 5e-3)
    if family == "gain":
        return joint(off(q, q**3, part), 5e-3)
    if family == "drift":
        return joint(off(run, np.exp(-run / rng.uniform(0.2, 0.5)), part), 5e-3)
    if family == "slip":
        return joint(step, 5e-3)
    if family == "zero":
        return joint(off(day.warmth - 21, late, part), 1e-3)
    if family == "lag":
        v = day.speed[:, k]
        return joint(off(v, v * np.abs(v), part), 3e-2)
    if family == "growth":
        form = off(day.warmth - 21, late, part)
        return Fault(family, target, 3e-4, lambda s, a: _add(s.grown, k, a * form))
    if family == "tool_slip":
        return Fault(family, "tool", 5.0, lambda s, a: s.tool.__iadd__(a * step[:, None] * way))
    if family == "scale":
        bent = off(run, run**2, part) - run  # the air warms: the scale goes with it a little

        def scaled(s: State, a: float) -> None:
            s.told.append(lambda at: at * (1 + a * (1 + bent[:, None])))

        return Fault(family, "tracker", 5e-3, scaled)
    form = off(run, np.exp(-run / 0.3), part) if family == "base_drift" else step
    lean = rng.normal(size=3) * (family == "base_drift")
    foot = arm.foot[:3, 3]

    def moved(s: State, a: float) -> None:
        def tale(at: Array) -> Array:
            R = (
                turn(2, a * 5e-4 * form * lean[2])
                @ turn(1, a * 5e-4 * form * lean[1])
                @ turn(0, a * 5e-4 * form * lean[0])
            )
            R = move(np.broadcast_to(foot, at.shape)) @ R
            return np.asarray(np.einsum("nij,nj->ni", R[:, :3, :3], at - foot) + foot + a * form[:, None] * way)

        s.told.append(tale)

    return Fault(family, "base", 5.0, moved)


def _add(where: Array, k: int, what: Array) -> None:
    where[:, k] += what
