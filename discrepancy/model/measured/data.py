"""`MeasuredData`: the readings of one run of a machine, a column for each quantity and a row for each reading.

The columns of each machine are those of its page in the documentation; a missing column makes the effects that need it
not testable, and nothing else. This room reads no files: `bench` does.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.tables.marks import split_rows
from calibench.core.words import as_columns

Column = NDArray[Any]
TO_PREDICT = "row_to_predict"  # the place of a row that a report predicts
_SHOWN = 6  # rows that a message names
_OWN = ("reading_place", TO_PREDICT)  # columns that no file has
UNSTATED = "the noise is not stated"  # how a note begins on noise that was told from the data themselves
LEARNED = "is learned from what the model leaves"  # in such a note: then nothing tells how much of the rest is noise
UNREAD = "have another shape and are not read"  # in a note, of variables that are no column beside the others
NO_REPEATS = "no repeats"  # subject of a note: nothing was read twice, so the stated noise is taken on trust


class DataError(ValueError):
    """The data cannot be used as they are; the message names the column, what is wrong, and the way out."""


class MisfitError(DataError):
    """The data are far from all that the machine can give: numbers in other units, or of another machine."""


@final
@dataclass(frozen=True, eq=False)
class MeasuredData:
    """Readings of one machine: `columns` name -> array (n,), `metadata` what was stated about them (noise, nominal …).

    Columns that are lists, or a table of pandas, become arrays.

    `name` is the stem of the file or the name of a printed set. `notes` are remarks a report must repeat; `noted` are
    the subjects of those that another room may have a remark on as well (`NO_REPEATS`). `units` are those of columns
    whose unit was stated with them, `stated` the keys of `metadata` that were stated beside the file, `computed` the
    columns that the machine computed from others. `numbers` (n,) are the rows as they were read, from 1; None for all
    of them, in order.
    """

    columns: Mapping[str, Column]
    machine: str
    metadata: Mapping[str, Any] = field(default_factory=dict)
    name: str = "data"
    notes: tuple[str, ...] = ()
    noted: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)
    stated: frozenset[str] = frozenset()
    computed: frozenset[str] = frozenset()
    numbers: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        if not all(isinstance(column, np.ndarray) for _, column in self.columns.items()):  # lists, a table of pandas
            arrays = {str(name): np.asarray(column) for name, column in self.columns.items()}
            object.__setattr__(self, "columns", arrays)
        lengths = {key: np.shape(column) for key, column in self.columns.items()}
        if not lengths:
            raise DataError(f"{self.name}: there are no columns")
        if len(set(lengths.values())) > 1 or any(len(shape) != 1 for shape in lengths.values()):
            raise DataError(f"{self.name}: columns differ in shape: {lengths}")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> Column:
        """Return one column; raise `DataError` where it is missing."""
        if column not in self.columns:
            like = [name for name in self.in_file if name.casefold() == column.casefold()]
            unread = [f"; {note}" for note in self.notes if UNREAD in note and column in re.findall(r"\w+", note)]
            raise DataError(
                f"{self.name}: column {column!r} is missing; there are {', '.join(self.in_file)}; where the file has "
                f"another name for it: {as_columns({column: like[0] if like else 'NAME'})}{''.join(unread)}"
            )
        return self.columns[column]

    @property
    def in_file(self) -> tuple[str, ...]:
        """Return the names of the columns that the file has, without those that were added to it."""
        return tuple(name for name in self.columns if name not in _OWN)

    @property
    def row_numbers(self) -> NDArray[np.intp]:
        """Return the rows as they were read, from 1, (n,)."""
        return np.arange(1, len(self) + 1) if self.numbers is None else self.numbers

    def has(self, *columns: str) -> bool:
        """Return whether all `columns` are there."""
        return all(column in self.columns for column in columns)

    def rows(self, mask: Column) -> MeasuredData:
        """Return the rows where `mask`, shape (n,) of booleans or indices, holds."""
        kept = {key: column[mask] for key, column in self.columns.items()}
        return replace(self, columns=kept, numbers=self.row_numbers[mask])

    def rows_named(self, which: Column) -> str:
        """Return the rows `which`, a mask or indices, as they were read: "row 7", or "rows 7, 12, 40 and 3 more"."""
        found = sorted(np.unique(self.row_numbers[which]).tolist())
        if len(found) == 1:
            return f"row {found[0]}"
        shown = ", ".join(str(k) for k in found[:_SHOWN])
        return f"rows {shown}{f' and {len(found) - _SHOWN} more' if len(found) > _SHOWN else ''}"

    def with_note(self, note: str, about: str = "") -> MeasuredData:
        """Return the same data with one more remark for the report, and its subject where it has one."""
        return replace(self, notes=(*self.notes, note), noted=self.noted | ({about} if about else set()))

    def with_columns(self, columns: Mapping[str, Column]) -> MeasuredData:
        """Return the data with `columns` put in the place of those of the same name, or beside them."""
        return replace(self, columns={**self.columns, **columns})

    def with_units(self, units: Mapping[str, str], notes: tuple[str, ...] = ()) -> MeasuredData:
        """Return the same data with `units` for those stated of its columns, and more remarks for the report."""
        return replace(self, units=units, notes=(*self.notes, *notes))


def with_split(data: MeasuredData) -> MeasuredData:
    """Return the data with `split`, where they have it, spelt train and hold; rows without a word are train.

    Raises `DataError` for any other word: rows that were kept for checking must not be fitted in silence.
    """
    if "split" not in data:
        return data
    try:
        words = split_rows(data["split"])
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None
    empty = words == ""
    words = np.where(empty, "train", words)
    if not (words == "train").any():
        raise DataError(f"{data.name}: column split holds back every row; some must be train, to be fitted")
    data = data.with_columns({"split": words})
    return data.with_note(f"{np.sum(empty)} rows have no split and are fitted") if empty.any() else data
