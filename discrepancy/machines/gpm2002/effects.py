"""The catalogue of the GPM2002: a family of effects a file, or families of one physics.

Play in a drive: the joint trails its encoder by half the play, on the side it was approached from.

A base is knocked out of its place, once, at a time that is searched for.

An encoder's zero drifts during the run: evenly, along a curve, or along one that settles (forms of one name).

Deformation of a leg under load: its drive twists, its proximal link bends, its distal link stretches.

A twisting drive and a bending proximal link both leave the elbow behind the encoder by what the torque of the motor
winds up: exact twins. Coefficients are positive for what gives way: tau_i is the torque of the motor on its link,
axial_i is above zero in tension.

Scale of an encoder, or a gear ratio that is not the stated one: the joint turns by (1 + k) times what is read.

The size is limited to what an encoder on its own shaft can have, because calibration absorbs most of a larger one.

Angle errors of an encoder that repeat with its turn: an eccentric disc, an oval one, teeth; and their common class.

The physics is that of any rotary joint; the tooth numbers are read from what is stated of the data.

Readings taken late: by one encoder, by all of them, or by the tracker. While the machine moves they are displaced.

Only the lag between instruments can be seen. Angles only: encoders that are late together are not late at all. With a
tracker: all encoders late is the tracker early, an exact twin as far as the stated velocities agree.

Noise other than stated, as the catalogue lists it. It changes no mean, so `discrepancy.noise.laws` tests for it.

An encoder slips on its shaft, once, at a time that is searched for: its offset changes by a step.

Thermal growth of all links, of those of one leg, or of the base. Growth of everything enlarges the whole machine.

Angles only cannot see that enlargement, so there links that grow and a base that shrinks are the same. With a tracker
the base grows about its middle, or about a point that the data find.

Members follow a thermometer late, by how much nobody states: every cause comes in forms of other time constants.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from calibench.discrepancy.effects.general import columns, harmonics, joints, lengths
from calibench.discrepancy.effects.general.lengths import grown, time_constants, warmth
from calibench.discrepancy.effects.general.recipe import Built, Recipe
from calibench.discrepancy.machines.gpm2002.roles import JOINTS, LEGS, distal, joint_of, teeth_of
from calibench.discrepancy.model.effect import (
    ChangePoint,
    Effect,
    EffectFamily,
    NotTestable,
    change_times,
    needs,
    number,
)
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

backlash = joints.backlash.enter(
    "gpm2002", JOINTS, formula="enc_i -= play / 2 * dir_i", columns=("dir_{i}",), unit="rad"
)


def _build(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    needs(formulation.data, "t_s")
    times = change_times(formulation.data["t_s"])
    i = number(target)
    moved, names = (f"xa{i}", f"ya{i}"), ("dx", "dy")
    return tuple(
        ChangePoint(
            "base_shift",
            target,
            base_shift.formula,
            channel="base",
            quantities=moved,
            coefficients=names,
            unit="mm",
            at=float(at),
            positions=len(times),
        )
        for at in times
    )


base_shift = EffectFamily(
    "base_shift", "gpm2002", "A base is displaced once during the run", formula="A_i += (dx, dy) from a time on",
    channel="base", columns=("t_s",), unit="mm", targets=("base 1", "base 2", "base 3"), build=_build,
).enter()  # fmt: skip


drift = columns.drift.enter(
    "gpm2002", JOINTS, cause="The zero of an encoder drifts during the run",
    formula="enc_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run",
    columns=("t_s",), unit="rad",
)  # fmt: skip


def _of_leg(made: Recipe, part: str) -> Recipe:
    """Return a recipe whose target is a leg; the general recipe asks for the joint or the length of that leg."""

    def make(family: EffectFamily, formulation: Formulation, target: str) -> Built:
        own = joint_of(target) if part == "joint" else distal(target)
        built = made.make(family, formulation, own)
        assert isinstance(built, tuple)
        return tuple(replace(effect, target=target) for effect in built)  # type: ignore[type-var]

    return Recipe(made.words, make)


compliance = joints.compliance.enter(
    "gpm2002", JOINTS, lambda formulation, target: (f"proximal_bending leg {number(target)}",),
    cause="A drive twists under its torque", formula="enc_i -= kappa tau_i", columns=("tau_{i}",), unit="rad/(N mm)",
    twins="always: `proximal_bending leg i`",
)  # fmt: skip
bending = _of_leg(joints.compliance, "joint").enter(
    "gpm2002", LEGS, lambda formulation, target: (f"compliance joint {number(target)}",), name="proximal_bending",
    cause="A proximal link bends under the torque of its drive", formula="enc_i -= kappa tau_i", columns=("tau_{i}",),
    unit="rad/(N mm)", twins="always: `compliance joint i`",
)  # fmt: skip
stretch = _of_leg(lengths.stretch, "length").enter(
    "gpm2002", LEGS, cause="A distal link gives way to the force along it", formula="lb_i += k axial_i",
    columns=("axial_{i}",),
)  # fmt: skip
clearance = _of_leg(lengths.clearance, "length").enter(
    "gpm2002", LEGS, cause="The joints of a distal link have play along it",
    formula="lb_i += play / 2 * sign(axial_i)", columns=("axial_{i}",),
)  # fmt: skip


def _limited(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    built = joints.scale.make(family, formulation, target)
    assert isinstance(built, tuple)
    return tuple(replace(effect, largest=thresholds().largest_ratio) for effect in built)  # type: ignore[type-var]


gear = Recipe(joints.scale.words, _limited).enter(
    "gpm2002", JOINTS, cause="A gear ratio, or the scale of an encoder, is not the stated one",
    formula="enc_i += k enc_i", columns=("enc_{i}",), label="gear-ratio error",
)  # fmt: skip


def _cyclic(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    needs(formulation.data, f"enc_{number(target)}")
    if not teeth_of(formulation.data.metadata, number(target)):
        raise NotTestable("needs metadata tooth_numbers", ("metadata tooth_numbers",), missing=True)
    return harmonics.cyclic.make(family, formulation, target)


def _tooth(metadata: Mapping[str, Any], target: str) -> float:
    """Return the angle of one tooth [rad]; 0 where the tooth number is not stated."""
    teeth = teeth_of(metadata, number(target))
    return float(2 * np.pi / teeth) if teeth else 0.0


eccentricity = harmonics.eccentricity.enter(
    "gpm2002", JOINTS, cause="The disc of an encoder sits off its axis",
    formula="enc_i += arcsin(a cos enc_i + b sin enc_i)", columns=("enc_{i}",), unit="rad",
)  # fmt: skip
second_harmonic = harmonics.second_harmonic.enter(
    "gpm2002", JOINTS, cause="The disc of an encoder is oval, or tilted",
    formula="enc_i += atan2(u, 1 - v), u = a cos 2 enc_i + b sin 2 enc_i, v = b cos 2 enc_i - a sin 2 enc_i",
    columns=("enc_{i}",), unit="rad",
)  # fmt: skip
angle_error = harmonics.angle_error.enter(
    "gpm2002", JOINTS, formula="enc_i += sum over k = 1, 2, 3 of a_k cos k enc_i + b_k sin k enc_i",
    columns=("enc_{i}",), unit="rad",
)  # fmt: skip
cyclic = Recipe(harmonics.cyclic.words, _cyclic).enter(
    "gpm2002", JOINTS, formula="enc_i += sum over k = N, or N and 2 N, of a_k cos k enc_i + b_k sin k enc_i",
    columns=("enc_{i}", "metadata.tooth_numbers"), unit="rad", period=_tooth,
)  # fmt: skip


_LEGS = (1, 2, 3)


def _late_together(formulation: Formulation, target: str) -> tuple[str, ...]:
    return ("tracker_lag tracker",) if target == "all" and "x" in formulation.readings else ()


def _tracker(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    data = formulation.data
    needs(data, "x", "y")
    columns: tuple[str, ...] = ("speed", "heading")
    if not data.has(*columns):
        columns = ("vel_1", "vel_2", "vel_3")
        if not data.has(*columns):
            raise NotTestable(
                "needs columns speed and heading, or vel_1, vel_2, vel_3", ("speed", "heading"), missing=True
            )
    if "speed" in columns and not max(np.ptp(v) for v in _stated(data)) > 0:
        raise NotTestable("columns speed and heading are constant", ("speed", "heading"))

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        vx, vy = _stated(data) if "speed" in columns else _velocity(q, data)
        return {"x": vx[:, None], "y": vy[:, None]}

    used = ("x", "y", *columns)
    twins = ("lag all",) if data.has("vel_1", "vel_2", "vel_3") else ()
    return (tracker_lag.linear(target, used, {"tau": "s"}, changes, twins=twins),)


def _stated(data: MeasuredData) -> tuple[Array, Array]:
    return data["speed"] * np.cos(data["heading"]), data["speed"] * np.sin(data["heading"])


def _velocity(q: Quantities, data: MeasuredData) -> tuple[Array, Array]:
    """Return the velocity of the tracked point, mm/s, from those of the joints, by least squares over the legs.

    The distal link keeps its length: (P - B_i) . (P' - B_i') = 0.
    """
    rows, right = [], []
    for i in _LEGS:
        theta = q[f"enc_{i}"] + q[f"z{i}"]
        cos, sin, la, rate = np.cos(theta), np.sin(theta), q[f"la{i}"], data[f"vel_{i}"]
        ux, uy = q["x"] - q[f"xa{i}"] - la * cos, q["y"] - q[f"ya{i}"] - la * sin
        rows.append((ux, uy))
        right.append(la * rate * (uy * cos - ux * sin))
    xx, xy, yy = (sum(a[j] * a[k] for a in rows) for j, k in ((0, 0), (0, 1), (1, 1)))
    bx, by = (sum(a[j] * b for a, b in zip(rows, right)) for j in (0, 1))
    determinant = xx * yy - xy**2
    return (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant


lag = joints.lag.enter(
    "gpm2002", (*JOINTS, "all"), _late_together, cause="An encoder, or all of them, is read too early or too late",
    formula="enc_i += tau vel_i", columns=("vel_{i}",), twins="with x, y: `lag all` and `tracker_lag tracker`",
    label_of_all="timing lag of all encoders",
)  # fmt: skip
tracker_lag = EffectFamily(
    "tracker_lag", "gpm2002", "The tracker is read too early or too late", formula="(x, y) += tau (v_x, v_y)",
    channel="reading", columns=("x", "y", "speed, heading or vel_1..3"), unit="s", targets=("tracker",),
    build=_tracker, twins="with x, y: `tracker_lag tracker` and `lag all`",
).enter()  # fmt: skip


_JOINTS = ("joint 1", "joint 2", "joint 3")


def _none(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    return ()


quantisation = EffectFamily(
    "quantisation", "gpm2002", "An encoder is read in steps coarser than stated",
    formula="enc_i = step * whole number", channel="noise", columns=("enc_{i}",), unit="rad", targets=_JOINTS,
    build=_none,
).enter()  # fmt: skip
outlier = EffectFamily(
    "outlier", "gpm2002", "Some readings of one encoder are far off",
    formula="enc_i += spread * N(0, 1) on few readings", channel="noise", columns=("enc_{i}",), unit="rad",
    targets=_JOINTS, build=_none,
).enter()  # fmt: skip
heavy_tails = EffectFamily(
    "heavy_tails", "gpm2002", "The noise of all readings has heavier tails than a Gaussian",
    formula="excess kurtosis of the whitened residuals", channel="noise", columns=(), unit="1", targets=("all",),
    build=_none,
).enter()  # fmt: skip


slip = columns.slip.enter(
    "gpm2002", JOINTS, cause="An encoder slips on its shaft once during the run",
    formula="enc_i += step from a time on", columns=("t_s",), unit="rad", label="encoder slip",
)  # fmt: skip


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
        base.linear(
            target,
            ("temp_K",),
            dict(zip(names[:wide], units[:wide], strict=True)),
            partial(changes, late, wide),
            unit="1/K",
            twins=twins,
        )
        for wide in ((1, 3) if tracked else (1,))  # about the middle of the base; about a point that the data find
        for late in time_constants(formulation.data, "t_s")
    )


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
    formula="A_i += (alpha (A_i - mean A) + d) T; T follows temp_K; d = 0 with angles only", channel="base",
    columns=("temp_K",), unit="1/K", targets=("all",), build=_base, twins="angles only: `thermal_links all`",
    label="thermal growth of the base", label_of_all="thermal growth of the base", parted_by=_PARTED,
).enter()  # fmt: skip
