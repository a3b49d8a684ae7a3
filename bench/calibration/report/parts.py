"""Where the error is: by region of the workspace, and by the range of each joint, before and after."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calibench.bench.calibration.judged import rms
from calibench.bench.calibration.readings import Mask
from calibench.bench.calibration.report.result import Drawn, OverJoint, Part
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.base import Array

_FEWEST = 5  # fewest poses of a part that is reported
_RANGES = 4
_DRAWN = 12  # ranges of a joint in a drawing


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


def drawn_of(joints: Array, chain: Chain, position: Array, before: Array, after: Array) -> Drawn:
    """Return what the drawings need of `joints`, (n, j) [rad or mm]: the angles in degrees."""
    kinds = {joint.name: joint.kind for joint in chain.joints}
    turns = np.array([kinds.get(name, "rotary") == "rotary" for name in chain.driven])
    units = tuple("°" if turn else "mm" for turn in turns)
    return Drawn(np.where(turns, np.rad2deg(joints), joints), chain.driven, units, position, before, after)


def by_joint(drawn: Drawn) -> tuple[Part, ...]:
    """Return the error by the range of each joint, four ranges of as many poses."""
    found = []
    for k, name in enumerate(drawn.names):
        values = drawn.joints[:, k]
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _RANGES + 1)))
        for low, high in pairwise(edges):
            there = (values >= low) & ((values < high) | (high == edges[-1]))
            found.append(_part(f"{name} {low:.0f} to {high:.0f} {drawn.units[k]}", drawn, there))
    return tuple(part for part in found if part.poses >= _FEWEST)


def over_joints(drawn: Drawn) -> tuple[OverJoint, ...]:
    """Return the error over the place of each joint, in ranges of as many poses: what is drawn of it."""
    known = np.isfinite(drawn.before) & np.isfinite(drawn.after)
    before, after = drawn.before[known], drawn.after[known]
    found = []
    for name, unit, values in zip(drawn.names, drawn.units, drawn.joints[known].T):
        for part in np.array_split(np.argsort(values, kind="stable"), min(_DRAWN, max(1, len(values) // _FEWEST))):
            if len(part):
                own = values[part]
                place = (float(own.mean()), float(own.min()), float(own.max()))
                found.append(OverJoint(name, unit, *place, rms(before[part]), rms(after[part]), len(part)))
    return tuple(found)


def _part(words: str, drawn: Drawn, there: Mask) -> Part:
    known = there & np.isfinite(drawn.before) & np.isfinite(drawn.after)
    return Part(words, int(known.sum()), rms(drawn.before[known]), rms(drawn.after[known]))


def _third(values: Array, k: int) -> Mask:
    low, high = np.quantile(values, [k / 3, (k + 1) / 3])
    return np.asarray((values >= low) & ((values < high) | (k == 2)))


def _range(values: Array, k: int) -> str:
    low, high = np.quantile(values, [k / 3, (k + 1) / 3])
    return f"{low:.0f} to {high:.0f}"
