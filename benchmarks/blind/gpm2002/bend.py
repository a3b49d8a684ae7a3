"""Forms that no catalogue has to the letter: an effect whose size goes up and down with the pose, the load or the time.

What an effect does is multiplied by 1 + share * sqrt(2) sin(k x + phase), x the angle of the joint, the force in the
member, or the part of the run, k a whole number of waves drawn from 1 to 3: its rms departure from its own formula is
`share` of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.blind.gpm2002.effect import Effect
from benchmarks.blind.gpm2002.machine import Array

SHARES = (0.05, 0.15)  # between which a share is drawn where none is asked for


def bent(effect: Effect, share: float, rng: np.random.Generator) -> Effect:
    """Return the effect with a form that is off by the rms `share`; coarse steps have no other form."""
    waves, phase = int(rng.integers(1, 4)), rng.uniform(-np.pi, np.pi)

    def size(x: Array) -> Array:
        return 1 + share * np.sqrt(2) * np.sin(waves * x + phase)

    body, read, see = effect.body, effect.read, effect.see
    return replace(
        effect,
        body=body and (lambda a, plan, machine: body(a, plan, machine) * size(np.pi * plan.phase)[:, None]),
        windup=_forced(effect.windup, size),
        stretch=_forced(effect.stretch, size),
        read=read and (lambda a, s: read(a, s) * size(s.still.motor_angles)),
        see=see and (lambda a, s: see(a, s) * size(s.plan.heading)[:, None]),
    )


def _forced(
    part: Callable[[float, Array], Array] | None, size: Callable[[Array], Array]
) -> Callable[[float, Array], Array] | None:
    """Return a part whose size goes with the force in the member, in waves over twice its largest."""
    if part is None:
        return None
    return lambda a, force: part(a, force) * size(np.pi * force / max(float(np.abs(force).max()), 1e-9))
