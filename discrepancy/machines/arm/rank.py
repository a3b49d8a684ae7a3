"""Choose the parameters of an arm that are calibrated: of similar ones a preferred one is free, the others are held.

Base and tool come first, then zeros, shifts and turns of the joints from the floor on. A number is held if the kept
ones leave less than `_LEAST` of its signature: for parallel axes one shift along them (Hayati), of a placement the turn
about its own axis. A parameter that is dependent on the nominal arm, and is seen only because the real arm differs from
it, is held as well. So is one that the readings tell to `WORST` at best: a fit that is free to say that a wrist leans
by degrees does so, and poses that were not fitted are off by centimetres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibench.core.notes import Code
from calibench.discrepancy.model.measured import MeasuredData
from calibench.problems.arm.gauge import MIDDLE, WORST, told_apart, unexplained, well_told
from calibench.problems.base import Array

_LEAST = 5e-3  # part of a signature: an error of .5 mm, or .5 mrad at a metre, then moves nothing by more than 3 um


def determined_names(
    slopes: Mapping[str, Array], order: Sequence[str], left: Array, units: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of `order` that are kept, and those that are held since the readings tell them too badly.

    `slopes` has name -> (n, m); `left` (n, m) is what the nominal arm leaves, which tells the noise; `units` has the
    unit of each number of a joint. Numbers of base, tool and sockets may be known badly: nobody states them.
    """
    columns = np.stack([np.asarray(slopes[name], dtype=float) for name in order], axis=-1)
    scale = np.ones(left.shape[1])
    for _ in range(2):  # two kinds of readings have each a noise of its own
        rows = (columns / scale[:, None]).reshape(-1, len(order))
        noise = np.median(np.abs(unexplained(rows, (left / scale).ravel()).reshape(left.shape)), axis=0) / MIDDLE
        scale = scale * np.where(noise > 0, noise, 1.0)
    rows = (columns / scale[:, None]).reshape(-1, len(order))
    worst = np.array([_worst(units[name]) if name in units else np.inf for name in order])
    kept = well_told(rows, _LEAST, worst)
    vague = [order[k] for k in told_apart(rows, _LEAST) if k not in kept]
    return tuple(order[k] for k in kept), tuple(vague)


def with_held(data: MeasuredData, vague: Sequence[str]) -> MeasuredData:
    """Return the data with a remark on the numbers that are held since these readings tell them too badly."""
    if not vague:
        return data
    many = len(vague) > 1
    kept, them = ("numbers keep their nominal values", "them") if many else ("a number keeps its nominal value", "it")
    best = f"{WORST:g} mm or {WORST:g} mrad"
    text = (
        f"{kept}, as the poses tell {them} no better than to {best}: {', '.join(map(_told, vague))}; other poses would "
        "(bench design)"
    )
    return data.with_note(Code.UNDETERMINED, text, parameters=list(vague))


def _worst(unit: str) -> float:
    return WORST if unit == "mm" else 1e-3 * WORST


def _told(name: str) -> str:
    """Return a number of a joint in words."""
    kind, _, joint = name.partition("_")
    if kind == "zero":
        return f"zero of {joint}"
    return f"{'turn about' if kind[0] == 'r' else 'shift along'} {kind[-1]} of {joint}"
