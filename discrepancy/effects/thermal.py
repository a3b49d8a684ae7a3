"""What warmth does: all links grow, those of one leg, or the base. Growth of everything is the machine enlarged.

Angles only cannot see that enlargement, so there links that grow and a base that shrinks are the same. With a tracker
the base grows about a point that the data find.
"""

from __future__ import annotations

import numpy as np

from discrepancy.data import MeasuredData
from discrepancy.effect import Effect
from discrepancy.family import Cause, needs, number
from discrepancy.linear import Linear
from discrepancy.machine import Formulation, Quantities
from problems.base import Array

_LEGS = (1, 2, 3)


def _links(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    names = [f"{link}{i}" for i in (_LEGS if target == "all" else (number(target),)) for link in ("la", "lb")]

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: (q[name] * data["temp_K"])[:, None] for name in names}

    family, formula = (links.name, links.formula) if target == "all" else (leg.name, leg.formula)
    twins = ("thermal_base all",) if target == "all" and "x" not in formulation.readings else ()
    return (Linear(family, target, formula, "link", ("temp_K",), ("alpha",), ("1/K",), "1/K", changes, twins),)


def _base(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    tracked = "x" in formulation.readings
    names = ("alpha", "d_x", "d_y") if tracked else ("alpha",)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        changed = {}
        for axis, own in (("x", 1), ("y", 2)):
            middle = sum(q[f"{axis}a{i}"] for i in _LEGS) / 3
            for i in _LEGS:
                column = np.zeros((len(data), len(names)))
                column[:, 0] = (q[f"{axis}a{i}"] - middle) * data["temp_K"]
                if tracked:
                    column[:, own] = data["temp_K"]
                changed[f"{axis}a{i}"] = column
        return changed

    def growth(c: Array) -> float:
        return float(c[0])

    units = ("1/K", "mm/K", "mm/K")[: len(names)]
    twins = () if tracked else ("thermal_links all",)
    return (
        Linear("thermal_base", target, base.formula, "base", ("temp_K",), names, units, "1/K", changes, twins, growth),
    )


links = Cause(
    "thermal_links", "gpm2002", "All links grow with temperature", "la_i, lb_i *= 1 + alpha temp_K, i = 1, 2, 3",
    "link", ("temp_K",), "1/K", ("all",), _links, "angles only: `thermal_base all`",
).enter()  # fmt: skip
leg = Cause(
    "thermal_leg", "gpm2002", "The links of one leg grow with temperature", "la_i, lb_i *= 1 + alpha temp_K", "link",
    ("temp_K",), "1/K", ("leg 1", "leg 2", "leg 3"), _links,
).enter()  # fmt: skip
base = Cause(
    "thermal_base", "gpm2002", "The base grows with temperature about a point",
    "A_i += (alpha (A_i - mean A) + d) temp_K; d = 0 with angles only", "base", ("temp_K",), "1/K", ("all",), _base,
    "angles only: `thermal_links all`",
).enter()  # fmt: skip
