"""What can be wrong with a six-axis arm, with its own physics: no form here is the textbook's, but 5 to 15 % off it.

A fault of unit size is drawn for one day and one arm. It says how far each joint stands from its reading, by what part
links are longer, how axes lean, and what the tracker tells of the place. `off` mixes into the textbook's form another
one that physics would bring (a lag, a ramp, a stiffening), so that the part outside the textbook's varies by
5 to 15 % of what that varies by.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np

from tests.independent.arm6 import AXES, MASS, Array, Build, Day, place, torques


@dataclass(frozen=True)
class Fault:
    """One fault at one place: `apply(state, size)` puts it into the state of the day; `largest` is what would be odd.

    `textbook` is the same fault in the textbook's form, None for one that no catalogue has.
    """

    family: str
    target: str
    largest: float
    apply: Callable[[State, float], None]
    textbook: Fault | None = None


@dataclass
class State:
    """The arm through the day: joint beside its reading [rad], links longer, axes leaning, and the tracker's tale."""

    beside: Array
    grown: Array
    tilt: Array
    told: list[Callable[[Array], Array]] = field(default_factory=list)

    @staticmethod
    def sound(n: int) -> State:
        """Return the state without any fault."""
        return State(np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6, 2)))

    def seen(self, build: Build, day: Day) -> tuple[Array, Array]:
        """Return the readings of the joints (n, 6) and of the tracker (n, 3), without noise."""
        at = place(build, day.angle, self.grown, self.tilt)
        for tale in self.told:
            at = tale(at)
        return day.angle - build.zero - self.beside, at


def off(textbook: Array, other: Array, part: float) -> Array:
    """Return the textbook's form with `other` in it: what is new varies by `part` of what the textbook's varies."""
    base = np.stack([np.ones_like(textbook), textbook], axis=-1)
    new = other - base @ np.linalg.lstsq(base, other, rcond=None)[0]
    size = np.sqrt(np.mean(new**2))
    return textbook if size < 1e-12 else textbook + part * np.std(textbook) * new / size


def lagged(column: Array, clock: Array, tau: float) -> Array:
    """Return a column that follows after, first order, from a start in balance."""
    out = column.copy()
    for k in range(1, len(column)):
        out[k] = out[k - 1] + (column[k] - out[k - 1]) * -np.expm1(-(clock[k] - clock[k - 1]) / tau)
    return out


def known(
    family: str, k: int, build: Build, day: Day, rng: np.random.Generator, teeth: int, *, exact: bool = False
) -> Fault:
    """Return a fault of one of `FAMILIES` at joint or link `k`; `exact`: in the textbook's form."""
    part = rng.uniform(0.05, 0.15) * (not exact)
    target, q, run = AXES[k], day.angle[:, k], day.run
    phase, phase_2 = rng.uniform(0, 2 * np.pi, 2)

    def joint(form: Array, largest: float) -> Fault:
        return Fault(family, target, largest, lambda s, a: _add(s.beside, k, a * form))

    if family == "eccentricity":
        ripple = np.cos(2 * q + phase_2)

        def eccentric(s: State, a: float) -> None:
            exact = np.arctan2(a * np.sin(q - phase), 1 - a * np.cos(q - phase))  # a disc whose centre is off
            s.beside[:, k] += off(exact, ripple, part)

        return Fault(family, target, 3e-3, eccentric)
    if family == "second":
        return joint(off(np.cos(2 * q + phase), np.cos(3 * q + phase_2), part), 1.5e-3)
    if family == "teeth":
        return joint(off(np.cos(teeth * q + phase), np.cos(2 * teeth * q + phase_2), part), 5e-4)
    if family == "compliance":
        true = torques(build, day.angle, day.payload, MASS * rng.uniform(0.95, 1.05, 6))[:, k]
        return joint(off(true / 100, -true * np.abs(true), part), 5e-3)
    if family == "play":
        settled = np.exp(-day.travel[:, k] / 0.15)  # the bristles of a short approach have not come round
        return joint(off(day.came[:, k] / 2, -day.came[:, k] * settled, part), 5e-3)
    if family == "gain":
        return joint(off(q, q**3, part), 3e-3)
    if family == "drift":
        return joint(off(run, np.exp(-run / rng.uniform(0.2, 0.5)), part), 3e-3)
    if family == "slip":
        when, slide = rng.uniform(0.25, 0.75), rng.uniform(0.03, 0.1)
        step = (run >= when).astype(float)
        return joint(off(step, np.clip((run - when) / slide, 0, 1), part), 3e-3)
    if family == "zero":
        late = lagged(day.warmth, day.clock, rng.uniform(0.05, 0.2) * day.clock[-1])
        return joint(off(day.warmth - 293, late, part), 5e-4)
    if family == "lag":
        v = day.speed[:, k]
        return joint(off(v, v * np.abs(v), part), 2e-2)
    if family == "growth":
        late = lagged(day.warmth, day.clock, rng.uniform(0.05, 0.2) * day.clock[-1])
        form = off(day.warmth - 293, late, part)
        return Fault(family, LINKS[k], 2e-4, lambda s, a: _add(s.grown, k, a * form))
    if family == "frame":
        way = rng.normal(size=3)
        moved = off(run, np.exp(-run / 0.3), part)[:, None] * way / np.linalg.norm(way)
        return Fault(family, "tracker", 3.0, lambda s, a: s.told.append(lambda at: at + a * moved))
    if family == "scale":
        reach = np.linalg.norm(place(build, day.angle), axis=1)
        factor = off(reach, reach**2, part) / reach
        return Fault(family, "tracker", 3e-3, lambda s, a: s.told.append(lambda at: at * (1 + a * factor[:, None])))
    raise ValueError(f"family={family!r}: not one of {', '.join(FAMILIES)}")


def foreign(family: str, build: Build, day: Day, rng: np.random.Generator) -> Fault:
    """Return a fault that is in no catalogue."""
    k, other = (int(i) for i in rng.permutation(6)[:2])
    q = day.angle

    def joint(form: Array) -> Fault:
        return Fault(family, AXES[k], 5e-3, lambda s, a: _add(s.beside, k, a * form))

    if family == "wobble":  # a bearing whose balls go round at their own pace: the axis leans to a side that turns
        pace, phase = rng.uniform(2.2, 4.8), rng.uniform(0, 2 * np.pi)
        k = int(rng.integers(0, 4))
        lean = np.stack([np.cos(pace * q[:, k] + phase), np.sin(pace * q[:, k] + phase)], axis=-1)
        return Fault(family, AXES[k], 5e-3, lambda s, a: _add(s.tilt, k, a * lean))
    if family == "coupled":  # the gear of one joint is led through another
        pace = rng.uniform(1.3, 2.7)
        return joint(np.sin(pace * q[:, other] + rng.uniform(0, 2 * np.pi)))
    if family == "wander":  # a zero that wanders: a smooth walk through the day
        walk = np.cumsum(rng.normal(size=400))
        walk = np.convolve(walk, np.hanning(31) / np.hanning(31).sum(), mode="same")
        return joint(np.interp(day.run, np.linspace(0, 1, 400), (walk - walk.mean()) / walk.std()))
    if family == "twist":  # the upper arm twists under what the wrist holds aside
        k = 1
        aside = np.cos(q[:, 1]) * np.sin(q[:, 4]) * (1 + day.payload / 2.5)
        lean = np.stack([aside, np.zeros_like(aside)], axis=-1)
        return Fault(family, AXES[k], 5e-3, lambda s, a: _add(s.tilt, 2, a * lean))
    if family == "air":  # warm air above the floor bends the tracker's beam, up to the low places
        height = place(build, q)[:, 2]
        bend = np.exp(-(height - height.min()) / 300) * (day.warmth - day.warmth.mean())
        up = np.stack([np.zeros_like(bend), np.zeros_like(bend), bend], axis=-1)
        return Fault(family, "tracker", 3.0, lambda s, a: s.told.append(lambda at: at + a * up))
    raise ValueError(f"family={family!r}: not one of {', '.join(FOREIGN)}")


JOINT_FAMILIES = (
    "eccentricity", "second", "teeth", "compliance", "play", "gain", "drift", "slip", "zero", "lag",
)  # fmt: skip
FAMILIES = (*JOINT_FAMILIES, "growth", "frame", "scale")
FOREIGN = ("wobble", "coupled", "wander", "twist", "air")
LINKS = {1: "upper arm", 2: "forearm"}


def drawn(family: str, build: Build, day: Day, rng: np.random.Generator, teeth: int) -> Fault:
    """Return a fault of `family` at a joint or link of chance."""
    if family in FOREIGN:
        return foreign(family, build, day, rng)
    at = int(rng.integers(1, 3)) if family == "growth" else int(rng.integers(0, 6))
    if family == "compliance":
        at = int(rng.integers(1, 5))  # gravity asks nothing of an upright joint, and little of the last
    again = deepcopy(rng)
    fault = known(family, at, build, day, rng, teeth)
    return replace(fault, textbook=known(family, at, build, day, again, teeth, exact=True))


def _add(where: Array, k: int, what: Array) -> None:
    where[:, k] += what
