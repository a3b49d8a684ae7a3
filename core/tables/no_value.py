"""The words in a cell that say that there is no value, the same for numbers and for the names of poses."""

from __future__ import annotations

NO_VALUE = frozenset({
    "", "nan", "na", "n/a", "n.a.", "#n/a", "#nv", "#div/0!", "#value!", "#wert!", "#num!", "#ref!", "null", "none",
    "nil", "missing", "-", "--", "---", "?", ".", "k.a.", "-nan", "nan(ind)", "1.#qnan", "<na>",
})  # fmt: skip


def no_value(cell: str) -> bool:
    """Return whether a cell, as it is written, says that there is no value.

    >>> [no_value(cell) for cell in (" N/A", "-", "0")]
    [True, True, False]
    """
    return cell.strip().lower() in NO_VALUE
