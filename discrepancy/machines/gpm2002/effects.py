"""The catalogue of the GPM2002: a family of effects for each cause, by what it acts on.

Coefficients are positive for what gives way: tau_i is the torque of the motor on its link, axial_i is above zero in
tension. Exact twins are a twisting drive and a bending proximal link; with angles only, links that grow and a base that
shrinks; with a tracker, all encoders late and the tracker early. Noise other than stated changes no mean:
`discrepancy.noise.laws` tests for it. Members follow a thermometer late, by a time constant that nobody states.
"""

from functools import partial

import numpy as np

from calibench.discrepancy.effects.general import columns, harmonics, joints, lengths
from calibench.discrepancy.effects.general.lengths import grown, time_constants, warmth
from calibench.discrepancy.effects.general.recipe import Built, Recipe, changed
from calibench.discrepancy.machines.gpm2002.formulation import JOINTS, LEGS, teeth_of
from calibench.discrepancy.model.effect import EffectFamily, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_OF_LEGS = tuple(f"leg {i}" for i in LEGS)

backlash = joints.backlash.enter(
    "gpm2002", JOINTS, formula="enc_i -= play / 2 * dir_i", columns=("dir_{i}",), unit="rad"
)


def _base_shift(formulation: Formulation, target: str) -> Built:
    needs(formulation.data, "t_s")
    i = target[-1]
    changes = {f"xa{i}": ("dx", "mm", 1.0), f"ya{i}": ("dy", "mm", 1.0)}
    return base_shift.steps(target, "t_s", formulation.data["t_s"], changes)


base_shift = EffectFamily(
    "base_shift", "gpm2002", "A base is displaced once during the run", formula="A_i += (dx, dy) from a time on",
    channel="base", columns=("t_s",), unit="mm", targets=("base 1", "base 2", "base 3"), build=_base_shift,
).enter()  # fmt: skip


drift = columns.drift.enter(
    "gpm2002", JOINTS, cause="The zero of an encoder drifts during the run",
    formula="enc_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run",
    columns=("t_s",), unit="rad",
)  # fmt: skip


def _of_leg(made: Recipe, part: str) -> Recipe:
    """Return a recipe whose target is a leg; the general recipe asks for its joint or its `distal link`."""
    return Recipe(
        made.words,
        lambda family, formulation, target: changed(
            made.make(family, formulation, f"{part} {int(target[-1])}"), target=target
        ),
    )


compliance = joints.compliance.enter(
    "gpm2002", JOINTS, lambda formulation, target: (f"proximal_bending leg {int(target[-1])}",),
    cause="A drive twists under its torque", formula="enc_i -= kappa tau_i", columns=("tau_{i}",), unit="rad/(N mm)",
    twins="always: `proximal_bending leg i`",
)  # fmt: skip
bending = _of_leg(joints.compliance, "joint").enter(
    "gpm2002", _OF_LEGS, lambda formulation, target: (f"compliance joint {int(target[-1])}",), name="proximal_bending",
    cause="A proximal link bends under the torque of its drive", formula="enc_i -= kappa tau_i", columns=("tau_{i}",),
    unit="rad/(N mm)", twins="always: `compliance joint i`",
)  # fmt: skip
stretch = _of_leg(lengths.stretch, "distal link").enter(
    "gpm2002", _OF_LEGS, cause="A distal link gives way to the force along it", formula="lb_i += k axial_i",
    columns=("axial_{i}",),
)  # fmt: skip
clearance = _of_leg(lengths.clearance, "distal link").enter(
    "gpm2002", _OF_LEGS, cause="The joints of a distal link have play along it",
    formula="lb_i += play / 2 * sign(axial_i)", columns=("axial_{i}",),
)  # fmt: skip


gear = Recipe(
    joints.scale.words,
    lambda family, formulation, target: changed(
        joints.scale.make(family, formulation, target), largest=thresholds().largest_ratio
    ),
).enter(
    "gpm2002", JOINTS, cause="A gear ratio, or the scale of an encoder, is not the stated one",
    formula="enc_i += k enc_i", columns=("enc_{i}",), label="gear-ratio error",
    bounds=("largest_ratio",),
)  # fmt: skip


def _cyclic(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    needs(formulation.data, f"enc_{int(target[-1])}")
    if not teeth_of(formulation.data.metadata, int(target[-1])):
        raise NotTestable("needs metadata tooth_numbers", ("metadata tooth_numbers",), missing=True)
    return harmonics.cyclic.make(family, formulation, target)


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
    columns=("enc_{i}", "metadata.tooth_numbers"), unit="rad",
    period=lambda metadata, target: 2 * np.pi / (teeth_of(metadata, int(target[-1])) or np.inf),  # of one tooth
)  # fmt: skip


def _tracker(formulation: Formulation, target: str) -> Built:
    data = formulation.data
    needs(data, "x", "y")
    stated = data.has("speed", "heading")
    columns = ("speed", "heading") if stated else ("vel_1", "vel_2", "vel_3")
    if not data.has(*columns):
        raise NotTestable("needs columns speed and heading, or vel_1, vel_2, vel_3", ("speed", "heading"), missing=True)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        if stated:
            speed, heading = data["speed"], data["heading"]
            return {"x": (speed * np.cos(heading))[:, None], "y": (speed * np.sin(heading))[:, None]}

        # the velocity of the tracked point, mm/s, from those of the joints, by least squares over the legs: the distal
        # link keeps its length, (P - B_i) . (P' - B_i') = 0
        rows, right = [], []
        for i in LEGS:
            theta = q[f"enc_{i}"] + q[f"z{i}"]
            cos, sin, la, rate = np.cos(theta), np.sin(theta), q[f"la{i}"], data[f"vel_{i}"]
            ux, uy = q["x"] - q[f"xa{i}"] - la * cos, q["y"] - q[f"ya{i}"] - la * sin
            rows.append((ux, uy))
            right.append(la * rate * (uy * cos - ux * sin))
        xx, xy, yy = (sum(a[j] * a[k] for a in rows) for j, k in ((0, 0), (0, 1), (1, 1)))
        bx, by = (sum(a[j] * b for a, b in zip(rows, right)) for j in (0, 1))
        determinant = xx * yy - xy**2
        vx, vy = (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant
        return {"x": vx[:, None], "y": vy[:, None]}

    if stated and not max(np.ptp(v) for v in changes({}, data).values()) > 0:
        raise NotTestable("columns speed and heading are constant", ("speed", "heading"))
    twins = ("lag all",) if data.has("vel_1", "vel_2", "vel_3") else ()
    most = thresholds().largest_lag
    return tracker_lag.linear(target, ("x", "y", *columns), {"tau": "s"}, changes, twins=twins, largest=most)


lag = joints.lag.enter(
    "gpm2002", (*JOINTS, "all"),
    lambda formulation, target: ("tracker_lag tracker",) * (target == "all" and "x" in formulation.readings),
    cause="An encoder, or all of them, is read too early or too late",
    formula="enc_i += tau vel_i", columns=("vel_{i}",), twins="with x, y: `lag all` and `tracker_lag tracker`",
    label_of_all="timing lag of all encoders",
)  # fmt: skip
tracker_lag = EffectFamily(
    "tracker_lag", "gpm2002", "The tracker is read too early or too late", formula="(x, y) += tau (v_x, v_y)",
    channel="reading", columns=("x", "y", "speed, heading or vel_1..3"), unit="s", targets=("tracker",),
    build=_tracker, twins="with x, y: `tracker_lag tracker` and `lag all`", bounds=("largest_lag",),
).enter()  # fmt: skip


for _name, _cause, _formula, _unit, _targets in (  # laws of noise: no candidate changes a quantity
    ("quantisation", "An encoder is read in steps coarser than stated", "enc_i = step * whole number", "rad", JOINTS),
    ("outlier", "Some readings of one encoder are far off", "enc_i += spread * N(0, 1) on few readings", "rad",
     JOINTS),
    ("heavy_tails", "The noise of all readings has heavier tails than a Gaussian",
     "excess kurtosis of the whitened residuals", "1", ("all",)),
):  # fmt: skip
    EffectFamily(
        _name, "gpm2002", _cause, formula=_formula, channel="noise", columns=("enc_{i}",) if _targets is JOINTS else (),
        unit=_unit, targets=_targets, build=lambda formulation, target: (),
    ).enter()  # fmt: skip


slip = columns.slip.enter(
    "gpm2002", JOINTS, cause="An encoder slips on its shaft once during the run",
    formula="enc_i += step from a time on", columns=("t_s",), unit="rad", label="encoder slip",
)  # fmt: skip


_PARTED = "columns x, y: an external tracker sees whether links or base grow"


def _links(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    needs(formulation.data, "temp_K")
    legs = LEGS if target == "all" else (int(target[-1]),)
    heat = {f"{link}{leg}": "temp_K" for leg in legs for link in ("la", "lb")}
    return grown(family, target, heat, formulation.data, "t_s")


def _base(formulation: Formulation, target: str) -> Built:
    needs(formulation.data, "temp_K")
    tracked = "x" in formulation.readings

    def changes(late: float, wide: int, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        changed, heat = {}, warmth(data, late, "temp_K", "t_s", formulation.data)
        for own, axis in enumerate("xy", start=1):
            middle = sum(q[f"{axis}a{i}"] for i in LEGS) / 3
            for i in LEGS:
                column = np.zeros((len(data), wide))
                column[:, 0] = (q[f"{axis}a{i}"] - middle) * heat
                if wide > 1:
                    column[:, own] = heat
                changed[f"{axis}a{i}"] = column
        return changed

    forms = [{"alpha": "1/K"}]  # about the middle of the base; about a point that the data find
    forms += [{"alpha": "1/K", "d_x": "mm/K", "d_y": "mm/K"}] * tracked
    twins = () if tracked else ("thermal_links all",)
    return tuple(
        base.linear(target, ("temp_K",), units, partial(changes, late, len(units)), unit="1/K", twins=twins)
        for units in forms
        for late in time_constants(formulation.data, "t_s")
    )


_GROWTH = Recipe(lengths.growth.words, _links)
links = _GROWTH.enter(
    "gpm2002", ("all",),
    lambda formulation, target: () if "x" in formulation.readings else ("thermal_base all",),
    name="thermal_links", cause="All links grow with temperature",
    formula="la_i, lb_i *= 1 + alpha T, i = 1, 2, 3; T follows temp_K", columns=("temp_K",),
    twins="angles only: `thermal_base all`", label_of_all="thermal growth of all links", parted_by=_PARTED,
)  # fmt: skip
leg = _GROWTH.enter(
    "gpm2002", _OF_LEGS, name="thermal_leg", cause="The links of one leg grow with temperature",
    formula="la_i, lb_i *= 1 + alpha T; T follows temp_K", columns=("temp_K",), label_of_all="",
)  # fmt: skip
base = EffectFamily(
    "thermal_base", "gpm2002", "The base grows with temperature about a point",
    formula="A_i += (alpha (A_i - mean A) + d) T; T follows temp_K; d = 0 with angles only", channel="base",
    columns=("temp_K",), unit="1/K", targets=("all",), build=_base, twins="angles only: `thermal_links all`",
    label="thermal growth of the base", label_of_all="thermal growth of the base", parted_by=_PARTED,
).enter()  # fmt: skip
