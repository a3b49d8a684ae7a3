"""Columns of a measured file: declared once (`Declared`), and what its cells mean.

A cell that means "no value" (n/a, NaN, -, #NV, or nothing) is NaN. A decimal comma is read where commas do not part the
cells, and never where the same file has decimal points too. Times become seconds: ISO times with their date, and times
of day, `14:03:22.5` or `14:03`, of which one that is more than twelve hours before the one above is of the next day.
Packed times, 20200714163904, are times, and so are ms, us and ns since 1970 where seconds are declared.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeGuard, final

import numpy as np

from calibench.core.notes import Code, DataError, Note
from calibench.core.options import suggest
from calibench.core.tables.cells import Array, factor_to_base, is_unit, no_value, number_of, way_out, with_points
from calibench.core.tables.csv_table import Table, heads, read_table
from calibench.core.tables.data_file import MOST_LETTERS
from calibench.core.words import counted, plain, shortened

_NAMES = ("pose_id", "visit_id")  # columns whose numbers are names: words do as well
_INTEGER = re.compile(r"[+-]?\d{1,18}")
_LIKE_NUMBER = re.compile(r"[+-]?[.,]?\d")
_TRUTH = {"true": True, "false": False, "wahr": True, "falsch": False}
_TIME = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d{1,9})?)?\s*(Z|[+-]\d\d:?\d\d)?")
_OF_DAY = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d(?:[.,]\d{1,9})?|60(?:[.,]0{1,9})?))?")  # 60: rounded up
_PACKED = re.compile(r"((?:19|20)\d\d)(\d\d)(\d\d)[_T-]?(\d\d)(\d\d)(\d\d)(?:[.,]?(\d{1,9}))?")
_DAY = 86400.0  # s
_LATEST = 1e11  # s: no run takes 3000 years, and no clock that counts from 1970 is there
_COUNTED = {"ms": 1e12, "us": 1e15, "ns": 1e18}  # since 1970, from 2001 on and for 280 years
_FEW = 0.1  # of a column: so many cells among times of day are mistakes, and more are words
_ALIKE = "write all of them alike"


@final
@dataclass(frozen=True)
class Quantity:
    """A named number of every reading: its unit ("" for a count), and its name in words.

    `own` is the target to which it belongs (the torque of leg 2), where each target has one. `text`: it holds words.
    `needed`: a file without it cannot be used.
    """

    name: str
    unit: str = ""
    label: str = ""
    own: str = ""
    text: bool = False
    needed: bool = False


@final
@dataclass(frozen=True, eq=False)
class Columns:
    """The content of a file: columns name -> (n,), what it states beside them, and notes.

    `units` are those that it states of columns, `of_day` the columns that were times of day, such as 14:03:22.
    """

    columns: Mapping[str, Any]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    of_day: frozenset[str] = frozenset()


# columns that any file may have
_ANYWHERE = (Quantity("t_s", "s", "time"), Quantity("repeat"), Quantity("split", text=True))


@final
@dataclass(frozen=True, eq=False)
class Declared:
    """What the files of a `machine` hold; nothing declared: columns of any name.

    `named` tells of columns whose names depend on the file (the joints of an arm). With `own_units` numbers stay in the
    units that a file states. `files` are formats of the field, ending (".dat") -> a function from a file's text to its
    columns in base units, which raises `DataError`. `printed` names sets that a paper prints, `demonstrations` is a
    folder of files that ship.
    """

    machine: str = ""
    columns: tuple[Quantity, ...] = ()
    named: Callable[[str], Quantity | None] | None = None
    own_units: bool = False
    files: Mapping[str, Callable[[str], Columns]] = field(default_factory=dict)
    printed: tuple[str, ...] = ()
    demonstrations: Path | None = None

    @property
    def units(self) -> dict[str, str]:
        """Return column -> unit, where one is declared."""
        return {one.name: one.unit for one in self.columns if one.unit}

    @property
    def words(self) -> frozenset[str]:
        """Return the columns that hold words."""
        return frozenset(one.name for one in (*_ANYWHERE, *self.columns) if one.text)

    @property
    def numbers(self) -> dict[str, str]:
        """Return the columns that hold numbers and no names, with their units."""
        return {one.name: one.unit for one in (*_ANYWHERE, *self.columns) if not one.text and one.name not in _NAMES}

    def factor(self, column: str, unit: str) -> tuple[str, float]:
        """Return the unit in which `column` is kept and the factor that turns `unit` into it, or raise `ValueError`."""
        if self.own_units:
            return unit, 1.0
        try:
            return factor_to_base(column, unit, self.units.get(column))
        except ValueError as error:
            mend = f'; units={{"{column}": "UNIT"}} states it where the file cannot be changed' if self.machine else ""
            raise ValueError(f"{error}{mend}") from None

    def read(self, path: str | Path, where: str, bare: bool = False) -> Columns:
        """Return the declared columns of a CSV file, which if `bare` may have no header; others are passed over.

        Raises `ValueError`, which begins with `where`, for a column that is needed and not there, and as `columns_of`.
        """
        known = [one.name for one in self.columns]
        try:
            table = read_table(path, bare)
            names = table.names or tuple(known)
            if missing := [one.name for one in self.columns if one.needed and one.name not in names]:
                raise DataError(f"no column {', '.join(missing)}; the header has {', '.join(names)}")
            at = [k for k, name in enumerate(names) if name in known]
            rows = tuple((line, tuple(row[k] if k < len(row) else "" for k in at)) for line, row in table.rows)
            kept, units = tuple(names[k] for k in at), {name: u for name, u in table.units.items() if name in known}
            return in_base_units(columns_of(replace(table, names=kept, units=units, rows=rows), self), self)
        except (OSError, ValueError) as error:
            raise ValueError(f"{where}: cannot be read: {error}") from None


ANY = Declared()


def is_table(given: object) -> TypeGuard[Mapping[str, Any]]:
    """Tell whether columns are given by name: a mapping, or a table of pandas."""
    return hasattr(given, "keys") and hasattr(given, "__getitem__")


def named_columns(given: Any, name: str = "data", bare: Collection[str] = (), declared: Declared = ANY) -> Columns:
    """Return the columns of a mapping or of a table of pandas, and the units that stand in their heads, ``x [m]``.

    Heads that are `bare` are names as they are. Words and objects are read as the cells of a file. Raises `DataError`
    for columns that differ in length, and for a cell that is no number among numbers.
    """
    columns = {str(key): np.asarray(given[key]) for key in given.keys()}  # noqa: SIM118  # of a DataFrame
    shapes = {key: column.shape for key, column in columns.items()}
    if len(set(shapes.values())) != 1 or len(next(iter(shapes.values()))) != 1:
        raise DataError(f"{name}: columns of one length are needed, and these have {shapes or 'none'}")
    names, units = heads([key for key in columns if key not in bare])
    told = iter(names)
    keys = {key if key in bare else next(told): column for key, column in columns.items()}
    return Columns({key: _of_cells(key, column, declared) for key, column in keys.items()}, units=units)


def _of_cells(name: str, column: Any, declared: Declared) -> Any:
    """Return a column of words or objects as if its cells stood in a file; any other as it is."""
    if column.dtype.kind not in "OU":
        return column
    cells = ["" if no_value(str(one)) and not isinstance(one, str) else str(one).strip() for one in column.tolist()]
    if name in declared.words:
        return as_words(name, cells)
    cells = with_points({name: cells})[name]
    seconds = _seconds(name, cells, None, declared)
    return seconds[0] if seconds else _numbers(name, cells, declared)


def columns_of(table: Table, declared: Declared = ANY) -> Columns:
    """Return the columns of a table of text. Raises `DataError` for rows that do not fit the header.

    What is declared as words holds words; any other column holds numbers, true and false, times, or words if no cell of
    it is a number.
    """
    names, units, rows, notes = table.names, dict(table.units), table.rows, list(table.notes)
    if not names:
        names = tuple(f"column_{k + 1}" for k in range(len(rows[0][1])))
        notes.append(f"no header: columns are called {names[0]} to {names[-1]}; columns= names them")
    elif rows:
        # units may stand in a row of their own beneath the header; the unit of what has none is written 1, so a row of
        # nothing but bare ones and dashes is a reading
        bare = tuple(cell.strip().strip("[](){}<>").strip() for cell in rows[0][1])
        bracketed = [cell.strip()[:1] in tuple("[({<") for cell in rows[0][1] if cell.strip()]
        some = sum(map(bool, bare)) > 1 and all(map(is_unit, filter(None, bare))) and set(bare) - {"1", "-", ""}
        if bracketed and (all(bracketed) or some) and "-" not in bare[:1]:
            units = {name: unit for name, unit in zip(names, bare, strict=False) if unit not in ("", "-")} | units
            rows = rows[1:]
    if not rows:
        raise DataError("holds a header and no readings; a row for each reading is needed")
    for number, (line, row) in enumerate(rows, start=1):
        if len(row) != len(names):
            commas = table.delimiter == "," and len(row) > len(names)
            mend = "decimal commas? then part the cells by semicolons" if commas else "mend it, or leave the row out"
            what = f"reading {number} has {len(row)} cells, the {'header' if table.names else 'first'} {len(names)}"
            raise DataError(f"{what}; it is line {line} of the file: {mend}")

    words = declared.words
    cells = {name: [row[k].strip() for _, row in rows] for k, name in enumerate(names) if name}
    others = {
        name: [cell.replace("\u2212", "-") for cell in column]  # U+2212 is the minus of typography
        for name, column in cells.items()
        if name not in words
    }
    if table.delimiter != ",":
        try:
            others = with_points(others)
        except ValueError as error:
            raise DataError(str(error)) from None

    columns: dict[str, Any] = {}
    times: dict[str, list[str]] = {}
    of_day = set()
    for name, column in cells.items():
        if name in words:
            columns[name] = as_words(name, column)
        elif seconds := _seconds(name, others[name], units.get(name), declared):
            columns[name], note = seconds
            times.setdefault(note, []).append(name)
            of_day |= {name} if note.startswith("times of day") else set()
        else:
            columns[name] = _numbers(name, others[name], declared)
    notes += [f"{', '.join(those)}: {note}" for note, those in times.items()]
    for name in others:
        said = [] if columns[name].dtype.kind != "U" else [w for w in columns[name].tolist() if not no_value(w)]
        if said and all(map(_LIKE_NUMBER.match, said)):
            notes.append(f"column {name} is read as words: {shortened(said[0])!r} is no number")
    clocks = {name for those in times.values() for name in those}
    stated = {name: unit for name, unit in units.items() if name not in clocks} | dict.fromkeys(sorted(of_day), "s")
    return Columns(columns, {}, tuple(Note(Code.FILE, note) for note in notes), stated, frozenset(of_day))


def _numbers(name: str, cells: Sequence[str], declared: Declared) -> Any:
    """Return the column of these cells: whole numbers, true and false, numbers, or words where none is a number."""
    if all(map(_INTEGER.fullmatch, cells)):
        return np.array([int(cell) for cell in cells], dtype=np.int64)
    if all(cell.lower() in _TRUTH for cell in cells):
        return np.array([_TRUTH[cell.lower()] for cell in cells], dtype=bool)
    values = [number_of(cell) for cell in cells]
    wrong = [i for i, value in enumerate(values) if value is None and not no_value(cells[i])]
    if not wrong:
        return np.array([np.nan if value is None else value for value in values])
    all_wrong = len(wrong) == sum(not no_value(cell) for cell in cells)
    if name in _NAMES or (all_wrong and name not in declared.numbers):
        return as_words(name, cells)
    cell = cells[wrong[0]]
    raise DataError(f"column {name}, reading {wrong[0] + 1}: {shortened(cell)!r} is no number{way_out(cell)}")


def as_words(name: str, words: Sequence[str]) -> Any:
    """Return a column of words as an array, whose cells are all as wide as the widest; raise `DataError` beyond it."""
    check_letters(name, max(map(len, words), default=0), len(words))
    return np.array(words, dtype=str)


def check_letters(name: str, widest: int, rows: int) -> None:
    """Raise `DataError` for a column whose words, each as wide as the widest, would take too much room."""
    if widest * rows > MOST_LETTERS:
        raise DataError(f"column {name}: a cell has {widest} characters; words are needed, or leave the column out")


def _seconds(name: str, cells: Sequence[str], unit: str | None, declared: Declared) -> tuple[Array, str] | None:
    """Return a column of times in seconds, NaN where there is none, and a note; None for one of other cells.

    `unit` is what its head states: one of another quantity holds angles in hours or degrees. Raises `DataError` for a
    cell that is no time among times, and where some times have a date and some have none.
    """
    first = next((cell for cell in cells if not no_value(cell)), "")
    if _PACKED.fullmatch(first):
        packed = [unpacked(cell) for cell in cells]
        if all(time is not None or no_value(cell) for time, cell in zip(packed, cells, strict=True)):
            return _from_earliest(packed), "packed times, turned into seconds from the earliest"
    if _TIME.fullmatch(first):
        times: list[datetime | None] = []
        for i, cell in enumerate(cells):
            where = f"column {name}, reading {i + 1}"
            if no_value(cell):
                times.append(None)
                continue
            if _OF_DAY.fullmatch(cell):
                raise DataError(f"{where}: {cell!r} has no date, and other times have one; {_ALIKE}")
            try:
                times.append(datetime.fromisoformat(cell.replace(",", ".").replace(" ", "T", 1).replace(" ", "")))
            except ValueError:
                raise DataError(f"{where}: {shortened(cell)!r} is no time such as 2026-03-01T12:30:05") from None
        dates = [time for time in times if time is not None]
        if len({time.tzinfo is None for time in dates}) > 1:
            raise DataError(f"column {name}: some times state their zone and some do not; {_ALIKE}")
        return _from_earliest(times), "times, turned into seconds from the earliest"
    of_time = unit is None or not is_unit(unit) or (factor_to_base(name, unit)[0] == "s" and unit.strip() != "h")
    if not _OF_DAY.fullmatch(first) or name in _NAMES or not of_time or declared.numbers.get(name, "s") != "s":
        return None
    others = [i for i, cell in enumerate(cells) if not (no_value(cell) or _OF_DAY.fullmatch(cell))]
    dated = next((i for i in others if _TIME.fullmatch(cells[i])), None)
    if dated is not None:
        raise DataError(
            f"column {name}, reading {dated + 1}: {cells[dated]!r} has a date, and {first!r} has none; {_ALIKE}"
        )
    if len(others) > _FEW * len(cells) and name not in declared.numbers:
        return None  # words, one of which looks like a time
    if others:
        word = shortened(cells[others[0]])
        raise DataError(f"column {name}, reading {others[0] + 1}: {word!r} is no time of day such as 14:03:22.5")
    values = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        if time := _OF_DAY.fullmatch(cell):
            hours, minutes, rest = time.groups("0")
            values[i] = 3600 * int(hours) + 60 * int(minutes) + float(rest.replace(",", "."))
    known = np.flatnonzero(~np.isnan(values))
    passed = np.cumsum(np.diff(values[known], prepend=values[known[0]]) < -_DAY / 2)
    values[known] += _DAY * passed - values[known[0]]
    nights = int(passed[-1])
    over = f", on over {counted(nights, 'midnight')}" if nights else ""
    return values, f"times of day, turned into seconds from the first{over}"


def unpacked(cell: str) -> datetime | None:
    """Return the time of 20200714163904, perhaps with a fraction behind it; None for what is no such time."""
    if (time := _PACKED.fullmatch(cell)) is None:
        return None
    with suppress(ValueError):
        at = datetime.strptime("".join(time.groups()[:6]), "%Y%m%d%H%M%S")
        return at.replace(microsecond=int(f"{time[7] or '0':0<6}"[:6]))
    return None


def _from_earliest(times: Sequence[datetime | None]) -> Array:
    start = min(time for time in times if time is not None)
    return np.array([np.nan if time is None else (time - start).total_seconds() for time in times])


def as_seconds(values: Array) -> tuple[Array | None, str]:
    """Return numbers without a unit as seconds, None where they can be none, and what was done, "" for seconds.

    >>> as_seconds(np.array([20200714163904.0, 20200714163906.0]))
    (array([0., 2.]), 'packed times, turned into seconds from the earliest')
    >>> as_seconds(np.array([2.0201e13, 2.0201e13]))[0] is None
    True
    """
    known = values[np.isfinite(values)]
    if not len(known) or np.abs(known).max() < _LATEST:
        return values, ""
    packed = [unpacked(f"{value:.0f}") if np.isfinite(value) else None for value in values.tolist()]
    if sum(time is not None for time in packed) == len(known):
        return _from_earliest(packed), "packed times, turned into seconds from the earliest"
    for unit, least in _COUNTED.items():
        if (known >= least).all() and (known < 10 * least).all():
            return (values - known.min()) * (1e9 / least), f"{unit} since 1970, turned into seconds from the earliest"
    return None, "no number of seconds, and no time: it is not used as one"


def rename(
    content: Columns, columns: Mapping[str, str], units: Mapping[str, str], declared: Declared = ANY, *,
    part: bool = False, of: str = "the file",
) -> Columns:  # fmt: skip
    """Return the content with names and units of one's own: `columns` name -> what the file calls it, `units`.

    `columns={"enc_1": "Winkel 1"}`: the column that the file calls Winkel 1 is enc_1. Of a `part` of a table both may
    name what other files hold. Raises `DataError` for a column there is not, or two for one name.
    """
    there = content.columns
    sources = dict(columns)
    for target, source in columns.items():
        if source not in there:  # the column whose head, with or without its unit, it is
            with suppress(ValueError):
                [name], of_head = heads([source])
                sources[target] = name if of_head.get(name) == content.units.get(name, "\0") else source
    if part:
        columns = {target: source for target, source in columns.items() if sources[target] in there}
        units = {n: unit for n, unit in units.items() if n in {*there, *columns, *columns.values()}}
        sources = {target: sources[target] for target in columns}
    known = [column.name for column in declared.columns]
    targets = {source: target for target, source in sources.items()}
    for target, source in columns.items():
        if sources[target] not in there:
            raise DataError(f"columns: {target} is to be {source!r}; {suggest(source, list(there))}")
        by_the_file = declared.named is not None and declared.named(target) is not None  # such as q_ and a joint
        if known and target not in known and not by_the_file:
            raise DataError(f"columns: {target!r} is no column of {declared.machine}; {suggest(target, known)}")
        if target in there and target not in targets:
            raise DataError(f"columns: {target} is in {of} already, beside {source!r}; leave out one of them")
        column = there[sources[target]]
        if target in declared.numbers and column.dtype.kind == "U":
            word = next(one for one in column.tolist() if not no_value(one))
            raise DataError(f"columns: {target} is to be {source!r}, which holds {shortened(word)!r}, no number")
    if len(targets) < len(columns):
        twice = next(source for source in columns.values() if list(columns.values()).count(source) > 1)
        raise DataError(f"columns: {twice!r} cannot be two columns at once; name each once")

    stated = {targets.get(name, name): unit for name, unit in content.units.items()}
    notes = list(content.notes)
    for target, source in columns.items():
        column = there[sources[target]]
        if all(map(no_value, column.tolist())) if column.dtype.kind == "U" else np.isnan(column.astype(float)).all():
            notes.append(
                Note(Code.FILE, f"columns: {target} is to be {source!r}, which is blank in every row", (target,))
            )
    for source, target in targets.items():
        last = source.rpartition("_")[2]
        tells = source not in (target, last) and len(last) > 1 and (is_unit(last) or last.casefold() == "grad")
        if tells and target not in stated and target not in units:
            stated[target] = last
            notes.append(Note(Code.UNIT, f"{target}: the name {source} states the unit {last}", (target,)))
    made = {targets.get(name, name): column for name, column in there.items()}
    for name, unit in units.items():
        if targets.get(name, name) not in made:
            raise DataError(f"units: {name} is no column of {of}; {suggest(name, list(made))}")
        if {name, columns.get(name)} & content.of_day and unit.strip() != "s":
            raise DataError(
                f"units: {name} holds times of day, read in seconds; write an angle as one number of degrees"
            )
        head = content.units.get(targets.get(name, name)) or content.units.get(columns.get(name, name))
        if declared.own_units and head not in (None, unit):
            raise DataError(
                f"units: {name} is in {head} by its head, and {unit} here: numbers stay as the file has them; write "
                "them in the unit of your model, or correct the head"
            )
        stated[targets.get(name, name)] = unit
    return replace(content, columns=made, units=stated, notes=tuple(notes))


def in_base_units(content: Columns, declared: Declared = ANY) -> Columns:
    """Return the columns in base units, and a note; `ValueError` as of `Declared.factor`, `DataError` for words."""
    columns, units = dict(content.columns), {}
    by_unit: dict[tuple[str, str], list[str]] = {}
    for name, unit in content.units.items():
        units[name], scale = declared.factor(name, unit)
        if units[name] != "1" and columns[name].dtype.kind not in "iuf":
            first = str(columns[name][:1].tolist()[0])
            raise DataError(f"column {name}: has the unit {unit}, and holds no numbers: {first!r}{way_out(first, '')}")
        if scale != 1:
            columns[name] = np.asarray(columns[name], dtype=float) * scale
            by_unit.setdefault((unit, units[name]), []).append(name)
    notes = []
    for (unit, base), names in by_unit.items():
        text = f"{', '.join(names)}: stated in {unit.strip()}, turned into {base}"
        notes.append(Note(Code.UNIT_TURNED, text, tuple(names), values={"stated": unit.strip()}))
    for name in [name for name, unit in declared.units.items() if unit == "s" and name in columns]:
        if name not in content.units and columns[name].dtype.kind in "iuf":
            columns, told = with_seconds(columns, name)
            notes += told
    return replace(content, columns=columns, units=units, notes=(*content.notes, *notes))


def with_seconds(columns: Mapping[str, Any], name: str) -> tuple[dict[str, Any], list[Note]]:
    """Return the columns with `name` in seconds, or without it where its numbers can be none, and a note."""
    seconds, text = as_seconds(np.asarray(columns[name], dtype=float))
    if not text:
        return dict(columns), []
    if seconds is not None:
        return {**columns, name: seconds}, [Note(Code.UNIT_TURNED, f"{name}: {text}", (name,))]
    text = f"{name}: {plain(float(np.nanmax(columns[name])), 5)} is {text}"
    return {one: c for one, c in columns.items() if one != name}, [Note(Code.COLUMN_NOT_USED, text, (name,))]
