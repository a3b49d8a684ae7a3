"""Plans of heights and distances, before anything is measured: what `bench design machine=delta plan=...` looks at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from calibench.discrepancy.machines.delta.kinematics import TOWERS
from calibench.discrepancy.model.measured.data import DataError, MeasuredData

PlanName = Literal["heights", "object", "rings", "rich"]
_RINGS: dict[str, tuple[tuple[int, float], ...]] = {
    "heights": ((6, 1.0),),
    "object": ((6, 1.0),),
    "rings": ((6, 0.5), (12, 1.0)),
    "rich": ((6, 0.33), (12, 0.67), (18, 1.0)),
}
_SIDES: dict[str, tuple[float, ...]] = {"heights": (), "object": (0.45,), "rings": (0.45,), "rich": (0.3, 0.6)}
_ANGLES = {"a": 210.0, "b": 330.0, "c": 90.0}  # degrees
_MARGIN = 0.98  # of the rods' length, that a bed may reach


def planned(
    plan: PlanName = "object",
    radius: float = 160.0,
    arm: float = 340.0,
    bed_radius: float = 140.0,
    endstop: float = 400.0,
    sigma_height: float = 0.02,
    sigma_distance: float = 0.05,
) -> MeasuredData:
    """Return the noiseless heights and distances of a nominal delta [mm].

    heights: 7 heights, as firmwares probe. object: these, and the twelve distances of a printed hexagon with spokes.
    rings: 19 heights and 12 distances. rich: 37 and 24. Raises `DataError` for a bed that the rods do not reach.
    """
    if not 0 < radius < arm or not 0 < bed_radius < _MARGIN * arm - radius:
        raise DataError(
            f"plan.bed_radius={bed_radius:g}: rods of {arm:g} mm at a radius of {radius:g} mm do not reach it"
        )
    heights = [(0.0, 0.0), *(_at(share * bed_radius, k / n) for n, share in _RINGS[plan] for k in range(n))]
    pairs: list[tuple[tuple[float, float], tuple[float, float]]] = []
    for share in _SIDES[plan]:
        corners = [_at(share * bed_radius, k / 6) for k in range(6)]
        pairs += [((0.0, 0.0), corner) for corner in corners]
        pairs += [(corners[k], corners[(k + 1) % 6]) for k in range(6)]
    n, m = len(heights), len(pairs)
    first = np.array([*heights, *(one for one, _ in pairs)])
    second = np.array([*heights, *(other for _, other in pairs)])
    columns = {
        "kind": np.array(["height"] * n + ["distance"] * m),
        "height": np.array([0.0] * n + [np.nan] * m),
        "distance": np.array([np.nan] * n + [float(np.hypot(*np.subtract(b, a))) for a, b in pairs]),
    }
    for end, places in (("", first), ("_2", second)):
        for tower in TOWERS:
            angle = np.deg2rad(_ANGLES[tower])
            x, y = places[:, 0] - radius * np.cos(angle), places[:, 1] - radius * np.sin(angle)
            columns[f"travel_{tower}{end}"] = endstop + np.sqrt(arm**2 - radius**2) - np.sqrt(arm**2 - x**2 - y**2)
    printer: Mapping[str, float] = {"radius": radius, "arm": arm, "endstop": endstop, "bed_radius": bed_radius}
    metadata = {
        "machine": "delta", "nominal": dict(printer), "sigma_height": sigma_height, "sigma_distance": sigma_distance,
    }  # fmt: skip
    return MeasuredData(columns, "delta", metadata, plan)


def _at(out: float, turn: float) -> tuple[float, float]:
    return out * float(np.cos(2 * np.pi * turn)), out * float(np.sin(2 * np.pi * turn))
