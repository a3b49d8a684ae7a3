"""The exact Orthoglide with everything that may be wrong with it: axes, joints, legs, bars, gauges.

Three spheres of radius L_i about the joint centres A_i meet in the tool centre point p, eq. (2) with the joint centres
anywhere. The perfect machine has A_i = rho_i e_i. A gauge at a leg keeps its plane across the leg, section 3.2, and
reads along `direction` how far the leg's line has gone from where it crossed that plane at Zero.

Quantities beside the six parameters, mm and rad, zero where nothing is wrong (i, j, k are x, y, z):
tilt_ij, offset_ij: axis i leans towards j, is shifted along j. joint_i, length_i: joint i stands further, leg i is
longer than it should at the posture; joint_i_zero, length_i_zero: at the Zero it is compared with. skew_ij: the bar of
leg i that the gauge touches ends at the tool that far along j of where it should. tilt_ij_now, tilt_ij_zero and so on:
what a tilt, an offset or a skew is more at the posture, and at that Zero. gauge_roll: the gauge is turned about the
leg, towards the other direction across it; gauge_pitch: towards +leg; gauge_shift: its plane cuts the leg's axis that
much further from the origin than stated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from calibench.discrepancy.machines.orthoglide.validate import Rows
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, geometry

PAIRS = tuple((i, j) for i in range(3) for j in range(3) if i != j)
FIXED = ("tilt", "offset", "skew")  # the same at every moment, but for what is said to be more at one
GAUGE = ("gauge_roll", "gauge_pitch", "gauge_shift")
IMPERFECTIONS = (
    *(f"{kind}_{AXES[i]}{AXES[j]}{when}" for kind in FIXED for i, j in PAIRS for when in ("", "_now", "_zero")),
    *(f"{kind}_{axis}{when}" for kind in ("joint", "length") for axis in AXES for when in ("", "_zero")),
    *GAUGE,
)


def deviations(rows: Rows, q: Quantities) -> Numbers:
    """Return the deviations the gauges must show, shape (n,), mm."""
    gauge = _gauges(rows, q)
    read = gauge.read(gauge.after) - np.where(rows.against == 0, 0.0, gauge.read(gauge.before))
    return np.asarray(read)


def slopes(rows: Rows, q: Quantities) -> dict[str, Array]:
    """Return the derivative of `deviations` in each quantity but the reading, name -> (n,)."""
    gauge = _gauges(rows, q)
    compared = np.where(rows.against == 0, 0.0, -1.0)
    found = {name: np.zeros(len(rows.level)) for name in (*_PARAMETERS, *IMPERFECTIONS)}
    centre_zero, tool_zero = np.zeros((2, len(rows.level), 3))
    for posture, weight, when in ((gauge.after, 1.0, ""), (gauge.before, compared, "_zero")):
        across, share = gauge.across(posture), gauge.share(posture)
        rise = gauge.rise(posture) - gauge.rise(gauge.zero)
        slope, pitch = gauge.slope(posture), gauge.pitch
        gain = weight / (1 - slope * pitch)
        lever = weight * rise * pitch / (1 - slope * pitch) ** 2 / gauge.span(posture)
        gauge.push(
            found,
            posture,
            across * ((1 - share) * gain - lever)[:, None],
            across * (share * gain + lever)[:, None],
            when,
        )
        turned = gauge.turned(posture) - gauge.turned(gauge.zero)
        found["gauge_roll"] += (
            gain * turned + weight * rise * pitch * gauge.turned_slope(posture) / (1 - slope * pitch) ** 2
        )
        found["gauge_pitch"] += weight * rise * slope / (1 - slope * pitch) ** 2
        share_zero, plane = gauge.share(gauge.zero), gain * (slope - gauge.slope(gauge.zero))
        found["gauge_shift"] += plane
        across_zero = gauge.across(gauge.zero) * -gain[:, None]
        centre_zero += across_zero * (1 - share_zero)[:, None] + gauge.along * (plane * (1 - rows.share))[:, None]
        tool_zero += across_zero * share_zero[:, None] + gauge.along * (plane * rows.share)[:, None]
    gauge.push(found, gauge.zero, centre_zero, tool_zero, "_zero", rows.against == 0)
    return found


_PARAMETERS = (*(f"drho_{a}" for a in AXES), *(f"dL_{a}" for a in AXES))


@final
@dataclass(frozen=True, eq=False)
class _Posture:
    """Joint centres and axes, shape (n, 3, 3) and (3, n, 3), true joints and lengths, tool and bar's end, (n, 3).

    `centre` is the joint centre of the leg that is measured, (n, 3); `norms` those of the axes before, (3, n).
    """

    centres: Numbers
    centre: Numbers
    axes: Numbers
    norms: Numbers
    joints: Numbers
    lengths: Numbers
    tool: Numbers
    end: Numbers


@final
@dataclass(frozen=True, eq=False)
class _Gauges:
    """The gauges of all rows: where their planes are, which way they read, and the three postures of each row."""

    rows: Rows
    q: Quantities
    after: _Posture
    before: _Posture
    zero: _Posture

    @cached_property
    def along(self) -> Array:
        return np.eye(3)[self.rows.leg]

    @property
    def pitch(self) -> Numbers:
        return self.q["gauge_pitch"]

    @cached_property
    def reads(self) -> Numbers:
        """Return the direction a gauge reads across its leg, shape (n, 3)."""
        roll = np.asarray(self.q["gauge_roll"])[..., None]
        return np.asarray(np.cos(roll) * np.eye(3)[self.rows.direction] + np.sin(roll) * np.eye(3)[self.rows.other])

    @cached_property
    def plane(self) -> Numbers:
        """Return where a gauge's plane cuts the leg's axis, shape (n,), eq. (10) for a gauge at any share."""
        share, at = self.rows.share, self.zero
        place = share * _dot(at.end, self.along) + (1 - share) * _dot(at.centre, self.along)
        return np.asarray(place + self.q["gauge_shift"])

    def read(self, at: _Posture) -> Numbers:
        """Return how far the gauge's tip has gone since Zero, shape (n,): a pitched one slides along a sloping leg."""
        return np.asarray((self.rise(at) - self.rise(self.zero)) / (1 - self.slope(at) * self.pitch))

    def rise(self, at: _Posture) -> Numbers:
        """Return where the leg crosses the gauge's plane, along the direction it reads, shape (n,)."""
        return _dot(self._crossing(at), self.reads)

    def share(self, at: _Posture) -> Numbers:
        """Return mu of section 3.2, the share of the leg at which it crosses the plane, shape (n,)."""
        return np.asarray((self.plane - _dot(at.centre, self.along)) / self.span(at))

    def span(self, at: _Posture) -> Numbers:
        return _dot(at.end - at.centre, self.along)

    def slope(self, at: _Posture) -> Numbers:
        """Return how much the leg rises along the direction read for a step along the axis, shape (n,)."""
        return np.asarray(_dot(at.end - at.centre, self.reads) / self.span(at))

    def across(self, at: _Posture) -> Numbers:
        """Return d rise / d place of the leg's line, shape (n, 3)."""
        return np.asarray(self.reads - self.slope(at)[:, None] * self.along)

    def turned(self, at: _Posture) -> Numbers:
        """Return d rise / d roll, shape (n,)."""
        return _dot(self._crossing(at), self._turn)

    def _crossing(self, at: _Posture) -> Numbers:
        """Return where the leg crosses the gauge's plane, shape (n, 3)."""
        return np.asarray(at.centre + self.share(at)[:, None] * (at.end - at.centre))

    def turned_slope(self, at: _Posture) -> Numbers:
        return np.asarray(_dot(at.end - at.centre, self._turn) / self.span(at))

    def push(
        self, found: dict[str, Array], at: _Posture, centre: Array, tool: Array, when: str, where: Array | bool = True
    ) -> None:
        """Add to `found` what a posture's quantities do, given d read / d centre of the leg and d read / d bar's end.

        Joints and lengths of the moment (`when`) are pushed only `where` the posture is that moment's.
        """
        legs = np.arange(len(centre))
        rays = at.tool[:, None, :] - at.centres  # M of the relations before eq. (5)
        weights = np.linalg.solve(rays.swapaxes(1, 2), tool[:, :, None])[:, :, 0]
        on_centres = weights[:, :, None] * rays
        on_centres[legs, self.rows.leg] += centre
        for i, axis in enumerate(AXES):
            joint, length = _dot(on_centres[:, i], at.axes[i]), weights[:, i] * at.lengths[:, i]
            for name, value in ((f"drho_{axis}", joint), (f"dL_{axis}", length)):
                found[name] += value
            found[f"joint_{axis}{when}"] += np.where(where, joint, 0.0)
            found[f"length_{axis}{when}"] += np.where(where, length, 0.0)
        for i, j in PAIRS:
            ij = AXES[i] + AXES[j]
            lean = (np.eye(3)[j] - at.axes[i] * at.axes[i][:, j : j + 1]) / at.norms[i][:, None]
            for kind, value in (
                ("tilt", at.joints[:, i] * _dot(on_centres[:, i], lean)),
                ("offset", on_centres[:, i, j]),
                ("skew", np.where(self.rows.leg == i, tool[:, j], 0.0)),
            ):
                found[f"{kind}_{ij}"] += value
                found[f"{kind}_{ij}{when or '_now'}"] += np.where(where, value, 0.0)

    @cached_property
    def _turn(self) -> Numbers:
        roll = np.asarray(self.q["gauge_roll"])[..., None]
        return np.asarray(np.cos(roll) * np.eye(3)[self.rows.other] - np.sin(roll) * np.eye(3)[self.rows.direction])


def _gauges(rows: Rows, q: Quantities) -> _Gauges:
    at_zero = rows.against == 0
    after, before = _posture(rows, q, rows.level, "", True), _posture(rows, q, rows.against, "_zero", True)
    return _Gauges(rows, q, after, before, _posture(rows, q, np.zeros(len(rows.level)), "_zero", at_zero))


def _posture(rows: Rows, q: Quantities, level: Array, when: str, moment: Array | bool) -> _Posture:
    """Return the posture with the tool sent to `level`; errors of the moment `when` count where `moment`."""
    commanded, n = rows.joints(level), len(level)
    joints, lengths, centres, axes, norms = [], [], [], [], []
    for i, axis in enumerate(AXES):
        joints.append(commanded[:, i] + q[f"drho_{axis}"] + np.where(moment, q[f"joint_{axis}{when}"], 0.0))
        lengths.append(
            geometry().length + q[f"dL_{axis}"] + np.where(moment, q[f"length_{axis}{when}"], 0.0) + np.zeros(n)
        )
        leaning = _components(i, "tilt", q, n, 1.0, when, moment)
        norms.append(np.sqrt(_dot(leaning, leaning)))
        axes.append(leaning / norms[i][:, None])
        centres.append(_components(i, "offset", q, n, 0.0, when, moment) + joints[i][:, None] * axes[i])
    radii = np.stack(lengths, axis=1)
    tool = _meet(centres, radii)
    skew = np.stack([_components(i, "skew", q, n, 0.0, when, moment) for i in range(3)], axis=1)[np.arange(n), rows.leg]
    stacked = np.stack(centres, axis=1)
    own = stacked[np.arange(n), rows.leg]
    along, sizes = np.stack(axes), np.stack(norms)
    return _Posture(stacked, own, along, sizes, np.stack(joints, axis=1), radii, tool, tool + skew)


def _meet(centres: list[Numbers], radii: Numbers) -> Numbers:
    """Return where three spheres meet on the side of the origin, shape (n, 3): eqs. (2) solved without rotation."""
    one, two = centres[1] - centres[0], centres[2] - centres[0]
    b1 = (_dot(one, one) + radii[:, 0] ** 2 - radii[:, 1] ** 2) / 2
    b2 = (_dot(two, two) + radii[:, 0] ** 2 - radii[:, 2] ** 2) / 2
    g11, g12, g22 = _dot(one, one), _dot(one, two), _dot(two, two)
    square = g11 * g22 - g12**2  # of twice the triangle's area
    foot = ((b1 * g22 - b2 * g12) / square)[:, None] * one + ((b2 * g11 - b1 * g12) / square)[:, None] * two
    normal = np.cross(one, two)
    height = np.sqrt((radii[:, 0] ** 2 - _dot(foot, foot)) / square)
    return np.asarray(centres[0] + foot - height[:, None] * normal)


def _components(
    i: int, kind: str, q: Quantities, n: int, own: float, when: str, moment: Array | bool
) -> Numbers:  # fmt: skip
    """Return the vector, (n, 3), of `own` along axis i and the quantities kind_ij along the others, at a moment."""
    parts: list[Any] = []
    for j in range(3):
        name = f"{kind}_{AXES[i]}{AXES[j]}"
        parts.append(own if j == i else _with_more(q[name], q[f"{name}{when or '_now'}"], moment))
    vector = np.empty((n, 3), dtype=np.result_type(*parts))
    for j, part in enumerate(parts):
        vector[:, j] = part
    return vector


def _with_more(value: Any, more: Any, moment: Array | bool) -> Any:
    nothing = np.ndim(more) == 0 and more == 0
    return value if nothing else value + np.where(moment, more, 0.0)


def _dot(a: Numbers, b: Numbers) -> Numbers:
    return np.asarray((a * b).sum(axis=-1))
