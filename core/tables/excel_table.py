"""A sheet of an Excel file as a table: the first that holds one, with the values that Excel last computed.

The file is a packed folder of XML. What it unpacks to stands in its directory, which is looked at beforehand, and a
sheet is read row by row: one that says it has a million columns is refused at its first row.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from calibench.core.tables.csv_table import Table, header_row, table_of
from calibench.core.tables.data_file import LARGEST_TEXT, MEGABYTE, MOST_CELLS, check_columns, read_whole

_LARGEST_UNPACKED = 400 * MEGABYTE  # of a sheet's XML: the most cells have some 40 to 80 bytes each
_MOST_TIMES, _SMALL = 100, 10 * MEGABYTE  # as it is packed: sheets unpack to 5 to 20 times; a small one may to more
_MOST_ROWS = 1 << 20  # of any sheet of Excel
_SMALLER = "save it as CSV or Parquet, or take part of the readings"


class ExcelError(ValueError):
    """A file that is no Excel table, or too large a one; the message is one line that says what to do."""


def read_excel(path: Path) -> tuple[Table, tuple[str, ...]]:
    """Return the table, and a note where other sheets hold something too. Raises `ValueError`."""
    try:
        import openpyxl
    except ImportError:
        raise ExcelError(
            "is an Excel file; reading it needs openpyxl: pip install 'calibench[excel]', or save it as CSV"
        ) from None
    content = read_whole(path, LARGEST_TEXT, _SMALLER)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            unpacked = sum(part.file_size for part in packed.infolist())
        if unpacked > max(_SMALL, _MOST_TIMES * len(content)):
            raise ExcelError(
                f"unpacks to {unpacked // len(content)} times its size, and no sheet of readings to more than "
                f"{_MOST_TIMES}; {_SMALLER}"
            )
        if unpacked > _LARGEST_UNPACKED:
            most = _LARGEST_UNPACKED // MEGABYTE
            raise ExcelError(f"unpacks to {unpacked / MEGABYTE:.0f} MB, and at most {most} MB are read; {_SMALLER}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that no number depends on
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
            sheets = {sheet.title: _rows(sheet) for sheet in book.worksheets}
    except (ExcelError, MemoryError):
        raise
    except Exception as error:  # openpyxl raises what its XML reader, zipfile and its own checks raise
        raise ExcelError(
            f"is no Excel file that can be read ({type(error).__name__}: {error}); save it as CSV"
        ) from None
    full = {title: rows for title, rows in sheets.items() if rows}
    if not full:
        raise ExcelError("the sheets are empty: a header and a row for each reading are needed")
    found = {title: header_row([row for _, row in rows[:60]]) for title, rows in full.items()}
    title = next((title for title, at in found.items() if at is not None), next(iter(full)))
    rows, start = full[title], found[title] or 0
    others = [other for other in full if other != title]
    notes = (f"sheet {title} is read, and not {', '.join(others)}",) if others else ()
    comment = " ".join(" ".join(filter(None, row)) for _, row in rows[:start])
    return _even(table_of(rows[start:], comment, bare=True)), notes


def _even(table: Table) -> Table:
    """Return the table with rows as wide as the header: a sheet does not keep empty cells at the end of a row."""
    width = len(table.names) or max(len(row) for _, row in table.rows)
    rows = tuple((line, (*row, *[""] * (width - len(row)))) for line, row in table.rows)
    return replace(table, rows=rows)


def _rows(sheet: Any) -> list[tuple[int, tuple[str, ...]]]:
    """Return the rows that hold something, with their numbers, as text."""
    rows: list[tuple[int, tuple[str, ...]]] = []
    cells = 0
    sheet.reset_dimensions()  # what the file says of its width: each row is as wide as its own last cell
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells += len(row)
        if number > _MOST_ROWS:  # the rows before that are not there cost time too
            raise ExcelError(f"has a row after {_MOST_ROWS}, the last of a sheet; {_SMALLER}")
        if cells > MOST_CELLS:
            raise ExcelError(f"has more than {MOST_CELLS} cells, and no more are read; {_SMALLER}")
        told = tuple(_text(cell) for cell in row)
        if any(told):
            check_columns(max(i for i, cell in enumerate(told) if cell) + 1)
            rows.append((number, told))
    return rows


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, datetime):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    return repr(cell) if isinstance(cell, int | float) else str(cell)
