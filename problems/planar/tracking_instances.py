"""Instances of `tracking_zero`: another machine, reference point, path, noise and box for each ``instance=K``.

- *machine*: as the nominal machine of `planar.instances`, and it is known: the geometry is no unknown here.
- *path*: as the plan there, its centre being the reference point O; n poses from 9.
- *box*: as `problems.instances` says, with h = 10 mm about a start uniform in -10 .. 10 mm. The truth is not (0, 0): dx
  and dy are measured from a mark beside O, so that a method which favours the origin gains nothing.
- *noise* of a recorded reading: none, or 1e-6 .. 3e-4 rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, final

import numpy as np

from calibench.problems.base import Array
from calibench.problems.instances import Box, Noise, Stream, can_be_identified, first_that_fits
from calibench.problems.planar.instances import NOISES, DrawnPlan, decided, nominal_machine, within_reach

_FAMILY = "tracking_zero"
_FEWEST_POSES = 9
_HALF = np.array([10.0, 10.0])  # mm


@final
@dataclass(frozen=True, eq=False)
class TrackingInstance:
    """What ``instance=K`` of `tracking_zero` draws; `attempts` were drawn until one could be identified."""

    instance: int
    machine: Array
    start: Array
    box: Box
    plan: DrawnPlan
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return decided(self.plan, self.noise)


@cache
def tracking_instance(instance: int) -> TrackingInstance:
    """Return the instance of this number."""
    return first_that_fits(_FAMILY, instance, lambda attempt: _attempt(instance, attempt))


def _attempt(instance: int, attempt: int) -> TrackingInstance | None:
    from calibench.problems.planar.tracking import tracked  # here, as that module asks for instances

    streams = {thing: Stream.of(_FAMILY, instance, attempt, thing) for thing in ("machine", "box", "plan", "noise")}
    machine = nominal_machine(streams["machine"])
    start = np.array([round(streams["box"].between(-10, 10), 3) for _ in "xy"])
    box = Box.drawn(streams["box"], start, _HALF, (3, 3))
    plan, noise = DrawnPlan.drawn(streams["plan"], _FEWEST_POSES), Noise.drawn(streams["noise"], *NOISES)
    drawn = TrackingInstance(instance, machine, start, box, plan, noise, attempt + 1)
    points, _ = plan.points(noise.data_seed)
    if not within_reach(machine, points):
        return None
    return drawn if can_be_identified(tracked(drawn, quiet=True), len(start), noise.level) else None
