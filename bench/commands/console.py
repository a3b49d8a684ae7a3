"""What any verb prints: JSON, a table, and the end of a fit."""

import json
from collections.abc import Iterable, Sequence
from typing import Any

from calibench.core.plain import finite
from calibench.core.words import listed, print_plain as print

_LISTED = 8  # of what was left out of a fit: more are counted


def print_json(value: Any) -> None:
    """Print `value` as standard JSON: null for a number that is not finite, text for types that JSON does not have."""
    missing = ("NAType", "NaTType")  # pandas' own, which it need not load
    text = json.dumps(
        finite(value), indent=1, allow_nan=False, default=lambda v: None if type(v).__name__ in missing else str(v)
    )
    print(text)


def print_table(columns: list[str], rows: list[list[str]]) -> None:
    widths = [max(len(str(cell)) for cell in column) for column in zip(columns, *rows, strict=True)]
    for cells in [columns, *rows]:
        print("  ".join(str(cell).ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())


def print_end(what: str, left_out: Sequence[str], notes: Iterable[object], written: Iterable[object]) -> None:
    """Print what was left out of a fit, called `what`, the first few of it; then the notes, and the files written."""
    if left_out:
        print(f"\n{what}, not used in the fit: {listed(left_out, _LISTED)}")
    for note in notes:
        print(f"note: {note}")
    print()
    for path in written:
        print(path)
