"""J3's search coordinates: l_a cos z and l_a sin z in place of l_a and z, eq. (44) inverted (Cong et al. 2008)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calibench.problems.base import Parameter


def cartesian_coordinates(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return J3's search coordinates: l_a becomes l_a cos z (lac) and z becomes l_a sin z (las), eq. (44) inverted.

    Their box is the bounding box of the sector that the box of (l_a, z) cuts.
    """
    by_name = {p.name: p for p in parameters}
    swapped = []
    for p in parameters:
        if not p.name.startswith(("la", "z")):
            swapped.append(p)
            continue
        la, z = by_name["la" + p.name[-1]], by_name["z" + p.name[-1]]
        side = np.cos if p.name.startswith("la") else np.sin
        low, high = _range_of(side, z.lower, z.upper)
        corners = [radius * trig for radius in (la.lower, la.upper) for trig in (low, high)]
        true = None if la.true is None or z.true is None else la.true * float(side(z.true))
        name = ("lac" if side is np.cos else "las") + p.name[-1]
        swapped.append(Parameter(name, "mm", la.start * float(side(z.start)), min(corners), max(corners), true))
    return tuple(swapped)


def _range_of(side: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Return the least and largest value of cos or sin between two angles."""
    quarter = np.pi / 2
    turns = [k * quarter for k in range(int(np.ceil(low / quarter)), int(np.floor(high / quarter)) + 1)]
    values = [float(side(angle)) for angle in (low, high, *turns)]
    return min(values), max(values)
