"""What may be wrong with an Orthoglide's legs: bars not parallel, bars that warm up, bars that stretch under load."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from calibench.core.options import shown
from calibench.discrepancy.machines.orthoglide.effects.joints import axes_in
from calibench.discrepancy.machines.orthoglide.effects.patterns import (
    COMMON,
    CYCLIC,
    MIRRORED,
    every,
    member,
    single,
    spread,
)
from calibench.discrepancy.machines.orthoglide.validate import Rows, rows_of
from calibench.discrepancy.model.effect import Along, Effect, Moment, NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs, needs_there
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.measured.stated import finite
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, geometry

_SKEW = (
    member("leg", "x")
    | member("leg", "y")
    | member("leg", "z")
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
    | single("common", COMMON)
    | every()
)
_BAR = "the bar of leg i that is read ends at the tool s_ij along j and s_ik along k of the leg's own end"


def _thermal(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    needs_there(formulation.data, "zero_temp_K")

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        now, then = data["temp_K"][:, None], data["zero_temp_K"][:, None]
        grown = {f"length_{AXES[i]}": now for i in axes_in(target)}
        return grown | {f"length_{AXES[i]}_zero": then for i in axes_in(target)}

    columns = ("temp_K", "zero_temp_K")
    return (
        LinearEffect(
            "thermal_legs", target, thermal.formula, "link", columns, ("a",), ("mm/K",), "mm/K", changes,
            along=_warming(changes),
        ),
    )  # fmt: skip


def _warming(changes: Callable[[Quantities, MeasuredData], dict[str, Array]]) -> Along:
    """Return the times of both moments of each leg: legs do not warm up as the thermometer does, late ones least.

    Where no times are measured, the temperatures stand for them.
    """

    def moments(data: MeasuredData) -> dict[str, Sequence[Moment]]:
        if "t_s" not in data or "zero_t_s" not in data:
            return dict(_over("temperature", changes)(data))
        times = {name: "zero_t_s" if name.endswith("_zero") else "t_s" for name in changes({}, data)}
        return {"time": [Moment(name, name, np.asarray(data[column], float)) for name, column in times.items()]}

    return moments


def _over(argument: str, changes: Callable[[Quantities, MeasuredData], dict[str, Array]]) -> Along:
    """Return the moments of an effect that is its argument times a number, at both moments of each leg."""

    def moments(data: MeasuredData) -> dict[str, Sequence[Moment]]:
        return {argument: [Moment(name, name, at[:, 0]) for name, at in changes({}, data).items()]}

    return moments


def _length(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    held = {f"dL_{AXES[i]}" for i in axes_in(target)} - {p.name for p in formulation.parameters}
    if len(held) < len(axes_in(target)):
        raise NotTestable("the lengths dL are calibrated")

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        each = np.eye(len(axes_in(target)))
        return {f"dL_{AXES[i]}": np.tile(each[k], (len(data), 1)) for k, i in enumerate(axes_in(target))}

    names = tuple(f"dL_{AXES[i]}" for i in axes_in(target))
    units = ("mm",) * len(names)
    return (LinearEffect("leg_length", target, length.formula, "link", (), names, units, "mm", changes),)


def _gravity(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    data = formulation.data
    weight = finite(data, "moving_weight_N", data.metadata.get("moving_weight_N", 0.0), "N")
    stated = data.metadata.get("gravity", (0.0, 0.0, -1.0))
    parts = stated if isinstance(stated, list | tuple | np.ndarray) else ()
    down = np.array([finite(data, "gravity", part, "a direction") for part in parts])
    if down.shape != (3,) or not np.linalg.norm(down) > 0:
        raise DataError(f"{data.name}: gravity={shown(stated)}: a direction of three numbers is needed, such as 0 0 -1")
    if not weight and not np.ptp(data["payload_N"]) > 0:
        raise NotTestable("column payload_N is constant, and no moving_weight_N is stated", ("payload_N",))

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        rows = rows_of(data)
        load = (rows.payload + weight)[:, None]
        now, then = (load * pulls(rows, level, down) for level in (rows.level, rows.against))
        stretched = {f"length_{axis}": now[:, i : i + 1] for i, axis in enumerate(AXES)}
        return stretched | {f"length_{axis}_zero": then[:, i : i + 1] for i, axis in enumerate(AXES)}

    columns = ("payload_N",)
    return (
        LinearEffect(
            "gravity", target, gravity.formula, "link", columns, ("k",), ("mm/N",), "mm/N", changes,
            along=_over("load of a leg", changes),
        ),
    )  # fmt: skip


def pulls(rows: Rows, level: Array, down: Array) -> Array:
    """Return the pull in each leg for a load of 1 N at the tool, shape (n, 3): sum_i n_i (A_i - p) / L = -down."""
    tool = level[:, None] * np.eye(3)[rows.axis]
    centres = rows.joints(level)[:, :, None] * np.eye(3)
    towards = (centres - tool[:, None, :]) / geometry().length
    unit = down / np.linalg.norm(down)
    return np.asarray(np.linalg.solve(towards.swapaxes(1, 2), np.tile(-unit, (len(level), 1))[:, :, None])[:, :, 0])


skew = EffectFamily(
    "bar_skew", "orthoglide", "The two bars of a leg are not parallel to each other", _BAR, "link", (), "mm",
    tuple(_SKEW), spread("bar_skew", _BAR, "link", "skew", "mm", _SKEW, {}),
    "nearly, with moves along the leg only: `axis_intersection axis i`",
).enter()  # fmt: skip
length = EffectFamily(
    "leg_length", "orthoglide", "The legs are not as long as stated, and only joint offsets were calibrated",
    "L_i = L + dL_i", "link", (), "mm", ("leg x", "leg y", "leg z", "all"), _length,
    "nearly, always: an offset of the joint, drho_i = -dL_i",
).enter()  # fmt: skip
thermal = EffectFamily(
    "thermal_legs", "orthoglide", "The legs grow as they warm up", "L_i += a temp_K", "link", ("temp_K", "zero_temp_K"),
    "mm/K", ("leg x", "leg y", "leg z", "all"), _thermal, "at constant temperature: the lengths dL",
    label="thermal growth", label_of_all="thermal growth of all legs",
).enter()  # fmt: skip
gravity = EffectFamily(
    "gravity", "orthoglide", "The legs stretch under the load of the tool",
    "L_i += k n_i (payload_N + metadata.moving_weight_N), n_i the pull in leg i for 1 N", "link", ("payload_N",),
    "mm/N", ("all",), _gravity, "nearly, under one load: the length of the upright leg", label_of_all="gravity",
).enter()  # fmt: skip
