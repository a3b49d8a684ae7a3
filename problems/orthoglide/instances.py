"""Instances of `orthoglide6`: another machine, plan, noise and box for each ``instance=K``. Its data are synthetic.

- *true machine*: the errors that are free are wrong as `problems.instances` says of the *box*, with h = 5 mm about the
  nominal machine, to .001 mm; those that are held are zero.
- *plan*: a part of one of the named plans (`named_plan`): each of its readings stays with a chance uniform in .6 .. 1,
  and at least twice as many as parameters must stay.
- *noise* of a gauge reading: none, or .001 .. .02 mm. What is read once at Zero is shared, as eq. (13) has it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, final, get_args

import numpy as np

from calibench.problems.instances import Box, Noise, Stream, can_be_identified, first_that_fits
from calibench.problems.orthoglide.plans import Plan, PlanName, named_plan

NOISES = (1e-3, 2e-2)  # mm
FINEST = 1e-4  # mm: the readings that an instance without noise is held to
_FAMILY = "orthoglide6"
_HALF, _DIGITS = 5.0, 3  # mm


@final
@dataclass(frozen=True, eq=False)
class OrthoglideInstance:
    """What ``instance=K`` of `orthoglide6` draws; `attempts` were drawn until one could be identified.

    `readings` are those of the named `plan` that are taken.
    """

    box: Box
    plan: PlanName
    readings: Plan
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return {"data": "synthetic", "plan": self.plan, "sigma": self.noise.level, "seed": self.noise.data_seed}


@cache
def orthoglide_instance(free: tuple[str, ...], instance: int, build: Callable[..., Any]) -> OrthoglideInstance:
    """Return the instance whose free errors are `free`; ``build(free, drawn)`` makes its problem without noise."""
    return first_that_fits(_FAMILY, instance, lambda attempt: _attempt(free, instance, attempt, build))


def _attempt(
    free: tuple[str, ...], instance: int, attempt: int, build: Callable[..., Any]
) -> OrthoglideInstance | None:
    streams = {thing: Stream.of(_FAMILY, instance, attempt, thing) for thing in ("box", "plan", "noise")}
    every = np.zeros(6)
    box = Box.drawn(streams["box"], every, np.full(6, _HALF), [_DIGITS] * 6)
    name: PlanName = streams["plan"].one_of(get_args(PlanName))
    chance = streams["plan"].between(0.6, 1)
    readings = tuple(reading for reading in named_plan(name) if streams["plan"].between(0, 1) < chance)
    if len(readings) < 2 * len(free):
        return None
    drawn = OrthoglideInstance(box, name, readings, Noise.drawn(streams["noise"], *NOISES), attempt + 1)
    problem = build(free, drawn)
    if not np.isfinite(problem.deviations).all():
        return None
    return drawn if can_be_identified(problem, len(free), drawn.noise.level) else None
