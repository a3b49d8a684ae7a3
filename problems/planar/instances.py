"""Instances of the GPM2002's families: another machine, plan, noise and box for each ``instance=K``.

- *nominal machine*: A_1 as printed, as it is where coordinates begin; each other base coordinate within 15 mm of the
  maker's, each link within 10 mm, uniform; offsets uniform in -1.5 .. 1.5 rad. Lengths to .001 mm, angles to 1e-5 rad.
- *true machine*: the nominal one, and the free parameters wrong as `problems.instances` says of the *box*, with h = 5
  mm and .2 rad (Table 5). What a family holds is known, so it is true.
- *plan*: its kind is one of `plan_points`; its centre up to 30 mm from home, uniform over the disc; its radius uniform
  in 50 .. 120 mm, to .1 mm; n poses, log-uniform between twice the number of parameters (at least 9) and 80, for a grid
  brought down to a multiple of 3.
- *noise* of a reading: none, or 1e-6 .. 3e-4 rad.

Drawn again where a pose is not at least 10 mm within the reach of every leg, of the true and of the nominal machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, final, get_args

import numpy as np

from calibench.core.same_bits import cos, sin
from calibench.problems.base import Array, frozen
from calibench.problems.instances import Box, Noise, Stream, can_be_identified, first_that_fits
from calibench.problems.planar.gpm2002 import (
    NAMES,
    UNITS,
    PlanName,
    Setting,
    home,
    makers_machine,
    plan_points,
    section4,
)

NOISES = (1e-6, 3e-4)  # rad
FINEST = 1e-6  # rad: the readings that an instance without noise is held to
_MOST_POSES, _FEWEST_POSES = 80, 9
_MARGIN = 10.0  # mm
_DIGITS = [5 if unit == "rad" else 3 for unit in UNITS]


@final
@dataclass(frozen=True, eq=False)
class DrawnPlan:
    """The poses: `kind` of `plan_points` with n of them, within `radius` of `centre`, shape (2,), mm."""

    kind: PlanName
    radius: float
    n: int
    centre: Array

    def points(self, data_seed: int) -> tuple[Array, np.random.Generator]:
        """Return the end-effectors, shape (n, 2), mm, and the generator of the readings' noise."""
        where, shake = (np.random.default_rng(s) for s in np.random.SeedSequence(data_seed).spawn(2))
        return plan_points(self.kind, self.centre, self.radius, self.n, where), shake

    @staticmethod
    def drawn(stream: Stream, fewest: int) -> DrawnPlan:
        """Draw a plan of at least `fewest` poses."""
        kind: PlanName = stream.one_of(get_args(PlanName))
        n = round(stream.log_between(fewest, _MOST_POSES))
        away, angle = 30 * stream.between(0, 1) ** 0.5, stream.between(0, 2 * np.pi)
        centre = home() + np.round(away * np.array([cos(angle), sin(angle)]), 3)
        radius = round(stream.between(50, 120), 1)
        return DrawnPlan(kind, radius, 3 * (n // 3) if kind == "grid" else n, frozen(centre))


def decided(plan: DrawnPlan, noise: Noise) -> dict[str, Any]:
    """Return which options of a family follow from a drawn plan and noise, and their values."""
    return {"plan": plan.kind, "radius": plan.radius, "n": plan.n, "noise": noise.level, "data_seed": noise.data_seed}


@final
@dataclass(frozen=True, eq=False)
class PlanarInstance:
    """What ``instance=K`` of a planar family draws; `attempts` were drawn until one could be identified."""

    setting: Setting
    plan: DrawnPlan
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return decided(self.plan, self.noise)


@cache
def planar_instance(family: str, free: tuple[str, ...], rank: int, instance: int) -> PlanarInstance:
    """Return the instance of a family whose free parameters are `free`, of which readings can see `rank`."""
    return first_that_fits(family, instance, lambda attempt: _attempt(family, free, rank, instance, attempt))


def nominal_machine(stream: Stream) -> Array:
    """Draw a nominal machine, shape (15,)."""
    machine = makers_machine()
    for i in range(len(NAMES)):
        spread = (15.0 if i < 6 else 10.0) if i < 12 else 1.5
        moved = stream.between(-spread, spread)  # drawn for A_1 too, so that all keep their places in the stream
        machine[i] = round(machine[i] + (moved if i > 1 else 0.0), _DIGITS[i])
    return machine


def within_reach(machine: Array, points: Array) -> bool:
    """Tell whether every leg reaches every point, shape (n, 2), with room to spare."""
    for i in range(3):
        reach = np.hypot(points[:, 0] - machine[2 * i], points[:, 1] - machine[2 * i + 1])
        la, lb = machine[6 + i], machine[9 + i]
        if reach.max() > la + lb - _MARGIN or reach.min() < abs(la - lb) + _MARGIN:
            return False
    return True


def _attempt(family: str, free: tuple[str, ...], rank: int, instance: int, attempt: int) -> PlanarInstance | None:
    from calibench.problems.planar.calibration import simulated  # here, as that module asks for instances

    streams = {thing: Stream.of(family, instance, attempt, thing) for thing in ("machine", "box", "plan", "noise")}
    nominal = nominal_machine(streams["machine"])
    table5 = section4()
    half = np.where(np.array(UNITS) == "rad", (table5.upper - table5.lower)[12] / 2, 5.0)
    box = Box.drawn(streams["box"], nominal, half, _DIGITS)
    actual = np.where([name in free for name in NAMES], box.truth, nominal)
    setting = Setting(actual, nominal, nominal, box.lower, box.upper)
    plan = DrawnPlan.drawn(streams["plan"], max(_FEWEST_POSES, 2 * len(free)))
    noise = Noise.drawn(streams["noise"], *NOISES)
    drawn = PlanarInstance(setting, plan, noise, attempt + 1)
    points, _ = plan.points(noise.data_seed)
    if not (within_reach(actual, points) and within_reach(nominal, points)):
        return None
    quiet = replace(drawn, noise=replace(noise, level=0.0))
    return drawn if can_be_identified(simulated(family, free, quiet), rank, noise.level) else None
