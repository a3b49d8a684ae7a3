"""Where the error is: by region of the workspace, and by the range of each joint, before and after."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calibench.bench.calibration.judged import rms
from calibench.bench.calibration.readings import Mask
from calibench.bench.calibration.report.result import Drawn, Part
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.base import Array

_FEWEST = 5  # fewest poses of a part that is reported
_RANGES = 4


def by_region(drawn: Drawn) -> tuple[Part, ...]:
    """Return the error by distance from the base's axis and by height, thirds of the poses each."""
    out = np.hypot(drawn.position[:, 0], drawn.position[:, 1])
    up = drawn.position[:, 2]
    found = []
    for far, high in np.ndindex(3, 3):
        there = _third(out, far) & _third(up, high)
        words = f"{_range(out, far)} mm out, {_range(up, high)} mm up"
        found.append(_part(words, drawn, there))
    return tuple(part for part in found if part.poses >= _FEWEST)


def by_joint(drawn: Drawn, chain: Chain) -> tuple[Part, ...]:
    """Return the error by the range of each joint, four ranges of as many poses."""
    kinds = {joint.name: joint.kind for joint in chain.joints}
    found = []
    for k, name in enumerate(drawn.names):
        values = drawn.joints[:, k]
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _RANGES + 1)))
        turn = kinds.get(name, "rotary") == "rotary"
        for low, high in pairwise(edges):
            there = (values >= low) & ((values < high) | (high == edges[-1]))
            ends = (np.rad2deg(low), np.rad2deg(high)) if turn else (low, high)
            found.append(_part(f"{name} {ends[0]:.0f} to {ends[1]:.0f} {'°' if turn else 'mm'}", drawn, there))
    return tuple(part for part in found if part.poses >= _FEWEST)


def _part(words: str, drawn: Drawn, there: Mask) -> Part:
    known = there & np.isfinite(drawn.before) & np.isfinite(drawn.after)
    return Part(words, int(known.sum()), rms(drawn.before[known]), rms(drawn.after[known]))


def _third(values: Array, k: int) -> Mask:
    low, high = np.quantile(values, [k / 3, (k + 1) / 3])
    return np.asarray((values >= low) & ((values < high) | (k == 2)))


def _range(values: Array, k: int) -> str:
    low, high = np.quantile(values, [k / 3, (k + 1) / 3])
    return f"{low:.0f} to {high:.0f}"
