"""How one cause may spread over an Orthoglide's three axes: one axis, a pair, all, or a pattern with a single size.

Quantities of the kinds tilt, offset and skew are written kind_ij: of axis (or leg) i, along j. `cyclic` goes x to y, y
to z, z to x; `mirrored` x to z, y to x, z to y; `common` is both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from calibench.discrepancy.machines.orthoglide.validate import rows_of
from calibench.discrepancy.model.effect import Along, Moment
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, geometry

Weights = Mapping[str, float]  # ij -> how much of the coefficient
CYCLIC: Weights = {"xy": 1.0, "yz": 1.0, "zx": 1.0}
MIRRORED: Weights = {"xz": 1.0, "yx": 1.0, "zy": 1.0}
COMMON: Weights = {**CYCLIC, **MIRRORED}
PAIRS = ("xy", "yz", "xz")


def member(word: str, axis: str) -> dict[str, tuple[Weights, ...]]:
    """Return the targets `axis x` …, with a coefficient for each of the two directions across."""
    across = {"x": "yz", "y": "xz", "z": "xy"}[axis]
    return {f"{word} {axis}": tuple({axis + j: 1.0} for j in across)}


def single(target: str, weights: Weights) -> dict[str, tuple[Weights, ...]]:
    """Return a target with one coefficient."""
    return {target: (weights,)}


def every() -> dict[str, tuple[Weights, ...]]:
    """Return the target `all`: six coefficients."""
    return {"all": tuple({ij: 1.0} for ij in sorted(COMMON))}


def spread(
    family: str, formula: str, channel: str, kind: str, unit: str, targets: Mapping[str, tuple[Weights, ...]],
    twins: Mapping[str, tuple[str, ...]],
) -> Callable[[Formulation, str], tuple[LinearEffect, ...]]:  # fmt: skip
    """Return what builds the candidates of a constant imperfection `kind` spread as `targets` say."""

    def build(formulation: Formulation, target: str) -> tuple[LinearEffect, ...]:
        coefficients = targets[target]
        names = tuple("+".join(w) for w in coefficients)
        involved = sorted({ij for weights in coefficients for ij in weights})

        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            return {
                f"{kind}_{ij}": np.tile([weights.get(ij, 0.0) for weights in coefficients], (len(data), 1))
                for ij in involved
            }

        units, most = (unit,) * len(names), thresholds().largest_angle if unit == "rad" else np.inf
        return (
            LinearEffect(
                family, target, formula, channel, (), names, units, unit, changes, twins.get(target, ()), largest=most,
                along=along(at_both(f"{kind}_{ij}" for ij in involved)),
            ),
        )  # fmt: skip

    return build


def along(changed: Mapping[str, str]) -> Along:
    """Return the positions of the carriages [mm from home] as an effect acts.

    `changed` is quantity -> that of the effect. A quantity belongs to the carriage in its name, at the posture, or at
    its Zero where the name ends so.
    """

    def moments(data: MeasuredData) -> dict[str, Sequence[Moment]]:
        rows = rows_of(data)
        now, then = (rows.joints(level) - geometry().length for level in (rows.level, rows.against))
        found: dict[str, list[Moment]] = {}
        for quantity, of in changed.items():
            axis = quantity.split("_")[1][0]
            stand = (then if quantity.endswith("_zero") else now)[:, AXES.index(axis)]
            found.setdefault(f"move along {axis}", []).append(Moment(quantity, of, stand))
        return dict(found)

    return moments


def at_both(names: Iterable[str]) -> dict[str, str]:
    """Return quantities of one size at every moment, with their names at the posture and at its Zero."""
    return {f"{name}_{when}": name for name in names for when in ("now", "zero")}
