"""What was measured: columns of readings, the instruments that gave them, and which rows are complete.

A missing column makes the effects that need it not testable, and nothing else. A cell without a number (empty, NaN,
infinite, or so large that its powers are infinite) costs its row; how many rows, and for which columns, is told. A
column that is empty in most rows, or holds words, is refused. What is stated beside the columns may be any value: text,
nested lists, a whole number too large for a float. This room reads no files: `bench` does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, nan
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, DataError as DataError, Note
from calibench.core.options import shown, suggest
from calibench.core.tables.cells import NO_VALUE, between, is_unit, way_out
from calibench.core.words import as_columns, shortened
from calibench.problems.base import Array

Column = NDArray[Any]
PLACE = "reading_place"  # the column that holds a reading's place in the order of time
TO_PREDICT = "row_to_predict"  # the place of a row that a report predicts
_SHOWN_ROWS = 6  # rows that a message names
_OWN = (PLACE, TO_PREDICT)  # columns that no file has


class MisfitError(DataError):
    """The data are far from all that the machine can give: numbers in other units, or of another machine."""


@final
@dataclass(frozen=True, eq=False, repr=False)
class MeasuredData:
    """Readings of one machine: `columns` name -> array (n,), `metadata` what was stated about them (noise, nominal …).

    Columns that are lists, or a table of pandas, become arrays. `name` is the stem of the file or the name of a printed
    set, `notes` what a report must repeat, `units` those of columns whose unit was stated with them, `stated` the keys
    of `metadata` that were stated beside the file, `computed` the columns that the machine computed from others.
    `numbers` (n,) are the rows as they were read, from 1; None for all of them, in order.
    """

    columns: Mapping[str, Column]
    machine: str
    metadata: Mapping[str, Any] = field(default_factory=dict)
    name: str = "data"
    notes: tuple[Note, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    stated: frozenset[str] = frozenset()
    computed: frozenset[str] = frozenset()
    numbers: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        if not all(isinstance(column, np.ndarray) for _, column in self.columns.items()):  # lists, a table of pandas
            arrays = {str(name): np.asarray(column) for name, column in self.columns.items()}
            object.__setattr__(self, "columns", arrays)
        shapes = {key: np.shape(column) for key, column in self.columns.items()}
        if not shapes:
            raise DataError(f"{self.name}: there are no columns")
        if len(set(shapes.values())) > 1 or len(next(iter(shapes.values()))) != 1:
            raise DataError(f"{self.name}: columns differ in shape: {shapes}")

    def __repr__(self) -> str:
        """Return what was read, in a line."""
        return f"<{self.name} of {self.machine}: {len(self)} rows of {shortened(', '.join(self.in_file), 120)}>"

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> Column:
        """Return one column; raise `DataError` where it is missing."""
        if column not in self.columns:
            like = [name for name in self.in_file if name.casefold() == column.casefold()]
            unread = [f"; {n}" for n in self.notes if n.code is Code.COLUMNS_UNREAD and column in n.columns]
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

    @property
    def fitted(self) -> NDArray[np.bool_]:
        """Return which rows are not held out, (n,)."""
        return np.asarray(self["split"]) != "hold" if "split" in self else np.ones(len(self), dtype=bool)

    def has(self, *columns: str) -> bool:
        return all(column in self.columns for column in columns)

    def rows(self, mask: Column) -> MeasuredData:
        """Return the rows where `mask`, shape (n,) of booleans or indices, holds."""
        kept = {key: column[mask] for key, column in self.columns.items()}
        return replace(self, columns=kept, numbers=self.row_numbers[mask])

    def rows_named(self, which: Column) -> str:
        """Return the rows `which`, a mask or indices, as they were read: "row 7", or "rows 7, 12, 40 and 3 more"."""
        found = np.unique(self.row_numbers[which]).tolist()
        more = f" and {len(found) - _SHOWN_ROWS} more" if len(found) > _SHOWN_ROWS else ""
        return f"row{'s' * (len(found) != 1)} {', '.join(map(str, found[:_SHOWN_ROWS]))}{more}"

    def labels(self, which: Column) -> tuple[str, ...]:
        """Return the numbers of the rows `which`, a mask or indices, as they were read, for a note."""
        return tuple(str(k) for k in self.row_numbers[which].tolist())

    def with_note(
        self, code: Code, text: str, columns: Iterable[str] = (), *, rows: Iterable[str] = (), **values: Any
    ) -> MeasuredData:
        """Return the same data with one more note for the report; one that is there already is not said again."""
        note = Note(code, text, tuple(columns), tuple(rows), values)
        return self if note in self.notes else replace(self, notes=(*self.notes, note))

    def with_columns(self, columns: Mapping[str, Column]) -> MeasuredData:
        """Return the data with `columns` put in the place of those of the same name, or beside them."""
        return replace(self, columns={**self.columns, **columns})


@final
@dataclass(frozen=True)
class Sensor:
    """The column an instrument fills, in `unit`, what kind of instrument it is, and what it reads.

    Sensors of one `kind` are of one make: their noise was stated once, and where that is wrong it is wrong for all.
    `part` is the target of a finding that blames this sensor alone (`joint 2`); one without a part is never blamed.
    `targets` are those of `Formulation.covariates` whose smooth errors this sensor shows, and `over_place` says whether
    one over the workspace is looked for, too. `resolution` is the stated step of its values, 0 where none is stated.
    `label` is what it reads, in words.
    """

    column: str
    kind: str
    unit: str = ""
    part: str = ""
    targets: tuple[str, ...] = ()
    label: str = ""
    resolution: float = 0.0
    over_place: bool = False


def kinds_of(sensors: Sequence[Sensor]) -> list[tuple[Sensor, ...]]:
    """Return the sensors by kind, in the order of their first."""
    kinds = dict.fromkeys(sensor.kind for sensor in sensors)
    return [tuple(sensor for sensor in sensors if sensor.kind == kind) for kind in kinds]


def blamable(sensors: Sequence[Sensor]) -> tuple[Sensor, ...]:
    return tuple(sensor for sensor in sensors if sensor.part)


def sensor_of(sensors: Sequence[Sensor], part: str) -> Sensor:
    """Return the sensor that a finding with target `part` blames. Raises `LookupError` where there is none."""
    for sensor in sensors:
        if sensor.part == part:
            return sensor
    raise LookupError(f"no sensor reads {part!r}; the parts are {', '.join(s.part for s in blamable(sensors))}")


_LARGEST_CELL = 1e60  # of a cell, in any unit
_MOST_MISSING = 0.5  # of the rows: beyond it the column is not measured
_SHOWN_WORDS = 3  # words of a column in a note
_MOST_GAPS = 0.2  # of the rows that columns which an error may follow cost together: with more one is done without


def complete(data: MeasuredData, columns: Sequence[str], sensors: Sequence[Sensor] = ()) -> MeasuredData:
    """Return the rows of `data` with a finite number in each of `columns`, in the unit of its sensor, and notes.

    Raises `DataError` for a column that is missing, holds words, is of another unit, or is empty in most rows.
    """
    numbers = {name: _numbers(data, name) for name in columns}
    wanted = {sensor.column: sensor.unit for sensor in sensors if sensor.unit}
    turned: dict[str, Array] = {}
    for name, stated in data.units.items():
        unit = wanted.get(name)
        if name not in numbers or unit is None or unit == stated:
            continue
        if not is_unit(unit):
            raise DataError(f"{data.name}: column {name} is in {stated}, and its sensor in {unit!r}, which is unknown")
        try:
            factor = between(name, stated, unit)
        except ValueError as error:
            raise DataError(f"{data.name}: {error}") from None
        if factor != 1:
            turned[name] = numbers[name] * factor
            text = f"{name}: in {stated} from the file, turned into {unit}, the unit of its sensor"
            data = data.with_note(Code.UNIT_TURNED, text, (name,), unit=unit, stated=stated)
    units = {**data.units, **{name: wanted[name] for name in data.units if name in wanted and name in numbers}}
    data = data.with_columns({**{n: c for n, c in numbers.items() if data[n].dtype.kind != "f"}, **turned})
    data = replace(data, units=units)
    missing = {name: _without_number(data[name]) for name in numbers}
    _refuse_empty(data, missing, dict.fromkeys(missing, len(data)))
    for name in columns if len(data) > 2 else ():
        if np.ptp(data[name]) == 0:
            text = f"column {name} never varies: is it read at all? No effect that follows it can be told"
            data = data.with_note(Code.COLUMN_STILL, text, (name,))
    # an angle may jump by whole turns, which a model without turns does not follow
    radians = {s.column for s in sensors if s.unit == "rad"} | {n for n, unit in data.units.items() if unit == "rad"}
    for name in columns if len(data) > 2 else ():
        reading = data[name][~missing[name]]
        if name not in radians or not len(reading) or np.ptp(reading) > 2.02 * np.pi:
            continue
        middle = float(np.angle(np.exp(1j * reading).mean()))
        whole = reading - 2 * np.pi * np.round((reading - middle) / (2 * np.pi))
        text = (
            f"{name} jumps by whole turns; a model in which the angle stands outside sine and cosine needs it without: "
            "take 2 pi off the readings beyond the jump"
        )
        if np.ptp(whole) < np.ptp(reading) - np.pi:
            data = data.with_note(Code.TURNS, text, (name,))
    return _rows_left_out(data, missing)


def with_numbers(data: MeasuredData, needed: Mapping[str, NDArray[np.bool_]]) -> MeasuredData:
    """Return the rows with a finite number in each column where it is `needed`, column -> rows (n,), and a note.

    Raises `DataError` for a column that holds words, or no number in most of the rows that need it.
    """
    missing = {name: rows & _without_number(_numbers(data, name)) for name, rows in needed.items()}
    _refuse_empty(data, missing, {name: int(rows.sum()) for name, rows in needed.items()})
    return _rows_left_out(data, missing)


def _refuse_empty(data: MeasuredData, missing: Mapping[str, NDArray[np.bool_]], rows: Mapping[str, int]) -> None:
    """Raise `DataError` where most of the `rows` that need a column have no number in it, or none is complete."""
    for name, empty in missing.items():
        if empty.sum() > _MOST_MISSING * rows[name]:
            raise DataError(
                f"{data.name}: column {name} holds no finite number in {int(empty.sum())} of {rows[name]} rows; "
                "measure it, or take a model that does without it"
            )
    if missing and len(data) and np.any(list(missing.values()), axis=0).all():
        raise DataError(f"{data.name}: no row holds a finite number in all of {', '.join(missing)}; complete some")


def without_gaps(data: MeasuredData, columns: Sequence[str], directions: Sequence[str] = ()) -> MeasuredData:
    """Return the rows of `data` with a number in each of `columns`, which an error may depend on, and notes."""
    columns = [name for name in dict.fromkeys(columns) if name in data]
    for name in (name for name in directions if name in columns and data[name].dtype.kind not in "iufb"):
        words = np.array([str(word).strip() for word in data[name]])
        both = sorted(set(words.tolist()), key=lambda word: (word != "-", word))  # "-" comes before "+"
        if len(both) == 2 and "" not in both:
            text = f"{both[0]!r} is taken for -1, {both[1]!r} for 1: the sign of what follows it is by these"
            data = data.with_columns({name: np.where(words == both[1], 1.0, -1.0)})
            data = data.with_note(
                Code.SIGNS_TAKEN, f"column {name}: {text}", (name,), negative=both[0], positive=both[1]
            )
    for name in (name for name in columns if data[name].dtype.kind not in "iufb"):
        shown_words = ", ".join(repr(str(word)) for word in np.unique(data[name])[:_SHOWN_WORDS])
        text = (
            f"column {name} holds words ({shown_words}), where numbers are needed, of a direction -1 and 1: errors "
            "that follow it are not looked for"
        )
        data = data.with_note(Code.COLUMN_NOT_FOLLOWED, text, (name,))
    empty = {name: _without_number(data[name]) for name in columns if data[name].dtype.kind == "f"}
    out, costly = np.zeros(len(data), dtype=bool), {}
    for name, gaps in sorted(empty.items(), key=lambda item: int(item[1].sum())):
        if (out | gaps).mean() > _MOST_GAPS:
            text = f"column {name} {gaps_in_words(data[name])}: errors that follow it are not looked for"
            data = data.with_note(Code.COLUMN_NOT_FOLLOWED, text, (name,), empty=int(gaps.sum()))
        else:
            out, costly[name] = out | gaps, gaps
    return _rows_left_out(data, costly)


def _without_number(column: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(~(np.abs(column) < _LARGEST_CELL))


def _rows_left_out(data: MeasuredData, missing: Mapping[str, NDArray[np.bool_]]) -> MeasuredData:
    """Return the data without the rows that lack a number, and a note on the columns that lack it."""
    missing = {name: empty for name, empty in missing.items() if empty.any()}
    if not missing:
        return data
    out, each = np.any(list(missing.values()), axis=0), []
    for name, empty in missing.items():
        huge = int(np.isfinite(np.asarray(data[name], dtype=float)[empty]).sum())
        beyond = f" (beyond {_LARGEST_CELL:g} in {huge} of them)" if huge else ""
        each.append(f"{name} in {int(empty.sum())}{beyond}")
    rows = f"{int(out.sum())} row{'s are' if out.sum() > 1 else ' is'}"
    text = f"{rows} left out for cells that hold no finite number: {', '.join(each)}"
    return data.rows(~out).with_note(Code.ROWS_LEFT_OUT, text, missing, rows=data.labels(out))


def gaps_in_words(column: NDArray[Any]) -> str:
    """Return why no error can depend on a column that lacks numbers; "" where an error can."""
    if column.dtype.kind not in "iufb":
        return "holds words: numbers are needed"
    gaps = _without_number(column) if column.dtype.kind == "f" else np.zeros(0, dtype=bool)
    return f"holds no finite number in {int(gaps.sum())} of {len(gaps)} rows" if gaps.any() else ""


def _numbers(data: MeasuredData, name: str) -> Array:
    column: NDArray[np.generic] = data[name]
    if column.dtype.kind not in "iuf":
        first = str(column[:1].tolist()[0])
        raise DataError(f"{data.name}: column {name} holds {first!r}: numbers are needed{way_out(first, '')}")
    return np.asarray(column, dtype=float)


def refuse_rows(
    data: MeasuredData, good: NDArray[np.bool_], why: Callable[[int], str], error: type[DataError] = DataError
) -> None:
    """Raise `error` for the first row that is not `good`, (n,), and `why` the row of that index is not."""
    if not good.all():
        k = int(np.argmin(good))
        raise error(f"{data.name}: {data.rows_named(np.array([k]))}: {why(k)}")


_SMALLEST, _LARGEST = 1e-15, 1e6  # of a noise or a resolution [rad, mm, N]: beyond these, squares lose their digits
_FARTHEST = 1e9  # of a length or a load [mm, rad, N]


def positive(data: MeasuredData, key: str, value: Any) -> float:
    """Return `value`, stated under `key`, as a noise or a resolution; raise `DataError` where it is none."""
    number, words = _number_of(value)
    if not _SMALLEST <= number <= _LARGEST:
        rule = f"a positive number is needed, from {_SMALLEST:g} to {_LARGEST:g}"
        raise DataError(f"{data.name}: metadata {key}={words}: {rule}")
    return number


def finite(data: MeasuredData, key: str, value: Any, unit: str = "mm, rad") -> float:
    """Return `value`, stated of `key`, as a finite number; raise `DataError` where it is none."""
    number, words = _number_of(value)
    if not abs(number) <= _FARTHEST:
        rule = f"at most {_FARTHEST:g} can be meant" if isfinite(number) else "a finite number is needed"
        raise DataError(f"{data.name}: metadata gives {key}={words}: {rule} [{unit}]")
    return number


def nominal_numbers(data: MeasuredData, known: tuple[str, ...]) -> dict[str, float]:
    """Return name -> number of what is stated under `nominal`; raise `DataError` for a name that is not `known`."""
    stated = data.metadata.get("nominal") or {}
    if not isinstance(stated, Mapping):
        example = f"names with values are needed, such as {known[0]}"
        raise DataError(f"{data.name}: metadata nominal={shown(stated)}: {example}")
    for name in stated:
        if name not in known:
            raise DataError(f"{data.name}: metadata nominal names {shown(name)!r}; {suggest(shown(name), known)}")
    return {name: finite(data, name, value) for name, value in stated.items()}


def _number_of(value: Any) -> tuple[float, str]:
    """Return what was stated as a number, NaN where it is none, and as a message shows it."""
    words = repr(shown(value)) if isinstance(value, str) else shown(value)
    try:
        return nan if isinstance(value, bool) else float(value), words
    except (TypeError, ValueError, OverflowError):
        return nan, words


def number_visits(data: MeasuredData) -> MeasuredData:
    """Return the data with poses and visits numbered from 0, whatever numbers or words a file has for them."""
    if "pose_id" in data:
        data = data.with_columns({"pose_id": _numbered(data["pose_id"])})
    if "visit_id" not in data:
        return data
    visit = _numbered(data["visit_id"])
    if "pose_id" in data:
        visit = data["pose_id"] * (visit.max() + 1) + visit
    if "t_s" in data and np.ptp(data["t_s"]) > 0:
        order = np.argsort(data["t_s"], kind="stable")
        begun = np.cumsum(np.diff(visit[order], prepend=visit[order[0]] - 1) != 0)
        visit = np.empty(len(data), dtype=np.int64)
        visit[order] = begun
    return data.with_columns({"visit_id": np.unique(visit, return_inverse=True)[1].ravel()})


def _numbered(ids: NDArray[Any]) -> NDArray[np.int64]:
    """Return ids as whole numbers, (n,), equal where they are equal; each that is missing has one of its own."""
    words = np.asarray(ids).astype(str)
    values = ids if np.asarray(ids).dtype.kind in "iuf" else words
    numbers = np.unique(values, return_inverse=True)[1].ravel().astype(np.int64)
    missing = np.isin(np.char.lower(np.char.strip(words)), sorted(NO_VALUE))
    return np.where(missing, numbers.max() + 1 + np.arange(len(words)), numbers)
