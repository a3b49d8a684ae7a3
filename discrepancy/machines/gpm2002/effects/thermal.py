"""Thermal growth of all links, of those of one leg, or of the base. Growth of everything enlarges the whole machine.

Angles only cannot see that enlargement, so there links that grow and a base that shrinks are the same. With a tracker
the base grows about its middle, or about a point that the data find.

Members follow a thermometer late, by how much nobody states: every cause comes in forms of other time constants.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from calibench.discrepancy.effects.general import lengths
from calibench.discrepancy.effects.general.lengths import grown
from calibench.discrepancy.effects.general.recipe import Built, Recipe
from calibench.discrepancy.effects.general.warmth import time_constants, warmth
from calibench.discrepancy.machines.gpm2002.roles import LEGS
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array

_PARTED = "columns x, y: an external tracker sees whether links or base grow"


def _links(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    needs(formulation.data, "temp_K")
    legs = LEGS if target == "all" else (target,)
    heat = {f"{link}{number(leg)}": "temp_K" for leg in legs for link in ("la", "lb")}
    return grown(family, target, heat, formulation.data, "t_s")


def _twins(formulation: Formulation, target: str) -> tuple[str, ...]:
    return () if "x" in formulation.readings else ("thermal_base all",)


def _base(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    tracked = "x" in formulation.readings

    def changes(late: float, wide: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        changed, heat = {}, warmth(data, late, "temp_K", "t_s", formulation.data)
        for axis, own in (("x", 1), ("y", 2)):
            middle = sum(q[f"{axis}a{i}"] for i in (1, 2, 3)) / 3
            for i in (1, 2, 3):
                column = np.zeros((len(data), wide))
                column[:, 0] = (q[f"{axis}a{i}"] - middle) * heat
                if wide > 1:
                    column[:, own] = heat
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
        for late in time_constants(formulation.data, "t_s")
    )  # fmt: skip


_GROWTH = Recipe(lengths.growth.words, _links)
links = _GROWTH.enter(
    "gpm2002", ("all",), _twins, name="thermal_links", cause="All links grow with temperature",
    formula="la_i, lb_i *= 1 + alpha T, i = 1, 2, 3; T follows temp_K", columns=("temp_K",),
    twins="angles only: `thermal_base all`", label_of_all="thermal growth of all links", parted_by=_PARTED,
)  # fmt: skip
leg = _GROWTH.enter(
    "gpm2002", LEGS, name="thermal_leg", cause="The links of one leg grow with temperature",
    formula="la_i, lb_i *= 1 + alpha T; T follows temp_K", columns=("temp_K",), label_of_all="",
)  # fmt: skip
base = EffectFamily(
    "thermal_base", "gpm2002", "The base grows with temperature about a point",
    "A_i += (alpha (A_i - mean A) + d) T; T follows temp_K; d = 0 with angles only", "base", ("temp_K",), "1/K",
    ("all",), _base, "angles only: `thermal_links all`", label="thermal growth of the base",
    label_of_all="thermal growth of the base", parted_by=_PARTED,
).enter()  # fmt: skip
