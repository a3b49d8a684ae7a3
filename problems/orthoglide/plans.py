"""Measurement plans of an Orthoglide, a tuple of `Reading`s each, and what was measured on them.

A gauge stands at a place on a leg and reads one direction across it; the deviation is the leg's place there minus that
at the Zero posture. The paper moves each leg along its own axis to Max and Min only; named plans go beyond that.
Measured are the paper's five sets (Table 1: six differences, Max minus Min; Table 2: twelve, each against Zero) and a
user's own table. Experiment 3 is printed in both with values that cannot be one measurement: they are never mixed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from calibench.core.options import suggest
from calibench.core.tables.columns import Declared, Quantity
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, PAPER, geometry, inverse_kinematics

PlanName = Literal["paper", "positions", "levels", "both_ways", "cross", "payload", "rich"]
_SHARES = (0.35, 0.5, 0.65, 0.8)  # the gauge must stay on the leg: .322 .. .806 between Min and Max
_PAYLOADS = (0.0, 10.0, 20.0)  # N; ours, as the paper loads nothing
SetName = Literal["exp1", "exp2", "exp2_t1", "exp3_t1", "exp3_t2"]
_SETS = {"exp1": "table1.exp1", "exp2": "table2.exp2", "exp2_t1": "table1.exp2", "exp3_t1": "table1.exp3",
         "exp3_t2": "table2.exp3"}  # fmt: skip
_ENDS = {"+": "plus", "-": "minus"}
_PLAN = Declared(columns=(
    *(Quantity(name, text=True, needed=True) for name in ("leg", "direction", "posture")),
    Quantity("gauge_position"), Quantity("level_mm", "mm"), Quantity("against_mm", "mm"), Quantity("pass", text=True),
    Quantity("payload_N", "N", "payload"), Quantity("repeat"),
))  # fmt: skip
_READ = replace(_PLAN, columns=(*_PLAN.columns, Quantity("deviation", "mm", "the reading", needed=True)))


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
        if self.against_mm:
            return f"{self.direction}_{self.leg}"
        strokes = {geometry().stroke_plus: "+", geometry().stroke_minus: "-"}
        if self.axis != self.leg:
            return f"{self.direction}_{self.leg}@{self.axis}{self.level_mm:+g}"
        return f"{self.direction}_{self.leg}{strokes.get(self.level_mm, f'{self.level_mm:+g}')}"


Plan = tuple[Reading, ...]


def named_plan(name: str) -> Plan:
    """Return the plan of this name; raise `ValueError` that lists the names where there is none.

    paper: 12 readings at Max and Min. positions: four places of the gauge. levels: halfway too. both_ways: each posture
    approached from both sides. cross: also with the tool moved along the other two axes. payload: three loads.
    rich: positions and levels, own axis and cross moves.
    """
    if name not in get_args(PlanName):
        raise ValueError(f"plan={name}: {suggest(name, get_args(PlanName))}; or a CSV file that lists the readings")
    if name == "paper":
        return paper_plan()
    own, cross = geometry(), name in ("cross", "rich")
    steps: tuple[float, ...] = (own.stroke_plus, own.stroke_minus)
    if name in ("levels", "rich"):
        steps = (own.stroke_plus, own.stroke_plus / 2, own.stroke_minus / 2, own.stroke_minus)
    approaches: tuple[Literal["fwd", "rev"], ...] = ("fwd", "rev") if name == "both_ways" else ("fwd",)
    return tuple(
        Reading(leg, direction, axis, level, gauge_position=share, approach=approach, payload_N=payload)
        for leg, direction, axis in product(AXES, repeat=3)
        if direction != leg and (cross or axis == leg)
        for share in (_SHARES if name in ("positions", "rich") else _SHARES[1:2])
        for approach in approaches
        for payload in (_PAYLOADS if name == "payload" else _PAYLOADS[:1])
        for level in steps
    )


def paper_plan() -> Plan:
    """Return the twelve readings of section 3.1 in the order of the rows of eq. (11)."""
    own = geometry()
    return tuple(
        Reading(leg, direction, leg, level, constants.column(PAPER, "equation11")["gauge_fraction"])
        for first, second in (("x", "y"), ("y", "z"), ("x", "z"))
        for level in (own.stroke_plus, own.stroke_minus)
        for direction, leg in ((first, second), (second, first))
    )


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
            # mu, where on the nominal leg the gauge's plane meets it
            of_its_own = reading.axis == reading.leg
            reach = own.length if of_its_own else float(np.sqrt(own.length**2 - level**2))  # joint centre to tool
            centre = own.length + level if of_its_own else reach
            share = (centre - (1 - reading.gauge_position) * own.length) / reach
            if not -1e-9 <= share <= 1 + 1e-9:
                raise ValueError(
                    f"{where}: gauge_position={reading.gauge_position:g} is off the leg at level_mm={level:g} "
                    f"(share {share:.2f} of it, 0 .. 1 is needed); move the gauge or take a smaller level"
                )


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


def measured(name: SetName) -> tuple[Plan, Array]:
    """Return plan and deviations [mm], shape (12,) or (6,), of one of the paper's sets, as printed."""
    if name not in get_args(SetName):
        raise ValueError(f"data={name}: {suggest(name, get_args(SetName))}")
    column = constants.column(PAPER, _SETS[name])
    if _SETS[name].startswith("table2"):
        plan = paper_plan()
        keys = [f"{r.label[:-1]}_{_ENDS[r.label[-1]]}" for r in plan]
    else:  # differences of Max and Min: x_y x_z y_x y_z z_x z_y
        own, share = geometry(), constants.column(PAPER, "equation11")["gauge_fraction"]
        pairs = [(d, leg) for d in AXES for leg in AXES if d != leg]
        plan = tuple(Reading(leg, d, leg, own.stroke_plus, share, own.stroke_minus) for d, leg in pairs)
        keys = [r.label for r in plan]
    return plan, np.array([column.entries[key].printed for key in keys])


def read_table(path: str | Path, deviations: bool = True) -> tuple[Plan, Array]:
    """Return plan and deviations [mm], shape (m,), of a CSV file; without `deviations` it is a plan, and they are 0.

    A header is needed: leg, direction, posture, deviation, and where they differ from the default gauge_position (.5),
    level_mm, against_mm (0), pass (fwd), payload_N (0), repeat (0); other columns are passed over. `posture` is the
    axis the tool is moved along, with the end of the stroke if there is no level_mm: x (with a level), xmax, xmin, or
    max and min for the leg's own axis. A unit behind a name (``deviation [um]``) is turned into the column's own.

    Raises `ValueError` with the file, the reading and the column of a missing cell, a wrong word or a wrong unit.
    """
    where = f"{'readings' if deviations else 'plan'}={path}"
    given = (_READ if deviations else _PLAN).read(path, where).columns
    for name, column in given.items():
        empty = column == "" if column.dtype.kind == "U" else ~np.isfinite(column)
        if name not in ("level_mm", "against_mm") and empty.any():
            label = f"{where}: reading {int(np.argmax(empty)) + 1}"
            raise ValueError(f"{label}: the cell of {name} holds no value; fill it in or leave the row out")
    n, strokes = len(given["leg"]), {"max": geometry().stroke_plus, "min": geometry().stroke_minus}
    share, payload, repeat, values = (
        given.get(name, np.full(n, usual)).astype(float).tolist()
        for name, usual in (("gauge_position", 0.5), ("payload_N", 0.0), ("repeat", 0.0), ("deviation", 0.0))
    )
    levels, against = (given.get(name, np.full(n, np.nan)).tolist() for name in ("level_mm", "against_mm"))
    approach = given.get("pass", np.full(n, "fwd")).tolist()
    plan = []
    for k, (leg, posture) in enumerate(zip(np.char.lower(given["leg"]), np.char.lower(given["posture"]), strict=True)):
        label = f"{where}: reading {k + 1}"
        if leg not in AXES:
            raise ValueError(f"{label}: leg={str(leg)!r}: x, y or z is needed")
        axis, end = (posture[0], posture[1:]) if posture[0] in AXES else (leg, posture)
        if end not in ("", *strokes):
            choices = [*AXES, "max", "min", *(axis + end for axis in AXES for end in strokes)]
            raise ValueError(f"{label}: posture={str(posture)!r}: {suggest(posture, choices)}")
        level = levels[k] if np.isfinite(levels[k]) else strokes.get(end, np.nan)
        if np.isnan(level):
            raise ValueError(f"{label}: the cell of level_mm holds no value; fill it in or leave the row out")
        if end and level * strokes[end] <= 0:
            raise ValueError(f"{label}: posture={posture} and level_mm={level:g} do not agree in sign")
        if not 0 <= share[k] <= 1:
            raise ValueError(
                f"{label}: gauge_position={share[k]:g}: a share of the leg is needed, 0 (joint) .. 1 (tool)"
            )
        if approach[k] not in ("fwd", "rev"):
            raise ValueError(f"{label}: pass={approach[k]!r}: fwd or rev is needed")
        if not repeat[k].is_integer():
            raise ValueError(f"{label}: repeat={repeat[k]:g}: a whole number is needed")
        plan.append(Reading(
            str(leg), str(given["direction"][k]).lower(), str(axis), float(level), gauge_position=share[k],
            against_mm=float(np.nan_to_num(against[k])), approach=approach[k], payload_N=payload[k],
            repeat=int(repeat[k]),
        ))  # fmt: skip
    largest = max(abs(r.level_mm) for r in plan)
    if largest < 1.0:
        raise ValueError(f"{where}: level_mm reaches {largest:g}: they look like metres, millimetres are needed")
    try:
        check_plan(plan)
        check_deviations(np.array(values), where)
    except ValueError as error:
        raise ValueError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None
    return tuple(plan), np.array(values)


def check_deviations(deviations: Array, what: str = "readings") -> None:
    """Raise `ValueError` for deviations that are not finite millimetres."""
    bad = np.flatnonzero(~np.isfinite(deviations))
    if bad.size:
        raise ValueError(f"{what}: the deviation of row {bad[0] + 1} is not finite ({bad.size} such); leave it out")
    largest, column = float(np.abs(deviations).max(initial=0.0)), constants.column(PAPER, "text.section41")
    resolution = column["indicator_resolution"] / 1000  # printed in um
    if 0 < largest < resolution / 2:
        raise ValueError(
            f"{what}: no deviation is above {largest:.3g}, half a gauge's resolution of {resolution:g} mm: "
            "they look like metres, millimetres are needed"
        )
    if largest > geometry().length / 2:
        raise ValueError(f"{what}: a deviation of {largest:.4g} mm: they look like micrometres, millimetres are needed")
