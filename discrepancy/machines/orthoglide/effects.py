"""The catalogue of the Orthoglide: what may be wrong with its gauges, axes, drives and legs.

A gauge is named as the chapter names its reading: `gauge y_x` reads the direction y at the leg x. Drives may not stand
square to each other, or not go through one point: assumption (iv). An axis leans about the point where all should meet
(axis_orthogonality), or about the middle of its guide (guide_lean). Quantities of the kinds tilt, offset and skew are
written kind_ij: of axis (or leg) i, along j. `cyclic` goes x to y, y to z, z to x; `mirrored` the other way; `common`
is both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from calibench.core.options import shown
from calibench.core.words import plain
from calibench.discrepancy.fitting.fit import project_off
from calibench.discrepancy.machines.orthoglide.kinematics import rows_of
from calibench.discrepancy.model import effect as base
from calibench.discrepancy.model.effect import Along, Built, EffectFamily, LinearEffect, Moment, NotTestable
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import DataError, MeasuredData, finite
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton
from calibench.problems.orthoglide.kinematics import AXES, geometry

Changes = dict[str, Array]  # quantity -> (n, k)
_GAUGES = tuple(f"gauge {d}_{leg}" for leg in AXES for d in AXES if d != leg)
_LEGS = tuple(f"leg {leg}" for leg in AXES)
_TARGETS = tuple(f"axis {axis}" for axis in AXES)
_LEANING, _ELSEWHERE = 0.1, 10.0  # rad, mm: the most a gauge on a stand can be out of true, or off its mark
_SHOWS = 4.0  # standard deviations
_BEYOND = 3.0  # times that: what is named is held against gauges out of true by up to this
_CALIBRATED: WeakKeyDictionary[Formulation, tuple[Model, Array, Array]] = WeakKeyDictionary()


def _drift(formulation: Formulation, target: str) -> Built:
    base.needs_there(formulation.data, "t_s", "zero_t_s")
    if not _at(formulation.data, target).any():
        raise NotTestable(f"no reading of {target}")
    return drift.linear(
        target, ("t_s", "zero_t_s"), {"rate": "mm/s"},
        lambda q, data: {"deviation": -(_at(data, target) * (data["t_s"] - data["zero_t_s"]))[:, None]},
    )  # fmt: skip


def _zero(formulation: Formulation, target: str) -> Built:
    if (formulation.data["against_mm"] != 0).all():
        raise NotTestable("no reading is compared with Zero")
    if not _at(formulation.data, target).any():
        raise NotTestable(f"no reading of {target}")
    return zero.linear(
        target, (), {"z": "mm"},
        lambda q, data: {"deviation": (_at(data, target) * (data["against_mm"] == 0))[:, None]},
    )  # fmt: skip


def _felt(effect: LinearEffect, formulation: Formulation, largest: float) -> Built:
    """Return the effect; held back where even the largest that a gauge can have would not show in these readings.

    The question is asked at the calibrated machine: legs that stand as they should look the same from anywhere. A
    coefficient whose largest possible size does not show is left out, because its fitted value would be arbitrary.
    """
    if not _at(formulation.data, effect.target).any():
        raise NotTestable(f"no reading of {effect.target}")
    if formulation not in _CALIBRATED:
        model = Model(formulation)
        x = gauss_newton(
            lambda x: model.residuals(x)[:, 0], lambda x: model.jacobian(x)[:, 0, :], model.start, rank_tolerance=1e-9
        )
        _CALIBRATED[formulation] = model, x, model.jacobian(x)[:, 0, :]
    model, x, J = _CALIBRATED[formulation]
    q, true = model.quantities(x)
    left = signature(effect, np.zeros(len(effect.coefficients)), q, formulation.slopes(true), formulation)[:, 0, :]
    left = project_off(left, np.linalg.qr(J)[0])
    sigma = float(np.max(formulation.sigma["deviation"]))
    shown = np.linalg.norm(left, axis=0)
    seen = float(shown.max())

    kept = (shown * _BEYOND * largest >= _SHOWS * sigma) | (shown == seen)
    if not kept.all():
        whole = effect.changes
        some = {name: unit for name, unit, k in zip(effect.coefficients, effect.units, kept) if k}
        effect = replace(
            effect, coefficients=tuple(some), units=tuple(some.values()),
            changes=lambda q, data: {name: change[:, kept] for name, change in whole(q, data).items()},
        )  # fmt: skip
    if largest * seen < _SHOWS * sigma:
        needed = f"it takes {plain(_SHOWS * sigma / seen, 3)} {effect.unit}" if seen > 0 else "no size would"
        why = f"even {largest:g} {effect.unit} would not show in these readings: {needed}"
        raise NotTestable(why, alternatives=(base.Alternative(effect, _BEYOND * largest),))
    return effect


def _at(data: MeasuredData, target: str) -> Array:
    """Return 1 in the rows that a target's gauges read, 0 elsewhere, shape (n,)."""
    rows, place = rows_of(data), target[-3:]
    if target == "all":
        return np.ones(len(data))
    if target.startswith("leg"):
        return np.asarray(rows.leg == AXES.index(target[-1]), dtype=float)
    return np.asarray((rows.direction == AXES.index(place[0])) & (rows.leg == AXES.index(place[2])), dtype=float)


drift = EffectFamily(
    "drift", "orthoglide", "The reading of a gauge drifts away from its Zero",
    formula="deviation read = true + rate (t_s - zero_t_s)", channel="reading", columns=("t_s", "zero_t_s"),
    unit="mm/s", targets=(*_LEGS, "all"), build=_drift,
).enter()  # fmt: skip
zero = EffectFamily(
    "zero_reading", "orthoglide", "The Zero of a gauge was misread", formula="deviation read = true - z",
    channel="reading", columns=(), unit="mm", targets=(*_GAUGES, "all"), build=_zero,
).enter()  # fmt: skip
tilt: EffectFamily = EffectFamily(
    "gauge_tilt", "orthoglide", "A gauge does not read along its direction",
    formula="it reads along d turned by roll about the leg, and by pitch towards the leg's tool end",
    channel="reading", columns=(), unit="rad", targets=(*_GAUGES, "all"),
    build=lambda formulation, target: _felt(
        tilt.linear(
            target, (), {"roll": "rad", "pitch": "rad"},
            lambda q, data: {
                "gauge_roll": np.column_stack([_at(data, target), np.zeros(len(data))]),
                "gauge_pitch": np.column_stack([np.zeros(len(data)), _at(data, target)]),
            },
            unit="rad", largest=thresholds().largest_angle,
        ),
        formulation, _LEANING,
    ), twins="nearly unseen where deviations are small: it scales them",
).enter()  # fmt: skip
place: EffectFamily = EffectFamily(
    "gauge_placement", "orthoglide", "A gauge stands elsewhere on its leg than stated",
    formula="the gauge's plane cuts the leg's axis g further from the origin", channel="reading", columns=(),
    unit="mm", targets=(*_GAUGES, *_LEGS, "all"),
    build=lambda formulation, target: _felt(
        place.linear(target, (), {"g": "mm"}, lambda q, data: {"gauge_shift": _at(data, target)[:, None]}),
        formulation, _ELSEWHERE,
    ), twins="nearly unseen in moves along the leg: a parallel leg looks the same anywhere",
).enter()  # fmt: skip


Weights = Mapping[str, float]  # ij -> how much of the coefficient
Spread = Mapping[str, tuple[Weights, ...]]  # target -> its coefficients
CYCLIC: Weights = {"xy": 1.0, "yz": 1.0, "zx": 1.0}
MIRRORED: Weights = {"xz": 1.0, "yx": 1.0, "zy": 1.0}
COMMON: Weights = {**CYCLIC, **MIRRORED}


def _spread(
    name: str, cause: str, formula: str, *, channel: str, unit: str, kinds: tuple[str, ...], targets: Spread,
    twins: str, same: Mapping[str, tuple[str, ...]] = {},
) -> EffectFamily:  # fmt: skip
    """Enter a constant imperfection that is spread as `targets` say; `same` are the declared twins of a target.

    It is of the first of `kinds`; what leans about the middle of its stroke stands, as a second kind, beside its axis.
    """

    def build(formulation: Formulation, target: str) -> Built:
        coefficients = targets[target]
        involved = sorted({ij for weights in coefficients for ij in weights})

        def changes(q: Quantities, data: MeasuredData) -> Changes:
            each = {ij: [weights.get(ij, 0.0) for weights in coefficients] for ij in involved}
            middle = geometry().length + (geometry().stroke_plus + geometry().stroke_minus) / 2
            return {
                f"{kind}_{ij}": factor * np.tile(row, (len(data), 1))
                for kind, factor in zip(kinds, (1.0, -middle))
                for ij, row in each.items()
            }

        moved = [f"{kind}_{ij}" for kind in kinds for ij in involved]
        return family.linear(
            target, (), {"+".join(weights): unit for weights in coefficients}, changes, twins=same.get(target, ()),
            largest=thresholds().largest_angle if unit == "rad" else np.inf,
            along=along({f"{quantity}_{when}": quantity for quantity in moved for when in ("now", "zero")}),
        )  # fmt: skip

    family = EffectFamily(
        name, "orthoglide", cause, formula=formula, channel=channel, columns=(), unit=unit, targets=tuple(targets),
        build=build, twins=twins,
    )  # fmt: skip
    return family.enter()


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


_AXES: Spread = {f"axis {i}": tuple({i + j: 1.0} for j in AXES if j != i) for i in AXES}
_HANDS: Spread = {"cyclic": (CYCLIC,), "mirrored": (MIRRORED,)}
_ALL: Spread = {"common": (COMMON,), "all": tuple({ij: 1.0} for ij in sorted(COMMON))}
_PAIRS: Spread = {f"pair {ij}": ({ij: 0.5, ij[::-1]: 0.5},) for ij in ("xy", "yz", "xz")}
_PASSING: Spread = {f"pair {i}{j}": ({i + k: 0.5, j + k: -0.5},) for i, j, k in ("xyz", "yzx", "xzy")}
_EACH_PASSING: Spread = {"all": tuple(weights for pair in _PASSING.values() for weights in pair)}

guide = _spread(
    "guide_lean", "A guide leans about its own middle",
    "joint i stands at (rho_i - m) (tau_ij e_j + tau_ik e_k) beside its axis, m the middle of the stroke",
    channel="base", unit="rad", kinds=("tilt", "offset"), targets={**_AXES, **_HANDS},
    twins="nearly, with moves along the leg only: `axis_intersection`, as the axis passes the common point by",
)  # fmt: skip
orthogonality = _spread(
    "axis_orthogonality", "The axes of the drives are not square to each other",
    "axis i runs along e_i + tau_ij e_j + tau_ik e_k; pair ij: tau_ij = tau_ji = tau / 2", channel="base", unit="rad",
    kinds=("tilt",), targets={**_AXES, **_PAIRS, **_HANDS, **_ALL},
    twins="with moves along the leg only: an axis's lean towards another and that one's towards it; cyclic, "
    "mirrored, common",
)  # fmt: skip
intersection = _spread(
    "axis_intersection", "The axes of the drives do not meet in one point",
    "joint i stands at d_ij e_j + d_ik e_k + rho_i u_i; pair ij: the axes pass each other at d along k",
    channel="base", unit="mm", kinds=("offset",), targets={**_AXES, **_PASSING, **_HANDS, **_EACH_PASSING},
    twins="always: cyclic and mirrored; what all axes share is an offset of the joints",
    same={"cyclic": ("axis_intersection mirrored",), "mirrored": ("axis_intersection cyclic",)},
)  # fmt: skip


def axes_in(target: str) -> tuple[int, ...]:
    """Return the numbers of the axes in a target: (1,) for `axis y` or `leg y`."""
    return (0, 1, 2) if target == "all" else (AXES.index(target[-1]),)


def _drive_shift(formulation: Formulation, target: str) -> Built:
    columns = ("temp_K", "zero_temp_K")
    base.needs(formulation.data, *columns)
    effect = thermal_drives.linear(
        target, columns, {"a": "mm/K"},
        lambda q, data: _joints(target, *(np.tile(np.asarray(data[name])[:, None], 3) for name in columns)),
    )  # fmt: skip
    why = "leaves nearly the signature of thermal_legs: it is not looked for by itself, but held against what is named"
    raise NotTestable(why, alternatives=(base.Alternative(effect),))


def _along(target: str) -> Along:
    """Return the positions of the carriages in `target` that are used where the joints have errors, at both moments."""
    return along({name: name for i in axes_in(target) for name in (f"joint_{AXES[i]}", f"joint_{AXES[i]}_zero")})


def _joints(target: str, at_posture: Array, at_zero: Array) -> Changes:
    """Return the changes of the joints in `target`, from changes of all three, shape (n, 3), at both moments."""
    changes = {f"joint_{AXES[i]}": at_posture[:, i : i + 1] for i in axes_in(target)}
    return changes | {f"joint_{AXES[i]}_zero": at_zero[:, i : i + 1] for i in axes_in(target)}


scale: EffectFamily = EffectFamily(
    "scale", "orthoglide", "The scale of an encoder, or the pitch of a screw, is not the stated one",
    formula="joint i goes (1 + kappa) (rho_i - L) from Zero", channel="reading", columns=(), unit="1",
    targets=(*_TARGETS, "all"), label="encoder-scale error",
    build=lambda formulation, target: scale.linear(
        target, (), {"kappa": "1"},
        lambda q, data: _joints(
            target,
            *(rows_of(data).joints(at) - geometry().length for at in (rows_of(data).level, rows_of(data).against)),
        ),
        along=_along(target),
    ),
).enter()  # fmt: skip
backlash: EffectFamily = EffectFamily(
    "backlash", "orthoglide", "A drive has play and trails on the side it came from",
    formula="joint i stands at rho_i - play / 2 * sign(last move of i)", channel="reading", columns=("pass",),
    unit="mm", targets=(*_TARGETS, "all"),
    build=lambda formulation, target: backlash.linear(
        target, ("pass",), {"play": "mm"},
        lambda q, data: _joints(target, *(-0.5 * sense for sense in rows_of(data).senses())), along=_along(target),
    ),
    twins="what every move ends with in the same sense is an offset of the joint: both passes are needed",
).enter()  # fmt: skip
thermal_drives = EffectFamily(
    "thermal_drives", "orthoglide", "The zeros of the drives move as frame and screws warm up",
    formula="joint i stands at rho_i + a temp_K", channel="base", columns=("temp_K", "zero_temp_K"), unit="mm/K",
    targets=(*_TARGETS, "all"), build=_drive_shift,
    twins="nearly, with moves along the leg only: `thermal_legs` with the opposite sign; at constant temperature: drho",
    label="thermal shift", label_of_all="thermal shift of all drives",
).enter()  # fmt: skip


def _leg_growth(formulation: Formulation, target: str) -> Built:
    base.needs(formulation.data, "temp_K")
    base.needs_there(formulation.data, "zero_temp_K")

    def changes(q: Quantities, data: MeasuredData) -> Changes:
        moments = {"": data["temp_K"][:, None], "_zero": data["zero_temp_K"][:, None]}
        return {f"length_{AXES[i]}{when}": warm for when, warm in moments.items() for i in axes_in(target)}

    def moments(data: MeasuredData) -> dict[str, Sequence[Moment]]:
        # the times of both: legs do not warm up as the thermometer does, late ones least; else the temperatures
        there, timed = changes({}, data), "t_s" in data and "zero_t_s" in data
        when = {
            name: np.asarray(data["zero_t_s" if name.endswith("_zero") else "t_s"], float) if timed else at[:, 0]
            for name, at in there.items()
        }
        return {"time" if timed else "temperature": [Moment(name, name, at) for name, at in when.items()]}

    return thermal_legs.linear(target, ("temp_K", "zero_temp_K"), {"a": "mm/K"}, changes, along=moments)


def _length(formulation: Formulation, target: str) -> Built:
    names = tuple(f"dL_{AXES[i]}" for i in axes_in(target))
    if any(p.name in names for p in formulation.parameters):
        raise NotTestable("the lengths dL are calibrated")
    return length.linear(
        target, (), dict.fromkeys(names, "mm"),
        lambda q, data: {name: np.tile(each, (len(data), 1)) for name, each in zip(names, np.eye(len(names)))},
    )  # fmt: skip


def _gravity(formulation: Formulation, target: str) -> Built:
    data = formulation.data
    weight = finite(data, "moving_weight_N", data.metadata.get("moving_weight_N", 0.0), "N")
    stated = data.metadata.get("gravity", (0.0, 0.0, -1.0))
    parts = stated if isinstance(stated, list | tuple | np.ndarray) else ()
    down = np.array([finite(data, "gravity", part, "a direction") for part in parts])
    if down.shape != (3,) or not np.linalg.norm(down) > 0:
        raise DataError(f"{data.name}: gravity={shown(stated)}: a direction of three numbers is needed, such as 0 0 -1")
    if not weight and not np.ptp(data["payload_N"]) > 0:
        raise NotTestable("column payload_N is constant, and no moving_weight_N is stated", ("payload_N",))

    def changes(q: Quantities, data: MeasuredData) -> Changes:
        rows = rows_of(data)
        load, unit = (rows.payload + weight)[:, None], down / np.linalg.norm(down)
        stretched: Changes = {}
        for level, when in ((rows.level, ""), (rows.against, "_zero")):
            # the pull in each leg for a load of 1 N at the tool, shape (n, 3): sum_i n_i (A_i - p) / L = -down
            tool = level[:, None] * np.eye(3)[rows.axis]
            centres = rows.joints(level)[:, :, None] * np.eye(3)
            towards = ((centres - tool[:, None, :]) / geometry().length).swapaxes(1, 2)
            pulls = load * np.linalg.solve(towards, np.tile(-unit, (len(level), 1))[:, :, None])[:, :, 0]
            stretched |= {f"length_{axis}{when}": pulls[:, i : i + 1] for i, axis in enumerate(AXES)}
        return stretched

    return gravity.linear(
        target, ("payload_N",), {"k": "mm/N"}, changes,
        along=lambda data: {"load of a leg": [Moment(n, n, at[:, 0]) for n, at in changes({}, data).items()]},
    )  # fmt: skip


skew = _spread(
    "bar_skew", "The two bars of a leg are not parallel to each other",
    "the bar of leg i that is read ends at the tool s_ij along j and s_ik along k of the leg's own end",
    channel="link", unit="mm", kinds=("skew",),
    targets={**{f"leg {target[-1]}": both for target, both in _AXES.items()}, **_HANDS, **_ALL},
    twins="nearly, with moves along the leg only: `axis_intersection axis i`",
)  # fmt: skip
length = EffectFamily(
    "leg_length", "orthoglide", "The legs are not as long as stated, and only joint offsets were calibrated",
    formula="L_i = L + dL_i", channel="link", columns=(), unit="mm", targets=(*_LEGS, "all"),
    build=_length, twins="nearly, always: an offset of the joint, drho_i = -dL_i",
).enter()  # fmt: skip
thermal_legs = EffectFamily(
    "thermal_legs", "orthoglide", "The legs grow as they warm up", formula="L_i += a temp_K", channel="link",
    columns=("temp_K", "zero_temp_K"), unit="mm/K", targets=(*_LEGS, "all"), build=_leg_growth,
    twins="at constant temperature: the lengths dL", label="thermal growth",
    label_of_all="thermal growth of all legs",
).enter()  # fmt: skip
gravity = EffectFamily(
    "gravity", "orthoglide", "The legs stretch under the load of the tool",
    formula="L_i += k n_i (payload_N + metadata.moving_weight_N), n_i the pull in leg i for 1 N", channel="link",
    columns=("payload_N",), unit="mm/N", targets=("all",), build=_gravity,
    twins="nearly, under one load: the length of the upright leg", label_of_all="gravity",
).enter()  # fmt: skip
