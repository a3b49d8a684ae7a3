"""All hidden effects by name, in the words of the reports; and how one is drawn on a joint, a leg or a base."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.blind.gpm2002 import encoder_effects as encoders, foreign_effects as foreign, member_effects as members
from benchmarks.blind.gpm2002.design import Plan
from benchmarks.blind.gpm2002.effect import Effect

Maker = Callable[[int, Plan, np.random.Generator], Effect]

CATALOGUE: dict[str, Maker] = {
    f.__name__: f
    for f in (
        encoders.eccentricity, encoders.second_harmonic, encoders.angle_error, encoders.gear, encoders.slip,
        encoders.drift, encoders.quantisation, encoders.outlier, encoders.heavy_tails, encoders.backlash,
        encoders.lag, encoders.tracker_lag, members.compliance, members.proximal_bending, members.axial_compliance,
        members.clearance, members.thermal_links, members.thermal_leg, members.thermal_base, members.base_shift,
    )
}  # fmt: skip
FOREIGN: dict[str, Maker] = {
    f.__name__: f
    for f in (
        foreign.bump, foreign.magnet, foreign.warm_bow, foreign.crosstalk, foreign.speed_squared, foreign.heading_tilt,
        foreign.hum, foreign.elbow_bearing, foreign.plane_tilt, foreign.load_squared, foreign.memory,
    )
}  # fmt: skip
KNOWN = (*CATALOGUE, "cyclic")
TWINS = (frozenset({"compliance", "proximal_bending"}), frozenset({"thermal_links", "thermal_base"}))
DISTURBED = frozenset({"quantisation", "outlier", "heavy_tails"})  # these look like noise: not two of them at once


def make(family: str, i: int, plan: Plan, teeth: tuple[int, int, int], rng: np.random.Generator) -> Effect:
    """Draw one effect of `family` on leg i (0-2), with its phases, times and shapes.

    Raises `ValueError` for a family that is neither known nor foreign.
    """
    if family == "cyclic":
        return encoders.cyclic(i, plan, rng, teeth[i])
    maker = CATALOGUE.get(family) or FOREIGN.get(family)
    if maker is None:
        raise ValueError(f"family={family!r}: not one of {', '.join([*KNOWN, *FOREIGN])}")
    return maker(i, plan, rng)


def compatible(first: Effect, second: Effect) -> bool:
    """Return whether two effects can be asked for together: different causes, and not exact twins of each other."""
    pair = {first.family, second.family}
    return len(pair) == 2 and not any(pair == twin for twin in TWINS) and not pair <= DISTURBED
