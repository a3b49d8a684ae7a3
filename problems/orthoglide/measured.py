"""Measured deviations of an Orthoglide: the paper's five sets, and a user's own table as CSV, validated.

The sets of Table 1 are six differences, Max minus Min; those of Table 2 are twelve, each against Zero. Experiment 3 is
printed in both with values that cannot be one measurement, so the two are never mixed.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from calibench.core.options import suggest
from calibench.core.tables.cells import factor_to_base
from calibench.core.tables.csv_table import read_table as read_cells
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, PAPER, geometry
from calibench.problems.orthoglide.plans import Plan, Reading, check_plan, difference_plan, paper_plan

SetName = Literal["exp1", "exp2", "exp2_t1", "exp3_t1", "exp3_t2"]
_COLUMNS = {"exp1": "table1.exp1", "exp2": "table2.exp2", "exp2_t1": "table1.exp2", "exp3_t1": "table1.exp3",
            "exp3_t2": "table2.exp3"}  # fmt: skip
_ENDS = {"+": "plus", "-": "minus"}


def measured(name: SetName) -> tuple[Plan, Array]:
    """Return plan and deviations [mm], shape (12,) or (6,), of one of the paper's sets, as printed."""
    if name not in get_args(SetName):
        raise ValueError(f"data={name}: {suggest(name, get_args(SetName))}")
    column = constants.column(PAPER, _COLUMNS[name])
    six = _COLUMNS[name].startswith("table1")
    plan = difference_plan() if six else paper_plan()
    keys = [r.label if six else f"{r.label[:-1]}_{_ENDS[r.label[-1]]}" for r in plan]
    return plan, np.array([column.entries[key].printed for key in keys])


def read_plan(path: str | Path) -> Plan:
    """Return the plan a CSV file lists; a column of deviations may be there and is not used."""
    return _read(path, "plan", deviations=False)[0]


def read_table(path: str | Path) -> tuple[Plan, Array]:
    """Return plan and deviations [mm], shape (m,), of a CSV file of measured deviations.

    A header is needed: leg, direction, posture, deviation, and where they differ from the default gauge_position (.5),
    level_mm, against_mm (0), pass (fwd), payload_N (0), repeat (0); other columns are passed over. `posture` is the
    axis the tool is moved along, with the end of the stroke if there is no level_mm: x (with a level), xmax, xmin, or
    max and min for the leg's own axis. A unit behind a name (``deviation [um]``) is
    turned into the column's own.

    Raises `ValueError` with the file, the row and the column of a missing cell, a wrong word or a wrong unit.
    """
    return _read(path, "readings", deviations=True)


def write_table(path: str | Path, plan: Plan, deviations: Array | None = None) -> None:
    """Write a plan as the CSV file that `read_table` takes, with the deviations [mm] or empty cells to be filled in."""
    values = [""] * len(plan) if deviations is None else [repr(float(d)) for d in deviations]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([name if name != "deviation" else "deviation [mm]" for name in _KNOWN])
        for r, value in zip(plan, values, strict=True):
            posture = (r.leg, r.direction, r.axis, r.gauge_position, r.level_mm, r.against_mm)
            writer.writerow([*posture, r.approach, r.payload_N, r.repeat, value])


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


def _read(path: str | Path, what: str, deviations: bool) -> tuple[Plan, Array]:
    where = f"{what}={path}"
    try:
        found = read_cells(path)
        units = {name: factor_to_base(name, found.units.get(name, unit), unit)[1] for name, unit in _UNITS.items()}
    except (OSError, ValueError) as error:
        raise ValueError(f"{where}: cannot be read: {error}") from None
    header = list(found.names)
    needed = ["leg", "direction", "posture", *(["deviation"] if deviations else [])]
    missing = [name for name in needed if name not in header]
    if missing:
        raise ValueError(f"{where}: no column {', '.join(missing)}; the header has {', '.join(header)}")
    plan, values = [], []
    for line, row in found.rows:
        if not "".join(row).strip():
            continue
        cells = {name: cell.strip() for name, cell in zip(header, row)}
        label = f"{where}: row {line}"
        for name in header:
            optional = name in ("level_mm", "against_mm") or (name == "deviation" and not deviations)
            if name in _KNOWN and not cells.get(name) and not optional:
                raise ValueError(f"{label}: the cell of {name} is missing; fill it in or leave the row out")
        plan.append(_reading(label, cells, units))
        values.append(_number(label, cells, "deviation", None, units) if deviations else 0.0)
    if not plan:
        raise ValueError(f"{where}: there is no row below the header")
    levels = np.array([abs(r.level_mm) for r in plan])
    if levels.max() < 1.0:
        raise ValueError(f"{where}: level_mm reaches {levels.max():g}: they look like metres, millimetres are needed")
    try:
        check_plan(plan)
        check_deviations(np.array(values), where)
    except ValueError as error:
        raise ValueError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None
    return tuple(plan), np.array(values)


_KNOWN = ("leg", "direction", "posture", "gauge_position", "level_mm", "against_mm", "pass", "payload_N", "repeat",
          "deviation")  # fmt: skip
_UNITS = {"level_mm": "mm", "against_mm": "mm", "payload_N": "N", "deviation": "mm"}


def _reading(label: str, cells: dict[str, str], units: Mapping[str, float]) -> Reading:
    leg, posture = cells["leg"].lower(), cells["posture"].lower()
    if leg not in AXES:
        raise ValueError(f"{label}: leg={cells['leg']!r}: x, y or z is needed")
    axis, end = (posture[0], posture[1:]) if posture[0] in AXES else (leg, posture)
    strokes = {"max": geometry().stroke_plus, "min": geometry().stroke_minus}
    if end not in ("", *strokes):
        choices = [*AXES, "max", "min", *(axis + end for axis in AXES for end in strokes)]
        raise ValueError(f"{label}: posture={cells['posture']!r}: {suggest(posture, choices)}")
    level = _number(label, cells, "level_mm", strokes.get(end), units)
    if end and level * strokes[end] <= 0:
        raise ValueError(f"{label}: posture={cells['posture']} and level_mm={level:g} do not agree in sign")
    share = _number(label, cells, "gauge_position", 0.5, units)
    if not 0 <= share <= 1:
        raise ValueError(f"{label}: gauge_position={share:g}: a share of the leg is needed, 0 (joint) .. 1 (tool)")
    approach = cells.get("pass", "fwd")
    if approach not in ("fwd", "rev"):
        raise ValueError(f"{label}: pass={approach!r}: fwd or rev is needed")
    against, payload = _number(label, cells, "against_mm", 0.0, units), _number(label, cells, "payload_N", 0.0, units)
    repeat = _number(label, cells, "repeat", 0.0, units)
    if not repeat.is_integer():
        raise ValueError(f"{label}: repeat={repeat:g}: a whole number is needed")
    kind: Literal["fwd", "rev"] = "rev" if approach == "rev" else "fwd"
    return Reading(leg, cells["direction"].lower(), axis, level, share, against, kind, payload, int(repeat))


def _number(label: str, cells: dict[str, Any], key: str, default: float | None, units: Mapping[str, float]) -> float:
    """Return the number in a cell in the unit of its column, or the default where the cell or its column is empty."""
    text = cells.get(key, "")
    if not text:
        if default is None:
            raise ValueError(f"{label}: the cell of {key} is missing; fill it in or leave the row out")
        return default
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{label}: {key}={text!r}: a number is needed") from None
    if not np.isfinite(value):
        raise ValueError(f"{label}: {key}={text}: a finite number is needed")
    return value * units.get(key, 1.0)
