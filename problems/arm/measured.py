"""Measured postures of an arm from a CSV file, read as `calibration` reads them; `shipped` names the package's tables.

Columns are named as `calibration.columns` matches them, with units in brackets (`elbow_joint [deg]`, `x [m]`). Here
nothing renames a column or states its unit but the header itself, and messages say so.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibench.calibration.kinematics import Chain
from calibench.calibration.readings import Table, read_readings
from calibench.calibration.rigid import Rotation
from calibench.calibration.start import Start, start_of
from calibench.core.notes import Code
from calibench.core.tables.cells import factor_to_base
from calibench.core.tables.csv_table import read_table

_FOLDER = Path(__file__).resolve().parents[1] / "data" / "arms"
_IN_HEADER = {
    **dict.fromkeys((Code.JOINT_UNIT, Code.POSITION_UNIT), "; write the unit in the header, as x [m]"),
    **dict.fromkeys((Code.JOINTS_EXCHANGED, Code.LEFT_HANDED), "; rename the columns in the header"),
}


def shipped(name: str) -> Path:
    """Return the file of a table or URDF that comes with the package."""
    return _FOLDER / name


def read_measured(
    path: str | Path, chain: Chain, rotation: Rotation = "", *, sockets: bool = False, by_train: bool = True
) -> Start:
    """Return what a CSV file tells of `chain`, and where base and target are, by the rows that are fitted, or by all.

    With `sockets` a measured place is not read. Raises `ValueError`, one line with the file's name.
    """
    name = f"data={Path(path).name}"
    try:
        readings = read_readings(
            _table(path, name), chain, "sockets" if sockets else "", copies=True, option="problem."
        )
        begin = start_of(readings if by_train else replace(readings, hold=None), chain, rotation, limits=True)
        return replace(begin, readings=replace(begin.readings, hold=readings.hold))
    except (OSError, ValueError) as error:
        text, note = str(error), getattr(error, "note", None)
        text = text if text.startswith(name) else f"{name}: {text}"
        raise ValueError(f"{text}{_IN_HEADER.get(note.code, '') if note else ''}") from None


def _table(path: str | Path, name: str) -> Table:
    """Return a CSV file's columns in base units; a column of which most cells are no numbers holds words."""
    file = read_table(path)
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for at, head in enumerate(file.names):
        words = [cells[at].strip() if at < len(cells) else "" for _, cells in file.rows]
        numbers = [_number(word, file.delimiter != ",") for word in words]
        if 2 * sum(number is None for number in numbers) > len(words):
            columns[head] = np.array(words)
            continue
        if None in numbers:
            k = numbers.index(None)
            raise ValueError(f"row {file.rows[k][0]}: {head} is {words[k]!r}, and a number is needed")
        columns[head] = np.array(numbers, dtype=float)
        if head in file.units:
            units[head], scale = factor_to_base(head, file.units[head])
            columns[head] *= scale
    columns.pop("", None)
    return Table.of(columns, name, units=units)


def _number(word: str, comma: bool) -> float | None:
    """Return the number in a cell, NaN for an empty one; None for no number."""
    try:
        return float(word.replace(",", ".") if comma else word) if word else np.nan
    except ValueError:
        return None
