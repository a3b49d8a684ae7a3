"""What a mistake makes of the columns of a table: one list of kinds with their cures, whoever reads the table.

A reader says which of his columns are in one unit, of one sense or read together, and tries how near what he fits is to
the columns as they would be without a mistake. How a cure is told is his, by the kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum, auto
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = Mapping[str, Any]  # name -> numbers, (n,)
T = TypeVar("T")
FEW = 8  # rows at least of a part that is mistaken, and of the rest
MOST, OR_AS_NEAR = 3, "; or as near "  # cures that a message names, and what stands between them


@final
class Kind(StrEnum):
    """What is wrong with some columns."""

    UNIT = auto()
    SIGN = auto()
    ZERO = auto()
    EXCHANGED = auto()
    ROWS = auto()


@final
@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake of a `kind`: `columns` as they would be without it.

    They are multiplied `by` a number as they are in another `unit` or count the other way, or moved by it: a zero, or
    by so many rows. Where it is not in all rows, it is in those from the first of `rows` to before the second.
    """

    kind: Kind
    columns: Columns
    by: float = 1.0
    unit: str = ""
    rows: tuple[int, int] | None = None

    def kept(self, n: int) -> NDArray[np.bool_]:
        """Return which of n rows are whole without the mistake: of moved ones the first or the last is not."""
        first, end = self.rows or (0, n)
        lost = first if self.by > 0 else end - 1
        return np.not_equal(np.arange(n), lost if self.kind is Kind.ROWS else n)

    def within(self, read: Columns, first: int, end: int) -> Mistake:
        """Return the mistake in some rows of what was `read`."""
        columns = {name: np.array(read[name], dtype=float) for name in self.columns}
        for name, column in columns.items():
            column[first:end] = self.columns[name][first:end]
        return replace(self, columns=columns, rows=(first, end))


def in_units(columns: Columns, names: Iterable[str], factors: Iterable[tuple[str, float]]) -> list[Mistake]:
    """Return columns that are all in one of some units: each with what it has to be multiplied by."""
    read = {name: np.asarray(columns[name], dtype=float) for name in names}
    return [Mistake(Kind.UNIT, {name: by * one for name, one in read.items()}, by, unit) for unit, by in factors]


def reversed_in(columns: Columns, names: Iterable[str]) -> Mistake:
    """Return columns that all count the other way."""
    return Mistake(Kind.SIGN, {name: -columns[name] for name in names}, -1.0)


def moved(columns: Columns, name: str, by: float) -> Mistake:
    """Return a column with another zero."""
    return Mistake(Kind.ZERO, {name: columns[name] + by}, by)


def exchanged(columns: Columns, *names: str) -> Mistake:
    """Return columns of which each stands under the name of the one before, and the first under that of the last."""
    return Mistake(Kind.EXCHANGED, {name: columns[names[k - len(names) + 1]] for k, name in enumerate(names)})


def a_row_off(columns: Columns, names: Iterable[str], rows: int) -> Mistake:
    """Return columns of which each number stands so many `rows` above its own row: -1 below it."""
    return Mistake(Kind.ROWS, {name: np.roll(columns[name], rows) for name in names}, rows)


def in_part(mistake: Mistake, read: Columns, sound: Array, cured: Array, first: bool) -> list[Mistake]:
    """Return a mistake in the `first` rows only, or in the last, of what was `read`; none where these are few or all.

    It is in as many as leave least, where `sound` (n,) is what each row leaves as it was read, and `cured` without it.
    """
    gain = np.concatenate([[0.0], np.cumsum(cured - sound)])  # of rows that are read as they stand, before this one
    begin = int(np.argmin(gain) if first else np.argmax(gain))
    part = (0, begin) if first else (begin, len(sound))
    return [mistake.within(read, *part)] if FEW <= part[1] - part[0] <= len(sound) - FEW else []


def likely(tried: Iterable[tuple[float, T]], times: float) -> tuple[float, list[T]]:
    """Return what the best of `tried` leaves, infinity of none, and those that leave up to as many `times` as much."""
    tried = list(tried)
    best, chosen = min(tried, key=lambda one: one[0], default=(np.inf, None))
    return best, [one for left, one in tried if one is chosen or left <= times * best][:MOST]
