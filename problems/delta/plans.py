"""The places where a delta is measured: on the bed that the probe touches, and in pairs on a printed object.

The object is a hexagon with spokes, as firmwares propose it: six distances from its middle to its corners, and its six
sides. Lengths are shares of the bed's radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin
from typing import Literal, final, get_args

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest
from calibench.problems.base import Array

Index = NDArray[np.int64]

PlanName = Literal["object", "rings", "rich"]
_RINGS: dict[str, tuple[tuple[int, float], ...]] = {
    "object": ((6, 0.97),),
    "rings": ((6, 0.5), (12, 0.97)),
    "rich": ((6, 0.33), (12, 0.65), (18, 0.97)),
}
_SIDES: dict[str, tuple[float, ...]] = {"object": (0.45,), "rings": (0.45,), "rich": (0.3, 0.6)}
_TOP = 1.0  # mm: what a caliper holds of an object


@final
@dataclass(frozen=True, eq=False)
class Places:
    """The nozzle's places [mm]: `first` and `second`, (m, 3), and `between`, (m,): 0 for a height, 1 for a distance."""

    first: Array
    second: Array
    between: Index

    def __len__(self) -> int:
        return len(self.between)

    def some(self, kept: Index) -> Places:
        """Return the rows at indices `kept`."""
        return Places(self.first[kept], self.second[kept], self.between[kept])


def places(name: str, bed_radius: float) -> Places:
    """Return the places of a named plan on a bed of `bed_radius` mm; raise `ValueError` that lists the names.

    object: 7 heights, 12 distances. rings: 19 heights, 12 distances. rich: 37 heights, 24 distances.
    """
    if name not in get_args(PlanName):
        raise ValueError(f"delta9.plan={name}: {suggest(name, get_args(PlanName))}")
    heights = [(0.0, 0.0, 0.0)]
    heights += [_at(share * bed_radius, k / n, 0.0) for n, share in _RINGS[name] for k in range(n)]
    pairs: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
    for share in _SIDES[name]:
        corners = [_at(share * bed_radius, k / 6, _TOP) for k in range(6)]
        pairs += [((0.0, 0.0, _TOP), corner) for corner in corners]
        pairs += [(corners[k], corners[(k + 1) % 6]) for k in range(6)]
    first = np.array([*heights, *(a for a, _ in pairs)])
    second = np.array([*heights, *(b for _, b in pairs)])
    return Places(first, second, np.array([0] * len(heights) + [1] * len(pairs), dtype=np.int64))


def travels(points: Array, radius: float, rod: float, switch: float, angles: Array) -> Array:
    """Return how far below `switch` the nominal machine brings its carriages, (m, 3), for nozzle `points`, (m, 3)."""
    x = points[:, :1] - radius * np.cos(angles)
    y = points[:, 1:2] - radius * np.sin(angles)
    return np.asarray(switch - points[:, 2:] - np.sqrt(rod**2 - x**2 - y**2))


def _at(out: float, turn: float, z: float) -> tuple[float, float, float]:
    return out * cos(2 * pi * turn), out * sin(2 * pi * turn), z
