"""Measurement plans of an Orthoglide: a plan is a tuple of `Reading`s, the paper's twelve or more.

A gauge stands at a place on a leg and reads one direction across it; the tool moves along an axis; the deviation is the
leg's place there minus that at the Zero posture. The paper moves each leg along its own axis to Max and Min only. Named
plans go beyond that, so that rank, condition and standard errors can be compared before anything is measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, PAPER, geometry, inverse_kinematics

PlanName = Literal["paper", "positions", "levels", "both_ways", "cross", "payload", "rich"]
_SHARES = (0.35, 0.5, 0.65, 0.8)  # the gauge must stay on the leg: .322 .. .806 between Min and Max
_PAYLOADS = (0.0, 10.0, 20.0)  # N; ours, as the paper loads nothing


@dataclass(frozen=True, slots=True)
class Reading:
    """One deviation [mm]: of `leg` along `direction`, with the tool moved `level_mm` from Zero along `axis`.

    `gauge_position` is the share of the leg from its joint centre (0) to the tool (1) where the gauge stands at Zero.
    `against_mm` is the level it is compared with: 0, the Zero posture; Table 1 compares Max with Min. The direction of
    approach, the payload and the repeat name distinct readings; the six-parameter model does not know them otherwise.
    """

    leg: str
    direction: str
    axis: str
    level_mm: float
    gauge_position: float = 0.5
    against_mm: float = 0.0
    approach: Literal["fwd", "rev"] = "fwd"
    payload_N: float = 0.0
    repeat: int = 0

    @property
    def label(self) -> str:
        """Return the paper's name of the deviation, x_y+ for x of the y-leg at its Max, with what the paper has not."""
        own = geometry()
        strokes = {own.stroke_plus: "+", own.stroke_minus: "-"}
        if self.against_mm:
            return f"{self.direction}_{self.leg}"
        end = strokes.get(self.level_mm, f"{self.level_mm:+g}") if self.axis == self.leg else ""
        return (
            f"{self.direction}_{self.leg}{end}" if end else f"{self.direction}_{self.leg}@{self.axis}{self.level_mm:+g}"
        )


Plan = tuple[Reading, ...]


def named_plan(name: str) -> Plan:
    """Return the plan of this name; raise `ValueError` that lists the names where there is none.

    paper: 12 readings at Max and Min. positions: four places of the gauge. levels: halfway too. both_ways: each posture
    approached from both sides. cross: also with the tool moved along the other two axes. payload: three loads.
    rich: positions and levels, own axis and cross moves.
    """
    if name not in get_args(PlanName):
        raise ValueError(f"plan={name}: {suggest(name, get_args(PlanName))}; or a CSV file that lists the readings")
    own = geometry()
    ends = (own.stroke_plus, own.stroke_minus)
    steps = (own.stroke_plus, own.stroke_plus / 2, own.stroke_minus / 2, own.stroke_minus)
    plan = [
        Reading(
            leg,
            direction,
            axis=axis,
            level_mm=level,
            gauge_position=share,
            against_mm=0.0,
            approach=approach,
            payload_N=payload,
        )
        for leg, direction, axis in _moves(cross=name in ("cross", "rich"))
        for share in (_SHARES if name in ("positions", "rich") else _SHARES[1:2])
        for approach in (get_args(Literal["fwd", "rev"]) if name == "both_ways" else ("fwd",))
        for payload in (_PAYLOADS if name == "payload" else _PAYLOADS[:1])
        for level in (steps if name in ("levels", "rich") else ends)
    ]
    return paper_plan() if name == "paper" else tuple(plan)


def paper_plan() -> Plan:
    """Return the twelve readings of section 3.1 in the order of the rows of eq. (11)."""
    own = geometry()
    return tuple(
        Reading(leg, direction, leg, level, constants.column(PAPER, "equation11")["gauge_fraction"])
        for first, second in (("x", "y"), ("y", "z"), ("x", "z"))
        for level in (own.stroke_plus, own.stroke_minus)
        for direction, leg in ((first, second), (second, first))
    )


def difference_plan() -> Plan:
    """Return the six differences of Max and Min in the order of Table 1: x_y x_z y_x y_z z_x z_y."""
    own = geometry()
    share = constants.column(PAPER, "equation11")["gauge_fraction"]
    pairs = [(d, leg) for d in AXES for leg in AXES if d != leg]
    return tuple(Reading(leg, d, leg, own.stroke_plus, share, own.stroke_minus) for d, leg in pairs)


def check_plan(plan: Sequence[Reading]) -> None:
    """Raise `ValueError` for a reading that no Orthoglide can give: the message names it and says what is possible."""
    own, seen = geometry(), dict[Reading, int]()
    for number, reading in enumerate(plan, start=1):
        where = f"reading {number} ({reading.label})"
        if seen.setdefault(reading, number) != number:
            raise ValueError(f"{where} is reading {seen[reading]} again; number the two by repeat")
        for key in ("leg", "direction", "axis"):
            if getattr(reading, key) not in AXES:
                raise ValueError(f"{where}: {key}={getattr(reading, key)!r}: x, y or z is needed")
        if reading.direction == reading.leg:
            raise ValueError(f"{where}: a gauge along its own leg {reading.leg} reads nothing; take another direction")
        if reading.level_mm == reading.against_mm:
            raise ValueError(f"{where}: level_mm={reading.level_mm:g} is compared with itself; leave the row out")
        for level in (reading.level_mm, reading.against_mm):
            along = np.eye(3)[[AXES.index(reading.axis)]]
            there = own.stroke_minus - 1e-9 <= level <= own.stroke_plus + 1e-9
            if not (there and np.isfinite(inverse_kinematics(level * along)).all()):
                raise ValueError(
                    f"{where}: level_mm={level:g} is out of reach: {own.stroke_minus:g} .. {own.stroke_plus:g} mm"
                )
            share = _share(reading, level)
            if not -1e-9 <= share <= 1 + 1e-9:
                raise ValueError(
                    f"{where}: gauge_position={reading.gauge_position:g} is off the leg at level_mm={level:g} "
                    f"(share {share:.2f} of it, 0 .. 1 is needed); move the gauge or take a smaller level"
                )


def postures(plan: Sequence[Reading]) -> tuple[Array, NDArray[np.int64]]:
    """Return the commanded joints, shape (k, 3), mm, Zero first, and rows (m, 4): leg, direction, two postures."""
    places: dict[tuple[str, float], int] = {}

    def number(axis: str, level: float) -> int:
        return 0 if level == 0 else places.setdefault((axis, level), len(places) + 1)

    rows = [
        (AXES.index(r.leg), AXES.index(r.direction), number(r.axis, r.level_mm), number(r.axis, r.against_mm))
        for r in plan
    ]
    points = [np.zeros(3), *(level * np.eye(3)[AXES.index(axis)] for axis, level in places)]
    return inverse_kinematics(np.array(points)), np.array(rows, dtype=np.int64)


def differences(plan: Sequence[Reading]) -> Array:
    """Return D, shape (m, g): each deviation is +1 and -1 of two of the g readings taken of the gauges, eq. (13).

    What is read once at Zero is subtracted from every posture of the same gauge (and approach, payload, repeat), so the
    noise of the deviations has covariance sigma^2 D D^T; for the paper's plan that is eq. (14).
    """
    taken: dict[tuple[object, ...], int] = {}
    pairs = []
    for r in plan:
        gauge = (r.leg, r.direction, r.gauge_position, r.approach, r.payload_N, r.repeat)
        pair = [
            taken.setdefault((*gauge, r.axis if level else "", level), len(taken))
            for level in (r.level_mm, r.against_mm)
        ]
        pairs.append(pair)
    matrix = np.zeros((len(pairs), len(taken)))
    for k, (after, before) in enumerate(pairs):
        matrix[k, after], matrix[k, before] = 1.0, -1.0
    return matrix


def covariance(plan: Sequence[Reading]) -> Array:
    """Return E(ds ds^T) / sigma^2 of the deviations of a plan, shape (m, m), eq. (14) for any plan."""
    matrix = differences(plan)
    return np.asarray(matrix @ matrix.T)


def _moves(cross: bool) -> Iterable[tuple[str, str, str]]:
    """Return (leg, direction, axis): the tool moved along the leg, and with `cross` along the other axes too."""
    return [(leg, d, axis) for leg, d, axis in product(AXES, repeat=3) if d != leg and (cross or axis == leg)]


def _share(reading: Reading, level: float) -> float:
    """Return mu, where on the nominal leg the gauge's plane meets it with the tool moved to `level`."""
    length, own = geometry().length, reading.axis == reading.leg
    reach = length if own else float(np.sqrt(length**2 - level**2))  # along the leg's axis, joint centre to tool
    centre = length + level if own else reach
    return (centre - (1 - reading.gauge_position) * length) / reach
