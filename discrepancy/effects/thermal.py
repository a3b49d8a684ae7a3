"""What warmth does: all links grow, those of one leg, or the base. Growth of everything is the machine enlarged.

Angles only cannot see that enlargement, so there links that grow and a base that shrinks are the same. With a tracker
the base grows about a point that the data find.

A member is seldom as warm as the thermometer says: it follows, by a lag of first order. Each cause is tried without and
with a few lags, and pays for the choice as a change point pays for its place.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from discrepancy.data import MeasuredData
from discrepancy.effect import Effect
from discrepancy.family import Cause, needs, number
from discrepancy.linear import Linear
from discrepancy.machine import Formulation, Quantities
from problems.base import Array

_LEGS = (1, 2, 3)
_LAGS = (15.0, 30.0, 60.0, 120.0, 300.0, 900.0)  # s
_SHORT = 0.3  # of a run: a longer lag cannot be told from growth with time

Warmth = Callable[[MeasuredData], Array]


def _warmths(data: MeasuredData) -> list[tuple[str, Warmth, int]]:
    """Return (name, rows -> warmth (n,) [K], positions) without lag, and for each lag short against the run."""
    plain: list[tuple[str, Warmth, int]] = [("temp_K", lambda rows: rows["temp_K"], 1)]
    if "t_s" not in data:
        return plain
    lags = [lag for lag in _LAGS if lag < _SHORT * np.ptp(data["t_s"])]
    return plain + [(f"temp_K({lag:g} s late)", late(data, lag), 1 + len(lags)) for lag in lags]


def late(data: MeasuredData, lag: float) -> Warmth:
    """Return rows -> warmth (n,) of a member that follows the thermometer of the whole run by `lag` [s]."""
    times, first = np.unique(data["t_s"], return_index=True)
    seen = np.asarray(data["temp_K"], dtype=float)[first]
    felt = seen.copy()
    for k, kept in enumerate(np.exp(-np.diff(times) / lag)):
        felt[k + 1] = kept * felt[k] + (1 - kept) * seen[k + 1]
    return lambda rows: np.interp(rows["t_s"], times, felt)


def _links(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    names = [f"{link}{i}" for i in (_LEGS if target == "all" else (number(target),)) for link in ("la", "lb")]

    def growth(warmth: Warmth) -> Callable[[Quantities, MeasuredData], dict[str, Array]]:
        return lambda q, data: {name: (q[name] * warmth(data))[:, None] for name in names}

    family, formula = (links.name, links.formula) if target == "all" else (leg.name, leg.formula)
    twins = ("thermal_base all",) if target == "all" and "x" not in formulation.readings else ()
    return tuple(
        Linear(family, target, formula.replace("temp_K", felt), "link", ("temp_K",), ("alpha",), ("1/K",), "1/K",
               growth(warmth), twins, positions=positions)
        for felt, warmth, positions in _warmths(formulation.data)
    )  # fmt: skip


def _base(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    tracked = "x" in formulation.readings
    names = ("alpha", "d_x", "d_y") if tracked else ("alpha",)

    def growth(warmth: Warmth) -> Callable[[Quantities, MeasuredData], dict[str, Array]]:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            changed, warm = {}, warmth(data)
            for axis, own in (("x", 1), ("y", 2)):
                middle = sum(q[f"{axis}a{i}"] for i in _LEGS) / 3
                for i in _LEGS:
                    column = np.zeros((len(data), len(names)))
                    column[:, 0] = (q[f"{axis}a{i}"] - middle) * warm
                    if tracked:
                        column[:, own] = warm
                    changed[f"{axis}a{i}"] = column
            return changed

        return changes

    def rate(c: Array) -> float:
        return float(c[0])

    units = ("1/K", "mm/K", "mm/K")[: len(names)]
    twins = () if tracked else ("thermal_links all",)
    return tuple(
        Linear("thermal_base", target, base.formula.replace("temp_K", felt), "base", ("temp_K",), names, units, "1/K",
               growth(warmth), twins, rate, positions)
        for felt, warmth, positions in _warmths(formulation.data)
    )  # fmt: skip


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
