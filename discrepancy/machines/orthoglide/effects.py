"""The catalogue of the Orthoglide: what may be wrong with its axes, gauges, drives and legs, a file each.

What may be wrong with an Orthoglide's drives as they stand: not square to each other, not through one point.

The chapter's assumption (iv). An axis that leans is taken to lean about the point where all should meet
(axis_orthogonality), or about the middle of its guide (guide_lean), where it passes that point by as well. The legs
are read where they move along themselves, so a turn of the whole machine is seen in moves across the legs only, and a
shift of all axes that meet again is an offset of the joints.

What may be wrong with the gauges of an Orthoglide's measurement: they drift, are misread, lean, or stand elsewhere.

A gauge is named as the chapter names its reading: `gauge y_x` reads the direction y at the leg x.

What may be wrong with an Orthoglide's linear drives as they move and warm up: their scale, play, and their zeros.

What may be wrong with an Orthoglide's legs: bars not parallel, bars that warm up, bars that stretch under load.

How one cause may spread over an Orthoglide's three axes: one axis, a pair, all, or a pattern with a single size.

Quantities of the kinds tilt, offset and skew are written kind_ij: of axis (or leg) i, along j. `cyclic` goes x to y, y
to z, z to x; `mirrored` x to z, y to x, z to y; `common` is both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import shown
from calibench.core.words import plain
from calibench.discrepancy.fitting.fit import project_off
from calibench.discrepancy.machines.orthoglide.kinematics import Rows, rows_of
from calibench.discrepancy.model.effect import (
    Along,
    Alternative,
    Effect,
    EffectFamily,
    HeldBack,
    LinearEffect,
    Moment,
    NotTestable,
    needs,
    needs_there,
)
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import DataError, MeasuredData, finite
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton
from calibench.problems.orthoglide.kinematics import AXES, geometry

_GAUGES = tuple(f"gauge {d}_{leg}" for leg in AXES for d in AXES if d != leg)
_LEGS = tuple(f"leg {leg}" for leg in AXES)


def _drift(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs_there(formulation.data, "t_s", "zero_t_s")
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {"deviation": -(_at(data, target) * (data["t_s"] - data["zero_t_s"]))[:, None]}

    columns = ("t_s", "zero_t_s")
    return (drift.linear(target, columns, {"rate": "mm/s"}, changes),)


def _zero(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    if (formulation.data["against_mm"] != 0).all():
        raise NotTestable("no reading is compared with Zero")
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {"deviation": (_at(data, target) * (data["against_mm"] == 0))[:, None]}

    return (zero.linear(target, (), {"z": "mm"}, changes),)


def _gauge_tilt(formulation: Formulation, target: str) -> tuple[Effect, ...] | HeldBack:
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        at, none = _at(data, target), np.zeros(len(data))
        return {"gauge_roll": np.column_stack([at, none]), "gauge_pitch": np.column_stack([none, at])}

    names, units = ("roll", "pitch"), ("rad", "rad")
    most = thresholds().largest_angle
    effect = tilt.linear(target, (), dict(zip(names, units, strict=True)), changes, unit="rad", largest=most)
    return _felt(effect, formulation, _LEANING)


def _place(formulation: Formulation, target: str) -> tuple[Effect, ...] | HeldBack:
    _meets(formulation.data, target)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {"gauge_shift": _at(data, target)[:, None]}

    effect = place.linear(target, (), {"g": "mm"}, changes)
    return _felt(effect, formulation, _ELSEWHERE)


def _felt(effect: LinearEffect, formulation: Formulation, largest: float) -> tuple[Effect, ...] | HeldBack:
    """Return the effect; held back where even the largest that a gauge can have would not show in these readings.

    The question is asked at the calibrated machine: legs that stand as they should look the same from anywhere. A
    coefficient whose largest possible size does not show is left out, because its fitted value would be arbitrary.
    """
    model, x, J = calibrated(formulation)
    q, true = model.quantities(x)
    left = signature(effect, np.zeros(len(effect.coefficients)), q, formulation.slopes(true), formulation)[:, 0, :]
    left = project_off(left, np.linalg.qr(J)[0])
    sigma = float(np.max(formulation.sigma["deviation"]))
    shown = np.linalg.norm(left, axis=0)
    seen = float(shown.max())
    effect = _restricted(effect, (shown * _BEYOND * largest >= _SHOWS * sigma) | (shown == seen))
    if largest * seen < _SHOWS * sigma:
        needed = f"it takes {plain(_SHOWS * sigma / seen, 3)} {effect.unit}" if seen > 0 else "no size would"
        why = f"even {largest:g} {effect.unit} would not show in these readings: {needed}"
        return HeldBack(why, (Alternative(effect, _BEYOND * largest),))
    return (effect,)


def _restricted(effect: LinearEffect, kept: NDArray[np.bool_]) -> LinearEffect:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: change[:, kept] for name, change in effect.changes(q, data).items()}

    def some(words: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(word for word, k in zip(words, kept) if k)

    if kept.all():
        return effect
    return replace(effect, coefficients=some(effect.coefficients), units=some(effect.units), changes=changes)


def calibrated(formulation: Formulation) -> tuple[Model, Array, Array]:
    """Return the model without effects, its least squares x and Jacobian there, (n, p).

    Further calls return the same objects.
    """
    if formulation not in _CALIBRATED:
        model = Model(formulation)
        x = gauss_newton(
            lambda x: model.residuals(x)[:, 0], lambda x: model.jacobian(x)[:, 0, :], model.start, rank_tolerance=1e-9
        )
        _CALIBRATED[formulation] = model, x, model.jacobian(x)[:, 0, :]
    return _CALIBRATED[formulation]


_CALIBRATED: WeakKeyDictionary[Formulation, tuple[Model, Array, Array]] = WeakKeyDictionary()
_LEANING, _ELSEWHERE = 0.1, 10.0  # rad, mm: the most a gauge on a stand can be out of true, or off its mark
_SHOWS = 4.0  # standard deviations
_BEYOND = 3.0  # times that: what is named is held against gauges out of true by up to this


def _at(data: MeasuredData, target: str) -> Array:
    """Return 1 in the rows that a target's gauges read, 0 elsewhere, shape (n,)."""
    rows, place = rows_of(data), target[-3:]
    if target == "all":
        return np.ones(len(data))
    if target.startswith("leg"):
        return np.asarray(rows.leg == AXES.index(target[-1]), dtype=float)
    return np.asarray((rows.direction == AXES.index(place[0])) & (rows.leg == AXES.index(place[2])), dtype=float)


def _meets(data: MeasuredData, target: str) -> None:
    if not _at(data, target).any():
        raise NotTestable(f"no reading of {target}")


drift = EffectFamily(
    "drift", "orthoglide", "The reading of a gauge drifts away from its Zero",
    formula="deviation read = true + rate (t_s - zero_t_s)", channel="reading", columns=("t_s", "zero_t_s"),
    unit="mm/s", targets=(*_LEGS, "all"), build=_drift,
).enter()  # fmt: skip
zero = EffectFamily(
    "zero_reading", "orthoglide", "The Zero of a gauge was misread", formula="deviation read = true - z",
    channel="reading", columns=(), unit="mm", targets=(*_GAUGES, "all"), build=_zero,
).enter()  # fmt: skip
tilt = EffectFamily(
    "gauge_tilt", "orthoglide", "A gauge does not read along its direction",
    formula="it reads along d turned by roll about the leg, and by pitch towards the leg's tool end",
    channel="reading", columns=(), unit="rad", targets=(*_GAUGES, "all"), build=_gauge_tilt,
    twins="nearly unseen where deviations are small: it scales them",
).enter()  # fmt: skip
place = EffectFamily(
    "gauge_placement", "orthoglide", "A gauge stands elsewhere on its leg than stated",
    formula="the gauge's plane cuts the leg's axis g further from the origin", channel="reading", columns=(),
    unit="mm", targets=(*_GAUGES, *_LEGS, "all"), build=_place,
    twins="nearly unseen in moves along the leg: a parallel leg looks the same anywhere",
).enter()  # fmt: skip


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
                family, target, formula, channel=channel, columns=(), coefficients=names, units=units, unit=unit,
                changes=changes, twins=twins.get(target, ()), largest=most,
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


_AXES = member("axis", "x") | member("axis", "y") | member("axis", "z")
_SQUARE = (
    _AXES
    | {f"pair {ij}": ({ij: 0.5, ij[::-1]: 0.5},) for ij in PAIRS}
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
    | single("common", COMMON)
    | every()
)
_PASSING = {f"pair {i}{j}": ({i + k: 0.5, j + k: -0.5},) for i, j, k in ("xyz", "yzx", "xzy")}
_THROUGH = (
    _AXES
    | _PASSING
    | single("cyclic", CYCLIC)
    | single("mirrored", MIRRORED)
    | {"all": tuple(weights for pair in _PASSING.values() for weights in pair)}
)
_ONE_POINT = {"cyclic": ("axis_intersection mirrored",), "mirrored": ("axis_intersection cyclic",)}
_LEAN = "axis i runs along e_i + tau_ij e_j + tau_ik e_k; pair ij: tau_ij = tau_ji = tau / 2"
_SHIFT = "joint i stands at d_ij e_j + d_ik e_k + rho_i u_i; pair ij: the axes pass each other at d along k"

_GUIDES = _AXES | single("cyclic", CYCLIC) | single("mirrored", MIRRORED)


def _guide(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    (lean,) = _tilt(formulation, target)
    middle = geometry().length + (geometry().stroke_plus + geometry().stroke_minus) / 2

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        tilts = lean.basis(q, data, np.zeros(len(lean.coefficients)))
        return tilts | {name.replace("tilt", "offset"): -middle * tilt for name, tilt in tilts.items()}

    names, units = lean.coefficients, lean.units
    most = lean.largest
    kinds = [f"{kind}_{ij}" for kind in ("tilt", "offset") for weights in _GUIDES[target] for ij in weights]
    return (
        guide.linear(
            target,
            (),
            dict(zip(names, units, strict=True)),
            changes,
            unit="rad",
            largest=most,
            along=along(at_both(kinds)),
        ),
    )


_tilt = spread("axis_orthogonality", _LEAN, "base", "tilt", "rad", _GUIDES, {})
guide = EffectFamily(
    "guide_lean", "orthoglide", "A guide leans about its own middle",
    formula="joint i stands at (rho_i - m) (tau_ij e_j + tau_ik e_k) beside its axis, m the middle of the stroke",
    channel="base", columns=(), unit="rad", targets=tuple(_GUIDES), build=_guide,
    twins="nearly, with moves along the leg only: `axis_intersection`, as the axis passes the common point by",
).enter()  # fmt: skip
orthogonality = EffectFamily(
    "axis_orthogonality", "orthoglide", "The axes of the drives are not square to each other", formula=_LEAN,
    channel="base", columns=(), unit="rad", targets=tuple(_SQUARE),
    build=spread("axis_orthogonality", _LEAN, "base", "tilt", "rad", _SQUARE, {}),
    twins="with moves along the leg only: an axis's lean towards another and that one's towards it; cyclic, "
    "mirrored, common",
).enter()  # fmt: skip
intersection = EffectFamily(
    "axis_intersection", "orthoglide", "The axes of the drives do not meet in one point", formula=_SHIFT,
    channel="base", columns=(), unit="mm", targets=tuple(_THROUGH),
    build=spread("axis_intersection", _SHIFT, "base", "offset", "mm", _THROUGH, _ONE_POINT),
    twins="always: cyclic and mirrored; what all axes share is an offset of the joints",
).enter()  # fmt: skip


_TARGETS = ("axis x", "axis y", "axis z", "all")


def axes_in(target: str) -> tuple[int, ...]:
    """Return the numbers of the axes in a target: (1,) for `axis y` or `leg y`, (0, 1, 2) for `all`."""
    return (0, 1, 2) if target == "all" else (AXES.index(target[-1]),)


def _scale(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        rows = rows_of(data)
        return _joints(
            target, rows.joints(rows.level) - geometry().length, rows.joints(rows.against) - geometry().length
        )

    return (scale.linear(target, (), {"kappa": "1"}, changes, along=_along(target)),)


def _backlash(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        at_posture, at_zero = rows_of(data).senses()
        return _joints(target, -0.5 * at_posture, -0.5 * at_zero)

    return (backlash.linear(target, ("pass",), {"play": "mm"}, changes, along=_along(target)),)


def _drive_shift(formulation: Formulation, target: str) -> HeldBack:
    needs(formulation.data, "temp_K", "zero_temp_K")

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        now, then = (np.tile(np.asarray(data[name])[:, None], 3) for name in ("temp_K", "zero_temp_K"))
        return _joints(target, now, then)

    columns = ("temp_K", "zero_temp_K")
    effect = thermal_drives.linear(target, columns, {"a": "mm/K"}, changes)
    why = "leaves nearly the signature of thermal_legs: it is not looked for by itself, but held against what is named"
    return HeldBack(why, (Alternative(effect),))


def _along(target: str) -> Along:
    """Return the positions of the carriages in `target` that are used where the joints have errors, at both moments."""
    return along({name: name for i in axes_in(target) for name in (f"joint_{AXES[i]}", f"joint_{AXES[i]}_zero")})


def _joints(target: str, at_posture: Array, at_zero: Array) -> dict[str, Array]:
    """Return the changes of the joints in `target`, from changes of all three, shape (n, 3), at both moments."""
    changes = {f"joint_{AXES[i]}": at_posture[:, i : i + 1] for i in axes_in(target)}
    return changes | {f"joint_{AXES[i]}_zero": at_zero[:, i : i + 1] for i in axes_in(target)}


scale = EffectFamily(
    "scale", "orthoglide", "The scale of an encoder, or the pitch of a screw, is not the stated one",
    formula="joint i goes (1 + kappa) (rho_i - L) from Zero", channel="reading", columns=(), unit="1",
    targets=_TARGETS, build=_scale, label="encoder-scale error",
).enter()  # fmt: skip
backlash = EffectFamily(
    "backlash", "orthoglide", "A drive has play and trails on the side it came from",
    formula="joint i stands at rho_i - play / 2 * sign(last move of i)", channel="reading", columns=("pass",),
    unit="mm", targets=_TARGETS, build=_backlash,
    twins="what every move ends with in the same sense is an offset of the joint: both passes are needed",
).enter()  # fmt: skip
thermal_drives = EffectFamily(
    "thermal_drives", "orthoglide", "The zeros of the drives move as frame and screws warm up",
    formula="joint i stands at rho_i + a temp_K", channel="base", columns=("temp_K", "zero_temp_K"), unit="mm/K",
    targets=_TARGETS, build=_drive_shift,
    twins="nearly, with moves along the leg only: `thermal_legs` with the opposite sign; at constant temperature: drho",
    label="thermal shift", label_of_all="thermal shift of all drives",
).enter()  # fmt: skip


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


def _leg_growth(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "temp_K")
    needs_there(formulation.data, "zero_temp_K")

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        now, then = data["temp_K"][:, None], data["zero_temp_K"][:, None]
        grown = {f"length_{AXES[i]}": now for i in axes_in(target)}
        return grown | {f"length_{AXES[i]}_zero": then for i in axes_in(target)}

    columns = ("temp_K", "zero_temp_K")
    return (thermal_legs.linear(target, columns, {"a": "mm/K"}, changes, along=_warming(changes)),)


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
    return (length.linear(target, (), dict(zip(names, units, strict=True)), changes, unit="mm"),)


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
    return (gravity.linear(target, columns, {"k": "mm/N"}, changes, along=_over("load of a leg", changes)),)


def pulls(rows: Rows, level: Array, down: Array) -> Array:
    """Return the pull in each leg for a load of 1 N at the tool, shape (n, 3): sum_i n_i (A_i - p) / L = -down."""
    tool = level[:, None] * np.eye(3)[rows.axis]
    centres = rows.joints(level)[:, :, None] * np.eye(3)
    towards = (centres - tool[:, None, :]) / geometry().length
    unit = down / np.linalg.norm(down)
    return np.asarray(np.linalg.solve(towards.swapaxes(1, 2), np.tile(-unit, (len(level), 1))[:, :, None])[:, :, 0])


skew = EffectFamily(
    "bar_skew", "orthoglide", "The two bars of a leg are not parallel to each other", formula=_BAR, channel="link",
    columns=(), unit="mm", targets=tuple(_SKEW), build=spread("bar_skew", _BAR, "link", "skew", "mm", _SKEW, {}),
    twins="nearly, with moves along the leg only: `axis_intersection axis i`",
).enter()  # fmt: skip
length = EffectFamily(
    "leg_length", "orthoglide", "The legs are not as long as stated, and only joint offsets were calibrated",
    formula="L_i = L + dL_i", channel="link", columns=(), unit="mm", targets=("leg x", "leg y", "leg z", "all"),
    build=_length, twins="nearly, always: an offset of the joint, drho_i = -dL_i",
).enter()  # fmt: skip
thermal_legs = EffectFamily(
    "thermal_legs", "orthoglide", "The legs grow as they warm up", formula="L_i += a temp_K", channel="link",
    columns=("temp_K", "zero_temp_K"), unit="mm/K", targets=("leg x", "leg y", "leg z", "all"), build=_leg_growth,
    twins="at constant temperature: the lengths dL", label="thermal growth",
    label_of_all="thermal growth of all legs",
).enter()  # fmt: skip
gravity = EffectFamily(
    "gravity", "orthoglide", "The legs stretch under the load of the tool",
    formula="L_i += k n_i (payload_N + metadata.moving_weight_N), n_i the pull in leg i for 1 N", channel="link",
    columns=("payload_N",), unit="mm/N", targets=("all",), build=_gravity,
    twins="nearly, under one load: the length of the upright leg", label_of_all="gravity",
).enter()  # fmt: skip
