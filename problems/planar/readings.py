"""Measured encoder readings: a CSV file or an array, validated once."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibench.core.tables.csv_table import Table, read_table
from calibench.core.tables.decimals import with_points
from calibench.core.tables.units import factor_to_base
from calibench.problems.base import Array

_COLUMNS = ("enc_1", "enc_2", "enc_3")


def read_csv(path: str | Path) -> Array:
    """Return the readings of a CSV file [rad], shape (n, 3): columns enc_1..3, or three columns without header.

    A unit behind a name (`enc_1 [deg]`) is turned into radians; lines that begin with # and other columns are passed
    over, so a file of measured data is read as well. Decimal commas are read where commas do not part the cells. Raises
    `ValueError` with the file, the row and what is wrong.
    """
    try:
        found = read_table(path, bare=True)
        factors = [factor_to_base(name, found.units.get(name, "rad"), "rad")[1] for name in _COLUMNS]
        cells = _cells(found)
    except (OSError, ValueError) as error:
        raise ValueError(f"readings={path}: cannot be read: {error}") from None
    names = found.names or _COLUMNS
    missing = [name for name in _COLUMNS if name not in names]
    if missing:
        raise ValueError(f"readings={path}: no column {', '.join(missing)}; the header has {', '.join(names)}")
    table = []
    for (line, row), *three in zip(found.rows, *(cells[name] for name in _COLUMNS), strict=True):
        try:
            table.append([float(cell) for cell in three])
        except ValueError:
            raise ValueError(f"readings={path}: row {line} does not hold three numbers: {list(row)!r:.80}") from None
    return np.array(table) * factors if table else np.empty((0, 0))


def _cells(found: Table) -> dict[str, list[str]]:
    """Return the cells of each column that has a name, "" where its row ends before, with decimal points."""
    names = found.names or _COLUMNS
    rows = [row for _, row in found.rows]
    columns = {n: [row[k].strip() if k < len(row) else "" for row in rows] for k, n in enumerate(names) if n}
    own = (cell for name in _COLUMNS for cell in columns.get(name, ()))
    return with_points(columns) if found.delimiter != "," and any("," in cell for cell in own) else columns


def check_readings(readings: Array) -> None:
    """Raise `ValueError` for readings that are not finite radians of shape (n, 3)."""
    if readings.ndim != 2 or readings.shape[1] != 3 or not len(readings):
        raise ValueError(f"readings have shape {readings.shape}: (n, 3) is needed, a column for each encoder")
    bad = np.flatnonzero(~np.isfinite(readings).all(axis=1))
    if bad.size:
        raise ValueError(f"readings: row {bad[0] + 1} is not finite ({bad.size} such rows); leave them out")
    if np.abs(readings).max() > 4 * np.pi:
        raise ValueError(f"readings reach {np.abs(readings).max():.4g}: they look like degrees, radians are needed")
