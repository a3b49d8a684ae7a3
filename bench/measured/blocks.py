"""Blocks of rows that empty lines part in a text file: one table, which is told, or several, which are refused."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from calibench.core.tables.csv_table import Table
from calibench.core.tables.data_file import LARGEST_TEXT, read_whole, text_of
from calibench.core.words import shortened
from calibench.discrepancy import DataError

_NUMBER = re.compile(r"\s*[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?\s*")
_TOLD = 4  # blocks whose lines are told


def blocks_of(path: Path, table: Table) -> tuple[str, ...]:
    """Return a note where empty lines part the rows of a file into blocks, which may be tables of their own.

    A file whose every row stands alone has no blocks. The file is read again only where lines without a row lie
    between rows. Raises `DataError` for a block with a header of its own.
    """
    rows = table.rows
    apart = [k for k in range(1, len(rows)) if rows[k][0] > rows[k - 1][0] + 1 and _any_number(rows[k - 1][1])]
    if not apart:
        return ()
    lines = text_of(read_whole(path, LARGEST_TEXT)).splitlines()
    starts = [k for k in apart if not all(line.strip() for line in lines[rows[k - 1][0] : rows[k][0] - 1])]
    for k in (k for k in starts if k + 1 < len(rows) and _begins_table(rows[k][1], rows[k + 1][1])):
        head = shortened(", ".join(cell.strip() for cell in rows[k][1]))
        raise DataError(
            f"line {rows[k][0]}: a second table begins below an empty line ({head}); give each a file of its own"
        )
    if not starts or len(starts) == len(rows) - 1 > 1:
        return ()
    where = ", ".join(str(rows[k][0]) for k in starts[:_TOLD]) + (", ..." if len(starts) > _TOLD else "")
    later = f"the later one from line {where}" if len(starts) == 1 else f"the later ones from lines {where}"
    said = f"empty lines part the rows into {len(starts) + 1} blocks, {later} on"
    return (f"{said}: they are read as one table; tables that differ need a file each",)


def _begins_table(head: Sequence[str], below: Sequence[str]) -> bool:
    """Tell whether a row among readings is a header: names that differ, above as many cells with a number."""
    names = [cell.strip() for cell in head]
    words = all(names) and not _any_number(names) and len(set(names)) == len(names) > 1
    return words and len(names) == len(below) and _any_number(below)


def _any_number(cells: Sequence[str]) -> bool:
    return any(map(_NUMBER.fullmatch, cells))
