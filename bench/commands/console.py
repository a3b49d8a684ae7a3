"""What any verb prints: JSON, a table, and the end of a fit."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

from calibench.core.words import print_plain as print

_LISTED = 8  # of what was left out of a fit: more are counted


def print_json(value: Any) -> None:
    """Print `value` as standard JSON: null for a number that is not finite, text for types that JSON does not have."""
    print(json.dumps(_plain(value), indent=1, allow_nan=False, default=str))


def print_table(columns: list[str], rows: list[list[str]]) -> None:
    widths = [max(len(str(cell)) for cell in column) for column in zip(columns, *rows, strict=True)]
    for cells in [columns, *rows]:
        print("  ".join(str(cell).ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())


def print_end(what: str, left_out: Sequence[str], notes: Iterable[object], written: Iterable[object]) -> None:
    """Print what was left out of a fit, called `what`, the first few of it; then the notes, and the files written."""
    if left_out:
        more = f" and {len(left_out) - _LISTED} more" if len(left_out) > _LISTED else ""
        print(f"\n{what}, not used in the fit: {', '.join(left_out[:_LISTED])}{more}")
    for note in notes:
        print(f"note: {note}")
    print()
    for path in written:
        print(path)


def _plain(value: Any) -> Any:
    if type(value).__module__ == "numpy":
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    pandas = sys.modules.get("pandas")  # who has not loaded it has no missing value of it
    is_missing = pandas is not None and (value is pandas.NA or value is pandas.NaT)
    return None if is_missing or (isinstance(value, float) and not isfinite(value)) else value
