"""Instances of `delta9`: another machine, plan, noise and box for each ``instance=K``. Its data are synthetic.

- *nominal machine*: rods of 220 .. 400 mm, towers at .42 .. .52 of that, a bed that reaches to .8 .. .92 of the towers.
- *true machine*: each of the nine errors is wrong as `problems.instances` says of the *box*, with h = 5 mm for
  endstops and radius, .03 rad for angles and 3 mm for rods, to .001 mm and 1e-6 rad.
- *plan*: a part of one of the named plans: each of its rows stays with a chance uniform in .7 .. 1; at least 18 must.
- *noise* of a height: none, or .002 .. .05 mm; that of a distance is two and a half times as large.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import pi
from typing import Any, final, get_args

import numpy as np

from calibench.problems.delta.plans import Places, PlanName, places
from calibench.problems.instances import Box, Noise, Stream, can_be_identified, first_that_fits

ANGLES = (7 * pi / 6, 11 * pi / 6, pi / 2)  # of the towers, rad: 210, 330 and 90 degrees
WEIGHT = 0.4  # of a distance: a caliper on plastic has two and a half times the noise of a probe
NOISES = (2e-3, 5e-2)  # mm
FINEST = 1e-4  # mm: the readings that an instance without noise is held to
FREE = 9
HALF = (5.0, 5.0, 5.0, 5.0, 0.03, 0.03, 3.0, 3.0, 3.0)
DIGITS = (3, 3, 3, 3, 6, 6, 3, 3, 3)
_FAMILY = "delta9"
_ABOVE = 50.0  # mm: of the carriages at their endstops over where they stand with the nozzle on the bed's middle


@final
@dataclass(frozen=True)
class Machine:
    """A nominal delta [mm]: the towers' radius less the effector's, the rods, and the bed's radius."""

    radius: float = 160.0
    rod: float = 340.0
    bed_radius: float = 140.0

    @property
    def switch(self) -> float:
        """Return the height of the carriages at their endstops [mm]."""
        return float(np.sqrt(self.rod**2 - self.radius**2)) + self.rod + _ABOVE


@final
@dataclass(frozen=True, eq=False)
class DeltaInstance:
    """What ``instance=K`` of `delta9` draws; `attempts` were drawn until one could be identified."""

    machine: Machine
    box: Box
    plan: PlanName
    places: Places
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return {"plan": self.plan, "sigma": self.noise.level, "seed": self.noise.data_seed}


@cache
def delta_instance(instance: int, build: Callable[[DeltaInstance], Any]) -> DeltaInstance:
    """Return the instance; ``build(drawn)`` makes its problem without noise."""
    return first_that_fits(_FAMILY, instance, lambda attempt: _attempt(instance, attempt, build))


def _attempt(instance: int, attempt: int, build: Callable[[DeltaInstance], Any]) -> DeltaInstance | None:
    streams = {thing: Stream.of(_FAMILY, instance, attempt, thing) for thing in ("machine", "box", "plan", "noise")}
    of = streams["machine"]
    rod = round(of.between(220.0, 400.0), 1)
    radius = round(rod * of.between(0.42, 0.52), 1)
    machine = Machine(radius, rod, round(radius * of.between(0.8, 0.92), 0))
    box = Box.drawn(streams["box"], np.zeros(FREE), np.array(HALF), DIGITS)
    name: PlanName = streams["plan"].one_of(get_args(PlanName))
    chance = streams["plan"].between(0.7, 1)
    whole = places(name, machine.bed_radius)
    kept = np.array([k for k in range(len(whole)) if streams["plan"].between(0, 1) < chance], dtype=np.int64)
    if len(kept) < 2 * FREE:
        return None
    noise = Noise.drawn(streams["noise"], *NOISES)
    drawn = DeltaInstance(machine, box, name, whole.some(kept), noise, attempt + 1)
    problem = build(drawn)
    if not np.isfinite(problem.measured).all():
        return None
    return drawn if can_be_identified(problem, FREE, drawn.noise.level) else None
