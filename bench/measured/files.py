"""Measured data on disk: Parquet, CSV, Excel or MATLAB, their units, and what was stated about them.

Parquet: the unit of a column stands in its field's metadata under ``unit``; machine, noise and nominal values are JSON
in the file's metadata under ``measured_data``. CSV: the header names the unit (``enc_1 [rad]``), and the same JSON is
the first line (``# measured_data: {...}``) or a file beside it of the same stem (``run7.json`` for ``run7.csv``).
What the command line states goes before what the file does. Without a unit a column is in the documented one; a unit
that is not known is refused, for what it means is not ours to guess. `columns` and `units` name what the file does not.
A machine may declare formats of its field (`Description.files`); they are read where that machine is asked for.

A Parquet file's table, after its footer was looked at: Arrow makes memory ready for what the footer says.

A file of a few kilobytes can state a billion rows, and unpack to gigabytes; with a hundred thousand columns Arrow does
not raise but aborts. The footer is small, and says it beforehand, but for lists, which are no columns here, and for one
long word that stands in many rows: words are read as numbers into a list of words, and looked at as such.

A ball in sockets: a folder of places, each with hole_0.csv, hole_1.csv ... (or socket_K), is one set of readings.

A place is named by its path below the folder. A row is a posture; which socket of which place it was taken in becomes
the columns `socket` and `place`.

Names and units that the owner of a file gives to its columns: `columns=` and `units=`.

`columns={"enc_1": "Winkel 1"}`: the column that the file calls Winkel 1 is enc_1. `units={"enc_1": "deg"}`: what the
numbers are in, where the file does not say it, or not in a way that is understood.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from calibench.bench.measured.csv_columns import (
    Found,
    as_words,
    check_letters,
    csv_lines,
    factor,
    of_table,
    read_csv,
    units_of,
)
from calibench.bench.measured.matlab_table import read_matlab
from calibench.bench.store.atomic_file import write_whole
from calibench.core.notes import Code, Note, once
from calibench.core.options import read_word, shown, suggest
from calibench.core.tables.cells import is_unit, way_out
from calibench.core.tables.csv_table import heads, read_excel
from calibench.core.tables.data_file import (
    LARGEST_METADATA,
    LARGEST_OWN,
    LARGEST_PARQUET,
    LARGEST_TEXT,
    LARGEST_UNPACKED,
    LONGEST_FOOTER,
    MEGABYTE,
    MOST_NUMBERS,
    check_columns,
    read_whole,
    text_of,
)
from calibench.core.words import DEEPEST, counted, depth
from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.labels import columns_of_text
from calibench.discrepancy.model.machine import Foreign
from calibench.discrepancy.registries import description_of, machines

KEY = "measured_data"
SCHEMA_VERSION = 1
WRITTEN = (".parquet", ".csv")
EXCEL, MATLAB = (".xlsx", ".xlsm"), (".mat",)
ENDINGS = (*WRITTEN, ".tsv", *EXCEL, *MATLAB)  # a folder's files that are data; any other that is named is read as text


def endings_of(machine: str) -> tuple[str, ...]:
    """Return the endings of the files that are read for a machine: tables, and formats of its own field."""
    return (*ENDINGS, *description_of(machine).files)


_TEXT = columns_of_text()


def read_measured(
    path: str | Path, machine: str = "", stated: Mapping[str, Any] | None = None,
    columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None, part: bool = False,
) -> MeasuredData:  # fmt: skip
    """Return the data in `path`. `machine` must be the file's, if it states one; `stated` goes before its metadata.

    `columns` are name -> what the file calls it (``{"enc_1": "Winkel 1"}``), `units` name -> unit, for columns of which
    the file states none, or not in a known way. Of a file that is `part` of a table they may name what others hold.
    Raises `DataError`, in one line that begins with the path, for what cannot be read or is of another machine.
    """
    path = Path(path)
    try:
        found, metadata = _of_its_field(path, machine) or _of_a_table(path)
        metadata |= stated or {}
        of = str(metadata.get("machine", machine))
        if not of:
            raise DataError(f"states no machine; give machine=NAME, or a {KEY} with one")
        of = machine if of.casefold() == machine.casefold() else of
        if machine and of != machine:
            raise DataError(f"is data of machine {of}, and machine={machine} was asked for; write machine={of}")
        names = pairs_of("columns", metadata.pop("columns", {}) if columns is None else columns)
        said = pairs_of("units", metadata.pop("units", {}) if units is None else units)
        found = renamed(found, of, *(of_part(found, names, said) if part else (names, said)))
        table, notes, base = _in_base_units(found.columns, found.units, of)
        about = {**metadata, "machine": of}
        statements = frozenset(stated or {}) - {"columns", "units"}
        return MeasuredData(table, of, about, path.stem, (*found.notes, *notes), units=base, stated=statements)
    except FileNotFoundError:
        raise DataError(f"{path}: there is no such file") from None
    except (DataError, ValueError, pa.ArrowException, NotImplementedError) as error:
        raise DataError(f"{path}: {_one_line(error)}") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or _one_line(error)}") from None


def write_measured(data: MeasuredData, path: str | Path) -> Path:
    """Write `data` to `path`, ``.parquet`` or ``.csv``, whole or not at all; reading it gives the same values back.

    Raises `DataError` for a path with another ending.
    """
    path = Path(path)
    if path.suffix.lower() not in WRITTEN:
        raise DataError(f"{path}: the name must end in {' or '.join(WRITTEN)}")
    units = {**units_of(data.machine), **{n: unit for n, unit in data.units.items() if unit != "1"}}
    metadata = {"schema_version": SCHEMA_VERSION, **data.metadata, "machine": data.machine}
    if path.suffix.lower() == ".csv":
        lines = csv_lines(data.columns, units, f"# {KEY}: {json.dumps(metadata, default=_plain)}")
        return write_whole(path, lambda file: file.write(lines.encode()))
    fields, arrays = [], []
    for name, column in data.columns.items():
        array = pa.array(column.tolist() if column.dtype.kind in "UO" else column)
        unit = {"unit": units[name]} if name in units else None
        fields.append(pa.field(name, array.type, metadata=unit))
        arrays.append(array)
    schema = pa.schema(fields, metadata={KEY: json.dumps(metadata, default=_plain)})
    return write_whole(path, lambda file: pq.write_table(pa.table(arrays, schema=schema), file, compression="zstd"))


def _of_its_field(path: Path, machine: str) -> tuple[Found, dict[str, Any]] | None:
    """Return the content and the statements of a file in a format of the machine's field; None for any other file.

    Text with an unspecific ending (night.txt) is read in the first format that accepts it.
    """
    formats, ending = description_of(machine).files, path.suffix.lower()
    if ending in formats:
        return _foreign(formats[ending](text_of(read_whole(path, LARGEST_OWN))))
    if ending in ENDINGS or not formats or path.stat().st_size > LARGEST_OWN:
        return None
    text = text_of(read_whole(path, LARGEST_TEXT))
    for own, read in formats.items():
        try:
            foreign = read(text)
        except ValueError:
            continue
        return _foreign(replace(foreign, notes=(*foreign.notes, Note(Code.FILE, f"read as a file that ends in {own}"))))
    return None


def _foreign(foreign: Foreign) -> tuple[Found, dict[str, Any]]:
    return Found(dict(foreign.columns), {}, "", foreign.notes), _checked(dict(foreign.metadata))


def _of_a_table(path: Path) -> tuple[Found, dict[str, Any]]:
    found = _read(path)
    return found, _metadata(path, found)


def _read(path: Path) -> Found:
    """Return the content of a file, by the reader for its ending; without one it is read as a table of text."""
    ending = path.suffix.lower()
    if ending == ".parquet":
        return _read_parquet(path)
    if ending == ".json":  # what is stated beside a table, or a table as pandas writes it
        raise DataError("is JSON; a table is needed: CSV, Excel (.xlsx), MATLAB (.mat) or Parquet")
    if ending in EXCEL:
        table, notes = read_excel(path)
        found = of_table(table, _TEXT)
        return replace(found, notes=(*(Note(Code.FILE, text) for text in notes), *found.notes))
    return read_matlab(path, _TEXT) if ending in MATLAB else read_csv(path, _TEXT)


def _read_parquet(path: Path) -> Found:
    """Return columns, stated units and metadata of a Parquet file."""
    content = read_whole(path, LARGEST_PARQUET, "take part of the readings or of the columns")
    try:
        table = table_of(content)
    except (pa.ArrowException, OSError, OverflowError) as error:
        raise DataError(f"is no Parquet file that can be read ({_one_line(error)})") from None
    columns, units = {}, {}
    for field, column in zip(table.schema, table.columns, strict=True):
        if field.name.startswith("__index_level_"):  # pandas' own
            continue
        columns[field.name] = _as_numpy(field.name, column)
        stated = (field.metadata or {}).get(b"unit")
        if stated is not None:
            units[field.name] = stated.decode("utf-8", "replace")
    found = (table.schema.metadata or {}).get(KEY.encode())
    return Found(columns, units, "" if found is None else found.decode("utf-8", "replace"))


def _metadata(path: Path, found: Found) -> dict[str, Any]:
    """Return the statements in a file, and in the JSON file beside it where it is not a Parquet file."""
    if path.suffix.lower() == ".parquet":
        return _checked(_json(found.said, f"metadata {KEY}")) if found.said else {}
    beside = path.with_suffix(".json")
    stated = _checked(_beside(beside)) if beside.exists() else {}
    lead, colon, said = found.said.partition(":")
    if colon and lead.strip("# ") == KEY:
        stated |= _checked(_json(said, f"first line, {KEY}"))
    return stated


def _beside(path: Path) -> Any:
    """Return the statements of the JSON file beside a CSV file."""
    try:
        return _json(text_of(read_whole(path, LARGEST_METADATA)), path.name)
    except OSError as error:
        raise DataError(f"{path.name} beside it cannot be read: {error.strerror or _one_line(error)}") from None
    except ValueError as error:
        raise error if isinstance(error, DataError) else DataError(f"{path.name} beside it: {error}") from None


def _as_numpy(name: str, column: pa.ChunkedArray) -> Any:
    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if is_text(kind):
        column = column.cast(pa.large_string())
        return as_words(name, [value or "" for value in column.to_pylist()])
    if pa.types.is_boolean(kind):
        return np.array([bool(value) for value in column.to_pylist()], dtype=bool)  # neither true nor false: not valid
    if pa.types.is_integer(kind) and not column.null_count:
        return column.to_numpy().astype(np.int64)
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return column.cast(pa.float64()).to_numpy().astype(float)  # what is missing is NaN
    raise DataError(f"column {name}: numbers, words or true and false are needed, it holds {kind}")


def _in_base_units(
    columns: dict[str, Any], units: Mapping[str, str], machine: str
) -> tuple[dict[str, Any], tuple[Note, ...], dict[str, str]]:
    """Return the columns in base units, a note for those that were in others, and the unit of each that stated one."""
    turned: dict[tuple[str, str], list[str]] = {}
    stated: dict[str, str] = {}
    for name, unit in units.items():
        base, scale = factor(name, unit, machine)
        if base != "1" and columns[name].dtype.kind not in "if":
            first = str(columns[name][:1].tolist()[0])
            raise DataError(f"column {name}: has the unit {unit}, and holds no numbers: {first!r}{way_out(first, '')}")
        stated[name] = base
        if scale != 1:
            columns[name] = columns[name] * scale
            turned.setdefault((unit, base), []).append(name)
    notes = (
        Note(Code.UNIT_TURNED, f"{', '.join(names)}: stated in {unit.strip()}, turned into {base}", tuple(names))
        for (unit, base), names in turned.items()
    )
    return columns, tuple(notes), stated


def _checked(metadata: Any) -> dict[str, Any]:
    if not isinstance(metadata, dict):
        raise DataError(f'{KEY}: a JSON object is needed, such as {{"machine": "{machines.names()[0]}"}}')
    version = metadata.get("schema_version", SCHEMA_VERSION)
    if str(version) != str(SCHEMA_VERSION):
        raise DataError(f"{KEY}: schema_version is {shown(version)}, this version reads {SCHEMA_VERSION}")
    if not isinstance(metadata.get("machine", ""), str):
        raise DataError(f"{KEY}: machine is {shown(metadata['machine'])}; the name of one is needed")
    return metadata


def _json(text: str, where: str) -> Any:
    if len(text) > LARGEST_METADATA:
        raise DataError(f"{where}: has {len(text)} characters, and at most {LARGEST_METADATA} are read")
    deep = depth(text)
    if deep > DEEPEST:
        raise DataError(f"{where}: brackets stand {deep} deep in each other; at most {DEEPEST} are read")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise DataError(f"{where}: is no JSON ({error.msg}, character {error.pos})") from None


def _plain(value: Any) -> Any:
    """Return NumPy's numbers and arrays, and mappings that are no dict, as JSON has them."""
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


_END = 8  # bytes: the length of the footer, little endian, and PAR1
_MOST_OBJECTS = 1_000_000  # in one list of the footer
_SMALLER = "take part of the readings or of the columns"


def table_of(content: bytes) -> pa.Table:
    """Return the table. Raises `DataError` or `ValueError` for one beyond the bounds, and what Arrow raises."""
    footer = int.from_bytes(content[-_END:-4], "little")
    if content[-4:] == b"PAR1" and LONGEST_FOOTER < footer < len(content):
        raise DataError(
            f"has {footer / MEGABYTE:.0f} MB that tell of its columns, and at most {LONGEST_FOOTER // MEGABYTE} MB are "
            f"read; leave out columns, or write fewer row groups"
        )
    file = _opened(content, [])
    about = file.metadata
    check_columns(about.num_columns)
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    rows = sum(group.num_rows for group in groups)
    if rows * about.num_columns > MOST_NUMBERS:
        raise DataError(
            f"has {rows} rows of {about.num_columns} columns, and at most {MOST_NUMBERS} cells are read; {_SMALLER}"
        )
    words = []
    for field in file.schema_arrow:
        if is_text(field.type):
            words.append(field.name)
        if pa.types.is_nested(field.type) or pa.types.is_fixed_size_binary(field.type):
            raise DataError(f"column {field.name}: numbers, words or true and false are needed, it holds {field.type}")
    unpacked = sum(group.total_byte_size for group in groups)
    if unpacked > LARGEST_UNPACKED:
        raise DataError(
            f"unpacks to {unpacked / MEGABYTE:.0f} MB, and at most {LARGEST_UNPACKED // MEGABYTE} MB are read; "
            f"{_SMALLER}"
        )
    table = _opened(content, words).read()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_dictionary(column.type) and is_text(column.type.value_type):
            widest = (pc.max(pc.binary_length(part.dictionary)).as_py() for part in column.chunks)
            check_letters(name, max((width or 0 for width in widest), default=0), len(column))
    return table


def is_text(kind: pa.DataType) -> bool:
    """Tell whether a column of this type holds words."""
    text_kinds = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
    return any(is_it(kind) for is_it in (*text_kinds, pa.types.is_binary, pa.types.is_large_binary))


def _opened(content: bytes, words: list[str]) -> pq.ParquetFile:
    return pq.ParquetFile(
        pa.BufferReader(content), thrift_string_size_limit=LONGEST_FOOTER, thrift_container_size_limit=_MOST_OBJECTS,
        read_dictionary=words,
    )  # fmt: skip


_TEXTS = (".csv", ".txt", ".tsv")
_SOCKET = re.compile(r"(?:hole|socket)[_ -]?(\d+)", re.IGNORECASE)


@final
@dataclass(frozen=True)
class SocketFile:
    """The postures of one socket: where the file lies, the socket's number and its place, and how it is called."""

    path: Path
    socket: int
    place: str
    label: str


def socket_files(folder: Path) -> list[SocketFile]:
    """Return the files of all sockets below a folder, sorted by path; none of what is no folder."""
    if not folder.is_dir():
        return []
    found = sorted(
        (path, int(match[1]))
        for path in folder.rglob("*")
        if path.suffix.lower() in _TEXTS and (match := _SOCKET.fullmatch(path.stem)) and path.is_file()
    )
    files = []
    for path, socket in found:
        below = path.parent != folder
        place = path.parent.relative_to(folder).as_posix() if below else folder.name
        files.append(SocketFile(path, socket, place, f"{place}/{path.stem}" if below else path.stem))
    return files


def read_socket(file: SocketFile, machine: str, stated: Mapping[str, Any]) -> MeasuredData:
    """Return the postures of one socket with its number and its place beside them. Raises `DataError`."""
    data = read_measured(file.path, machine, stated)
    n = len(data)
    own = {"socket": np.full(n, file.socket), "place": np.full(n, file.place)}
    return replace(data, columns={**data.columns, **own}, name=file.label)


def read_sockets(folder: Path, machine: str, stated: Mapping[str, Any]) -> MeasuredData:
    """Return the postures of all sockets of all places below a folder. Raises `DataError` for files that differ."""
    files = socket_files(folder)
    read = [read_socket(file, machine, stated) for file in files]
    check_alike(folder, {one.name: one for one in read})
    columns = {name: np.concatenate([one[name] for one in read]) for name in read[0].columns}
    notes = once((Note(Code.FILE, socket_note(files)), *(note for one in read for note in one.notes)))
    return replace(read[0], columns=columns, name=folder.name, notes=notes)


def check_alike(folder: Path, read: Mapping[str, MeasuredData]) -> None:
    """Raise `DataError` for a file with other columns than the first, or in other units."""
    first, *others = read
    for other in others:
        if set(read[other].columns) != set(read[first].columns) or read[other].units != read[first].units:
            raise DataError(f"{folder}: {other} has other columns or units than {first}; write them alike")


def socket_note(files: list[SocketFile]) -> str:
    """Return how many places and files there are, as a note tells it."""
    return f"{counted(len({file.place for file in files}), 'place')}, {counted(len(files), 'file')} of sockets"


def pairs_of(key: str, value: Any) -> dict[str, str]:
    """Return what `columns=` or `units=` states, name -> word: a mapping, or name:word with commas between.

    A shell, YAML and JSON leave it with and without quotation marks and braces.

    >>> pairs_of("columns", "enc_1:Winkel 1,enc_2:Winkel 2")
    {'enc_1': 'Winkel 1', 'enc_2': 'Winkel 2'}
    >>> pairs_of("units", "{Winkel 1:deg}")
    {'Winkel 1': 'deg'}

    Raises `DataError` for anything else.
    """
    example = '{"x": "Weg X"}' if key == "columns" else '{"x": "mm"}'
    said = value
    if isinstance(value, str):
        word = value.strip()
        value = read_word(word if word[:1] == "{" else f"{{{word}}}", dict[str, str])
    if not isinstance(value, Mapping) or not all(isinstance(w, str) and n and w for n, w in value.items()):
        raise DataError(f"{key}={said}: names with words are needed, such as {key}={example}")
    return {str(name): word for name, word in value.items()}


def renamed(found: Found, machine: str, columns: Mapping[str, str], units: Mapping[str, str]) -> Found:
    """Return what a file holds, under the names that `columns` give it, and in the units that `units` state.

    Raises `DataError` for a column there is not, one that is named twice, and a name that is taken already.
    """
    there = {source: target for target, source in ((t, _plain_name(s, found)) for t, s in columns.items())}
    described = description_of(machine)
    known = [column.name for column in described.columns]
    for target, source in columns.items():
        if _plain_name(source, found) not in found.columns:
            raise DataError(f"columns: {target} is to be {source!r}; {suggest(source, list(found.columns))}")
        of_a_part = described.named is not None and described.named(target) is not None  # such as q_ and a joint
        if known and target not in known and not of_a_part:
            raise DataError(f"columns: {target!r} is no column of {machine}; {suggest(target, known)}")
        if target in found.columns and target not in there:
            raise DataError(f"columns: {target} is in the file already, beside {source!r}; leave out one of them")
    if len(there) < len(columns):
        twice = next(source for source in columns.values() if list(columns.values()).count(source) > 1)
        raise DataError(f"columns: {twice!r} cannot be two columns at once; name each once")
    stated = {there.get(name, name): unit for name, unit in found.units.items()}
    notes = list(found.notes)
    for source, target in there.items():
        last = source.rpartition("_")[2]
        if target not in stated and target not in units and source != target and _tells_unit(source, last):
            stated[target] = last
            notes.append(Note(Code.UNIT, f"{target}: the name {source} states the unit {last}", (target,)))
    renamed_columns = {there.get(name, name): column for name, column in found.columns.items()}
    for name, unit in units.items():
        if there.get(name, name) not in renamed_columns:
            raise DataError(f"units: {name} is no column of the file; {suggest(name, list(renamed_columns))}")
        if {name, columns.get(name)} & found.of_day and unit.strip() != "s":
            raise DataError(
                f"units: {name} holds times of day, read in seconds; write an angle as one number of degrees"
            )
        stated[there.get(name, name)] = unit
    return replace(found, columns=renamed_columns, units=stated, notes=tuple(notes))


def of_part(
    found: Found, columns: Mapping[str, str], units: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return those of `columns` and `units`, stated for several files, that concern this one."""
    names = {target: source for target, source in columns.items() if _plain_name(source, found) in found.columns}
    there = {*found.columns, *names, *names.values()}
    return names, {name: unit for name, unit in units.items() if name in there}


def _plain_name(source: str, found: Found) -> str:
    """Return the name of a column whose head, with or without its unit, is `source`."""
    if source in found.columns:
        return source
    try:
        [name], units = heads([source])
    except ValueError:
        return source
    return name if units.get(name) == found.units.get(name, "\0") else source


def _tells_unit(source: str, last: str) -> bool:
    return source != last and len(last) > 1 and (is_unit(last) or last.casefold() == "grad")
