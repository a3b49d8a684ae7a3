"""An encoder's zero drifts during the run: evenly, along a curve, or along one that settles (forms of one name)."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array

_TERMS = ("even", "bend", "turn")


def _build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "t_s")
    t = formulation.data["t_s"]
    return tuple(_drift(target, float(t.min()), float(np.ptp(t)), _TERMS[:k]) for k in (1, 2, 3))


def _drift(target: str, origin: float, span: float, names: tuple[str, ...]) -> LinearEffect:
    """Return the drift over the run that began at `origin` and took `span` [s]; other rows share that clock."""
    encoder = f"enc_{number(target)}"

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {encoder: _terms((data["t_s"] - origin) / span)[:, : len(names)]}

    def largest(c: Array) -> float:
        """Return the range of the drift over the run, with the sign of its end where it is even."""
        if len(c) == 1:
            return float(c[0])
        return float(np.ptp(_terms(np.linspace(0, 1, 65))[:, : len(c)] @ c))

    units = ("rad",) * len(names)
    return LinearEffect(
        "drift", target, drift.formula, "reading", ("t_s",), names, units, "rad", changes, measure=largest
    )  # fmt: skip


def _terms(s: Array) -> Array:
    """Return the terms at the part s of the run, (n, 3): a line, a parabola and a cubic, none above 1."""
    return np.stack([s, 4 * s * (1 - s), 6 * np.sqrt(3) * s * (1 - s) * (1 - 2 * s)], axis=-1)


drift = EffectFamily(
    "drift", "gpm2002", "The zero of an encoder drifts during the run",
    "enc_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run", "reading",
    ("t_s",), "rad",
    ("joint 1", "joint 2", "joint 3"), _build,
).enter()  # fmt: skip
