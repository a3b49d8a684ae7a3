"""Thermal growth of all links, of those of one leg, or of the base. Growth of everything enlarges the whole machine.

Angles only cannot see that enlargement, so there links that grow and a base that shrinks are the same. With a tracker
the base grows about its middle, or about a point that the data find.

Members follow a thermometer late, by how much nobody states: every cause comes in forms of other time constants.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.signal import lfilter

from calibench.discrepancy.model.data import MeasuredData
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.problems.base import Array

_LEGS = (1, 2, 3)
_THIN = 45.0  # s: thin tubes; each next form is twice as slow, for what lies between differs by less than is seen
_SLOWEST = 0.25  # of the run: what is slower shows no more of its lag than of the start, which nobody knows
_FORMS = 8
_PARTED = "columns x, y: an external tracker sees whether links or base grow"


def _links(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    names = [f"{link}{i}" for i in (_LEGS if target == "all" else (number(target),)) for link in ("la", "lb")]

    def changes(late: float, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        grown = warmth(data, late)
        return {name: (q[name] * grown)[:, None] for name in names}

    family, formula = (links.name, links.formula) if target == "all" else (leg.name, leg.formula)
    twins = ("thermal_base all",) if target == "all" and "x" not in formulation.readings else ()
    return tuple(
        LinearEffect(
            family, target, formula, "link", ("temp_K",), ("alpha",), ("1/K",), "1/K", partial(changes, late), twins
        )
        for late in _times(formulation.data)
    )


def _base(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    tracked = "x" in formulation.readings

    def changes(late: float, wide: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        changed, grown = {}, warmth(data, late)
        for axis, own in (("x", 1), ("y", 2)):
            middle = sum(q[f"{axis}a{i}"] for i in _LEGS) / 3
            for i in _LEGS:
                column = np.zeros((len(data), wide))
                column[:, 0] = (q[f"{axis}a{i}"] - middle) * grown
                if wide > 1:
                    column[:, own] = grown
                changed[f"{axis}a{i}"] = column
        return changed

    def growth(c: Array) -> float:
        return float(c[0])

    names, units = ("alpha", "d_x", "d_y"), ("1/K", "mm/K", "mm/K")
    twins = () if tracked else ("thermal_links all",)
    return tuple(
        LinearEffect(
            "thermal_base", target, base.formula, "base", ("temp_K",), names[:wide], units[:wide], "1/K",
            partial(changes, late, wide), twins, growth,
        )
        for wide in ((1, 3) if tracked else (1,))  # about the middle of the base; about a point that the data find
        for late in _times(formulation.data)
    )  # fmt: skip


def _times(data: MeasuredData) -> tuple[float, ...]:
    """Return the time constants [s] that can be told apart: without a clock none but zero."""
    run = float(np.ptp(data["t_s"])) if data.has("t_s") else 0.0
    ladder = (_THIN * 2**k for k in range(_FORMS))
    return (0.0, *(late for late in ladder if late < _SLOWEST * run))


def warmth(data: MeasuredData, late: float) -> Array:
    """Return the members' temperature above the reference, (n,), K: the thermometer's through a lag of first order.

    `late` is the time constant [s]. Members are taken to be as warm as the thermometer when the rows begin; between
    the rows it is taken to move in a straight line.
    """
    shown = np.asarray(data["temp_K"], dtype=float)
    if not late:
        return shown
    t = np.asarray(data["t_s"], dtype=float)
    order = np.argsort(t, kind="stable")
    even = np.linspace(t[order[0]], t[order[-1]], int(min(np.ptp(t) / late * 10, 200_000)) + 2)
    seen = np.interp(even, t[order], shown[order])
    kept = np.exp(-(even[1] - even[0]) / late)
    middle = np.concatenate([seen[:1], (seen[1:] + seen[:-1]) / 2])
    follows, _ = lfilter([1 - kept], [1.0, -kept], middle - seen[0], zi=[0.0])
    return np.asarray(np.interp(t, even, follows + seen[0]))


links = EffectFamily(
    "thermal_links", "gpm2002", "All links grow with temperature",
    "la_i, lb_i *= 1 + alpha T, i = 1, 2, 3; T follows temp_K", "link", ("temp_K",), "1/K", ("all",), _links,
    "angles only: `thermal_base all`", label="thermal growth", label_of_all="thermal growth of all links",
    parted_by=_PARTED,
).enter()  # fmt: skip
leg = EffectFamily(
    "thermal_leg", "gpm2002", "The links of one leg grow with temperature",
    "la_i, lb_i *= 1 + alpha T; T follows temp_K", "link", ("temp_K",), "1/K", ("leg 1", "leg 2", "leg 3"), _links,
    label="thermal growth",
).enter()  # fmt: skip
base = EffectFamily(
    "thermal_base", "gpm2002", "The base grows with temperature about a point",
    "A_i += (alpha (A_i - mean A) + d) T; T follows temp_K; d = 0 with angles only", "base", ("temp_K",), "1/K",
    ("all",), _base, "angles only: `thermal_links all`", label="thermal growth of the base",
    label_of_all="thermal growth of the base", parted_by=_PARTED,
).enter()  # fmt: skip
