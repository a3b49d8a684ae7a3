"""Readings taken late: by one encoder, by all of them, or by the tracker. While the machine moves they are displaced.

Only the lag between instruments can be seen. Angles only: encoders that are late together are not late at all. With a
tracker: all encoders late is the tracker early, an exact twin as far as the stated velocities agree.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.effects.general import joints
from calibench.discrepancy.machines.gpm2002.roles import JOINTS
from calibench.discrepancy.model.effect import Effect, NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array

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
    return (
        LinearEffect(
            "tracker_lag", target, tracker_lag.formula, "reading", used, ("tau",), ("s",), "s", changes, twins
        ),
    )


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
    "tracker_lag", "gpm2002", "The tracker is read too early or too late", "(x, y) += tau (v_x, v_y)", "reading",
    ("x", "y", "speed, heading or vel_1..3"), "s", ("tracker",), _tracker,
    "with x, y: `tracker_lag tracker` and `lag all`",
).enter()  # fmt: skip
