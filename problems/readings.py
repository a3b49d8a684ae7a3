"""Measured encoder readings: a CSV file or an array, checked once, at the door."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from problems.base import Array


def read_csv(path: str | Path) -> Array:
    """Return the readings of a CSV file, shape (n, 3): columns enc_1..3, or three columns without header.

    Raises `ValueError` with the file, the row and what is wrong with it.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"readings={path}: cannot be read: {error}") from None
    if not rows:
        raise ValueError(f"readings={path}: the file is empty")
    columns = [0, 1, 2]
    if any(not _is_float(cell) for cell in rows[0][1]):
        names = [" ".join(cell.split()) for cell in rows.pop(0)[1]]
        missing = [c for c in ("enc_1", "enc_2", "enc_3") if c not in names]
        if missing:
            raise ValueError(f"readings={path}: no column {', '.join(missing)}; the header has {', '.join(names)}")
        columns = [names.index(c) for c in ("enc_1", "enc_2", "enc_3")]
    table = []
    for line, row in rows:
        try:
            table.append([float(row[c]) for c in columns])
        except (ValueError, IndexError):
            raise ValueError(f"readings={path}: row {line} does not hold three numbers: {row!r:.80}") from None
    return np.array(table)


def check_readings(readings: Array) -> None:
    """Raise `ValueError` for readings that are not finite radians of shape (n, 3)."""
    if readings.ndim != 2 or readings.shape[1] != 3 or not len(readings):
        raise ValueError(f"readings have shape {readings.shape}: (n, 3) is needed, a column for each encoder")
    bad = np.flatnonzero(~np.isfinite(readings).all(axis=1))
    if bad.size:
        raise ValueError(f"readings: row {bad[0] + 1} is not finite ({bad.size} such rows); leave them out")
    if np.abs(readings).max() > 4 * np.pi:
        raise ValueError(f"readings reach {np.abs(readings).max():.4g}: they look like degrees, radians are needed")


def _is_float(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
