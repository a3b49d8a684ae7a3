"""Measured data on disk: Parquet, CSV, Excel or MATLAB, their units, and what was stated about them.

A column's unit stands in its Parquet field or CSV header, the rest as JSON in the metadata, the first line or a file
beside it; the command line goes before. A Parquet footer is looked at first, as kilobytes can state a billion rows; so
are the shapes that a MATLAB file states. There a table is vectors of one length, fields of a struct among them, or a
matrix beside a list of its columns' names; files of version 7.3 are HDF5 and not read.
"""

from __future__ import annotations

import csv
import io
import json
import re
import warnings
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from calibench.bench.measured.by_time import ros_columns
from calibench.bench.store.arrays import numbers
from calibench.bench.store.atomic_file import write_whole
from calibench.core.notes import Code, DataError, Note
from calibench.core.options import read_word, shown
from calibench.core.tables import data_file
from calibench.core.tables.columns import (
    Columns,
    Declared,
    as_words,
    check_letters,
    columns_of,
    in_base_units,
    is_table,
    named_columns,
    rename,
)
from calibench.core.tables.csv_table import Table, heads, read_excel, read_table
from calibench.core.words import DEEPEST, counted, depth

if TYPE_CHECKING:
    import pandas as pd

    from calibench.discrepancy.model.machine import Machine
    from calibench.discrepancy.model.measured import MeasuredData

    Given = str | Path | Mapping[str, Any] | pd.DataFrame  # a file, or columns by name

KEY = "measured_data"
SCHEMA_VERSION = 1
WRITTEN = (".parquet", ".csv")
EXCEL, MATLAB = (".xlsx", ".xlsm"), (".mat",)
ENDINGS = (*WRITTEN, ".tsv", *EXCEL, *MATLAB)  # a folder's files that are data; any other that is named is read as text
_END = 8  # bytes: the length of the footer, little endian, and PAR1
_MOST_OBJECTS = 1_000_000  # in one list of the footer
_SMALLER = "take part of the readings or of the columns"
_SOCKET = re.compile(r"(?:hole|socket)[_ -]?(\d+)", re.IGNORECASE)


def declared_by(machine: str | Machine) -> Declared:
    """Return what a machine declares of its files, and of the sets that ship."""
    from calibench.discrepancy import machines as machines  # they declare where they are imported
    from calibench.discrepancy.registries import description_of

    name = machine if isinstance(machine, str) else getattr(machine, "name", None)
    if not isinstance(name, str):
        raise DataError(f"machine: {type(machine).__name__}: a machine, or the name of one, is needed")
    known = description_of(name)
    return Declared(
        machine=name, columns=known.columns, named=known.named, own_units=known.own_units, files=known.files,
        printed=tuple(known.printed), demonstrations=known.demonstrations,
    )  # fmt: skip


def read_measured(
    path: Given, machine: str | Machine = "", stated: Mapping[str, Any] | None = None,
    columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None,
) -> MeasuredData:  # fmt: skip
    """Return the data in `path`, or in columns by name. `machine`, a name or an object, must be what a file states.

    `stated` goes before its metadata. `columns` are name -> what the file calls it (``{"enc_1": "Winkel 1"}``), `units`
    name -> unit, for columns of which the file states none, or not in a known way. Raises `DataError`, in one line that
    begins with the path, for what cannot be read or is of another machine.
    """
    named = {key: value for key, value in (("columns", columns), ("units", units)) if value is not None}
    content = read_columns(path, declared_by(machine), {**(stated or {}), **named})
    return as_measured(content, Path(path).stem if isinstance(path, str | Path) else "data", stated or {})


def as_measured(content: Columns, name: str, stated: Mapping[str, Any]) -> MeasuredData:
    from calibench.discrepancy.model.measured import MeasuredData

    return MeasuredData(
        columns=content.columns, machine=content.metadata["machine"], metadata=content.metadata, name=name,
        notes=content.notes, units=content.units, stated=frozenset(stated) - {"columns", "units"},
    )  # fmt: skip


def is_bare(content: Columns) -> bool:
    """Tell whether the columns came without a header."""
    return list(content.columns) == [f"column_{k}" for k in range(1, len(content.columns) + 1)]


def read_columns(
    path: Given, declared: Declared, stated: Mapping[str, Any] | None = None, part: bool = False, before: int = 0
) -> Columns:
    """Return the columns in `path` in base units, by what their machine declares; none declared: the file states it.

    In place of a path columns may be given by name, with heads as in a file. `stated` goes before the file's metadata,
    and under ``columns`` and ``units`` names and units; of a file that is `part` of a table these may name what others
    hold; without a header its columns are counted on from those `before`. Raises `DataError` in one line that begins
    with the path.
    """
    where = Path(path) if isinstance(path, str | Path) else "data"
    try:
        raw = _read(where, declared) if isinstance(where, Path) else _named(path, declared)
        content = raw if isinstance(raw, Columns) else columns_of(raw, declared)
        known = raw.metadata if isinstance(raw, Columns) else _metadata(Path(where), raw.comment)
        metadata = {**known, **(stated or {})}
        of, machine = str(metadata.get("machine", declared.machine)), declared.machine
        if not of:
            raise DataError(f"states no machine; give machine=NAME, or a {KEY} with one")
        if machine and of.casefold() != machine.casefold():
            from calibench.discrepancy import machines

            ours = machines.names()  # no other word of a file is proposed
            way_out = f"write machine={of}" if of.casefold() in ours else f"{of!r} is none of {', '.join(ours)}"
            raise DataError(f"is data of machine {of}, and machine={machine} was asked for; {way_out}")
        if not machine:
            declared = declared_by(of)
            content = raw if isinstance(raw, Columns) else columns_of(raw, declared)
        if before and is_bare(content):
            counted = {f"column_{before + k}": one for k, one in enumerate(content.columns.values(), start=1)}
            content = replace(content, columns=counted)
        names, units = (pairs_of(key, metadata.pop(key, {})) for key in ("columns", "units"))
        content = in_base_units(rename(content, names, units, declared, part=part), declared)
        return replace(content, metadata={**metadata, "machine": machine or of})
    except FileNotFoundError:
        raise DataError(f"{where}: there is no such file") from None
    except (ValueError, pa.ArrowException, NotImplementedError) as error:
        raise DataError(f"{where}: {_one_line(error)}") from None
    except OSError as error:
        raise DataError(f"{where}: cannot be read: {error.strerror or _one_line(error)}") from None


def _named(given: Any, declared: Declared) -> Columns:
    """Return columns that are given by name, a mapping or a table of pandas; words among them as of a file."""
    if not is_table(given):
        raise DataError(f"is a {type(given).__name__}: a file, MeasuredData, a DataFrame or a mapping is needed")
    named = named_columns(given, declared=declared)
    columns = {
        name: _as_numpy(name, pa.chunked_array([pa.array(column, from_pandas=True)]))
        for name, column in named.columns.items()
    }
    return replace(named, columns=columns)


def write_measured(data: MeasuredData, path: str | Path) -> Path:
    """Write `data` to `path`, ``.parquet`` or ``.csv``, whole or not at all; reading it gives the same values back.

    Raises `DataError` for a path with another ending.
    """
    content = Columns(data.columns, data.metadata, units=data.units)
    return write_columns(content, declared_by(data.machine), path)


def write_columns(content: Columns, declared: Declared, path: str | Path) -> Path:
    """Write columns and what is stated of them, as `write_measured` does, for the machine that declared them."""
    path = Path(path)
    if path.suffix.lower() not in WRITTEN:
        raise DataError(f"{path}: the name must end in {' or '.join(WRITTEN)}")
    units = declared.units | {name: unit for name, unit in content.units.items() if unit != "1"}
    metadata = {"schema_version": SCHEMA_VERSION, **content.metadata, "machine": declared.machine}
    stated = json.dumps(metadata, default=lambda value: dict(value) if isinstance(value, Mapping) else value.tolist())
    if path.suffix.lower() == ".csv":
        lines = io.StringIO()
        lines.write(f"# {KEY}: {stated}\n")
        writer = csv.writer(lines, lineterminator="\n")
        writer.writerow([f"{name} [{units[name]}]" if name in units else name for name in content.columns])
        texts = (  # numbers so that they are read back to the last bit
            ["" if v != v else str(v).lower() if isinstance(v, bool) else str(v) for v in column.tolist()]
            for column in content.columns.values()
        )
        writer.writerows(zip(*texts, strict=True))
        return write_whole(path, lines.getvalue().encode())
    fields, arrays = [], []
    for name, column in content.columns.items():
        array = pa.array(column.tolist() if column.dtype.kind in "UO" else column)
        fields.append(pa.field(name, array.type, metadata={"unit": units[name]} if name in units else None))
        arrays.append(array)
    table = pa.table(arrays, schema=pa.schema(fields, metadata={KEY: stated}))
    return write_whole(path, lambda file: pq.write_table(table, file, compression="zstd"))


def _read(path: Path, declared: Declared) -> Columns | Table:
    """Return the content of a file, by its machine's formats or the reader for its ending, else as a table of text."""
    ending, content = path.suffix.lower(), None
    if ending in declared.files:
        content = declared.files[ending](data_file.text_of(data_file.read_whole(path, data_file.LARGEST_OWN)))
    elif ending not in ENDINGS and declared.files and path.stat().st_size <= data_file.LARGEST_OWN:
        text = data_file.text_of(data_file.read_whole(path, data_file.LARGEST_TEXT))
        for own, read in declared.files.items():
            with suppress(ValueError):
                content = read(text)
                note = Note(Code.FILE, f"read as a file that ends in {own}")
                content = replace(content, notes=(*content.notes, note))
                break
    if content is not None:
        return replace(content, metadata=_checked(dict(content.metadata)))
    if ending == ".json":  # what is stated beside a table, or a table as pandas writes it
        raise DataError("is JSON; a table is needed: CSV, Excel (.xlsx), MATLAB (.mat) or Parquet")
    if ending in EXCEL:
        table, notes = read_excel(path)
        return replace(table, notes=(*notes, *table.notes))
    if ending in MATLAB:
        return replace(read_matlab(path, declared.words), metadata=_metadata(path))
    if ending != ".parquet":
        if declared.machine == "arm" and path.is_file():
            of_ros = ros_columns(data_file.text_of(data_file.read_whole(path, data_file.LARGEST_TEXT)))
            if of_ros is not None:
                return replace(of_ros, metadata=_metadata(path))
        return read_table(path, bare=True)
    packed = data_file.read_whole(path, data_file.LARGEST_PARQUET, _SMALLER)
    try:
        arrow = _table_of(packed)
    except (pa.ArrowException, OSError, OverflowError) as error:
        raise DataError(f"is no Parquet file that can be read ({_one_line(error)})") from None
    columns, units = {}, {}
    for field, column in zip(arrow.schema, arrow.columns, strict=True):
        if field.name.startswith("__index_level_"):  # pandas' own
            continue
        columns[field.name] = _as_numpy(field.name, column)
        if (unit := (field.metadata or {}).get(b"unit")) is not None:
            units[field.name] = unit.decode("utf-8", "replace")
    stated = (arrow.schema.metadata or {}).get(KEY.encode(), b"").decode("utf-8", "replace")
    return Columns(columns, _checked(_json(stated, f"metadata {KEY}")) if stated else {}, units=units)


def _table_of(content: bytes) -> pa.Table:
    limits = {"thrift_string_size_limit": data_file.LONGEST_FOOTER, "thrift_container_size_limit": _MOST_OBJECTS}
    megabyte = data_file.MEGABYTE
    footer = int.from_bytes(content[-_END:-4], "little")
    if content[-4:] == b"PAR1" and data_file.LONGEST_FOOTER < footer < len(content):
        raise DataError(
            f"has {footer / megabyte:.0f} MB that tell of its columns, and at most "
            f"{data_file.LONGEST_FOOTER // megabyte} MB are read; leave out columns, or write fewer row groups"
        )
    file = pq.ParquetFile(pa.BufferReader(content), **limits)
    about = file.metadata
    data_file.check_columns(about.num_columns)
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    rows = sum(group.num_rows for group in groups)
    if rows * about.num_columns > data_file.MOST_NUMBERS:
        raise DataError(
            f"has {rows} rows of {about.num_columns} columns, and at most {data_file.MOST_NUMBERS} cells are read; "
            f"{_SMALLER}"
        )
    words = []
    for field in file.schema_arrow:
        if _is_text(field.type):
            words.append(field.name)
        if pa.types.is_nested(field.type) or pa.types.is_fixed_size_binary(field.type):
            raise DataError(f"column {field.name}: numbers, words or true and false are needed, it holds {field.type}")
    unpacked = sum(group.total_byte_size for group in groups)
    if unpacked > data_file.LARGEST_UNPACKED:
        raise DataError(
            f"unpacks to {unpacked / megabyte:.0f} MB, and at most {data_file.LARGEST_UNPACKED // megabyte} MB are "
            f"read; {_SMALLER}"
        )
    table = pq.ParquetFile(pa.BufferReader(content), read_dictionary=words, **limits).read()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_dictionary(column.type) and _is_text(column.type.value_type):
            widest = (pc.max(pc.binary_length(part.dictionary)).as_py() for part in column.chunks)
            check_letters(name, max((width or 0 for width in widest), default=0), len(column))
    return table


def _is_text(kind: pa.DataType) -> bool:
    text_kinds = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
    return any(is_it(kind) for is_it in (*text_kinds, pa.types.is_binary, pa.types.is_large_binary))


def _as_numpy(name: str, column: pa.ChunkedArray) -> Any:
    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if _is_text(kind):
        column = column.cast(pa.large_string())
        return as_words(name, [value or "" for value in column.to_pylist()])
    if pa.types.is_boolean(kind):
        return np.array([bool(value) for value in column.to_pylist()], dtype=bool)  # neither true nor false: not valid
    if pa.types.is_integer(kind) and not column.null_count:
        return numbers(column).astype(np.int64)
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return numbers(column.cast(pa.float64()), np.nan).astype(float)
    raise DataError(f"column {name}: numbers, words or true and false are needed, it holds {kind}")


def _metadata(path: Path, comment: str = "") -> dict[str, Any]:
    """Return the statements in the JSON file beside a table, and before them those in the comment above its header."""
    beside = path.with_suffix(".json")
    stated = {}
    if beside.exists():
        try:
            text = data_file.text_of(data_file.read_whole(beside, data_file.LARGEST_METADATA))
            content = _json(text, beside.name)
            stated = {} if isinstance(content, list) else _checked(content)  # a list is no statement, but other data
        except OSError as error:
            why = error.strerror or _one_line(error)
            raise DataError(f"{beside.name} beside it cannot be read: {why}") from None
        except DataError:
            raise
        except ValueError as error:
            raise DataError(f"{beside.name} beside it: {error}") from None
    lead, colon, said = comment.partition(":")
    return stated | _checked(_json(said, f"first line, {KEY}")) if colon and lead.strip("# ") == KEY else stated


def _checked(metadata: Any) -> dict[str, Any]:
    if not isinstance(metadata, dict):
        raise DataError(f'{KEY}: a JSON object is needed, such as {{"machine": "arm"}}')
    version = metadata.get("schema_version", SCHEMA_VERSION)
    if str(version) != str(SCHEMA_VERSION):
        raise DataError(f"{KEY}: schema_version is {shown(version)}, this version reads {SCHEMA_VERSION}")
    if not isinstance(metadata.get("machine", ""), str):
        raise DataError(f"{KEY}: machine is {shown(metadata['machine'])}; the name of one is needed")
    return metadata


def _json(text: str, where: str) -> Any:
    if len(text) > data_file.LARGEST_METADATA:
        raise DataError(f"{where}: has {len(text)} characters, and at most {data_file.LARGEST_METADATA} are read")
    if (deep := depth(text)) > DEEPEST:
        raise DataError(f"{where}: brackets stand {deep} deep in each other; at most {DEEPEST} are read")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise DataError(f"{where}: is no JSON ({error.msg}, character {error.pos})") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


class SocketFile(NamedTuple):
    """The postures of one socket: where the file lies, the socket's number and its place, and how it is called."""

    path: Path
    socket: int
    place: str
    label: str


def socket_files(folder: Path) -> list[SocketFile]:
    """Return the files of all sockets below a folder, sorted by path; none of what is no folder."""
    if not folder.is_dir():
        return []
    files = []
    for path in sorted(folder.rglob("*")):
        match = _SOCKET.fullmatch(path.stem)
        if match is None or path.suffix.lower() not in (".csv", ".txt", ".tsv") or not path.is_file():
            continue
        below = path.parent != folder
        place = path.parent.relative_to(folder).as_posix() if below else folder.name
        files.append(SocketFile(path, int(match[1]), place, f"{place}/{path.stem}" if below else path.stem))
    return files


def read_sockets(folder: Path, declared: Declared, stated: Mapping[str, Any]) -> tuple[dict[str, Columns], Note]:
    """Return the postures of each socket below a folder, label -> columns with `socket` and `place`, and a note."""
    files = socket_files(folder)
    by_label: dict[str, Columns] = {}
    for file in files:
        content = read_columns(file.path, declared, stated)
        n = len(next(iter(content.columns.values())))
        own = {"socket": np.full(n, file.socket), "place": np.full(n, file.place)}
        by_label[file.label] = replace(content, columns={**content.columns, **own})
    kinds = {label: (set(content.columns), content.units) for label, content in by_label.items()}
    first, *others = by_label
    for other in others:
        if kinds[other] != kinds[first]:
            raise DataError(f"{folder}: {other} has other columns or units than {first}; write them alike")
    places = counted(len({file.place for file in files}), "place")
    return by_label, Note(Code.FILE, f"{places}, {counted(len(files), 'file')} of sockets")


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
    pairs = value
    if isinstance(value, str):
        word = value.strip()
        pairs = read_word(word if word[:1] == "{" else f"{{{word}}}", dict[str, str])
    if not isinstance(pairs, Mapping) or not all(isinstance(w, str) and n and w for n, w in pairs.items()):
        raise DataError(f"{key}={value}: names with words are needed, such as {key}={example}")
    return {str(name): word for name, word in pairs.items()}


def read_matlab(path: Path, text: Collection[str] = ()) -> Columns:
    """Return the columns, of which `text` hold words, and the units that names in brackets state."""
    from scipy.io import loadmat, whosmat  # which no other file needs

    content = data_file.read_whole(path, data_file.LARGEST_TEXT, _SMALLER)
    if content[:64].startswith(b"MATLAB 7.3") or content[:8] == b"\x89HDF\r\n\x1a\n":
        raise DataError("is a MATLAB file of version 7.3, which is HDF5; save it with save('-v7', ...)")
    file: Any = io.BytesIO(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            stated = whosmat(file)
            _check_count(sum(int(np.prod(shape)) for _, shape, _ in stated))
            twice = next((name for name, times in Counter(name for name, *_ in stated).items() if times > 1), None)
            if twice is not None:
                raise DataError(f"column {twice} is there twice; give each a name of its own")
            file.seek(0)
            variables = loadmat(file, squeeze_me=True, struct_as_record=True, chars_as_strings=True)
    except DataError:
        raise
    except Exception as error:  # scipy raises what zlib, NumPy and its own checks raise
        raise DataError(
            f"is no MATLAB file that can be read ({type(error).__name__}: {error}); save it as CSV"
        ) from None
    fields: dict[str, Any] = {}  # of structs in the place of these
    for name, value in variables.items():
        array = np.asarray(value)
        if name.startswith("__"):  # SciPy's own
            continue
        if array.dtype.names and array.ndim == 0:
            fields |= {field: array[field].item() for field in array.dtype.names}
        elif array.dtype.names:
            fields |= {field: np.array([one[field] for one in array.ravel()]) for field in array.dtype.names}
        else:
            fields[name] = value
    _check_count(sum(map(np.size, fields.values())))
    columns, notes = _columns(fields)
    names, units = heads(list(columns))
    data_file.check_columns(len(names))
    plain: dict[str, Any] = {}
    for name, column in zip(names, columns.values(), strict=True):
        if name in text or column.dtype.kind in "UO":
            plain[name] = as_words(name, [str(one) for one in column.tolist()])
        else:
            plain[name] = column.astype({"b": bool, "i": np.int64, "u": np.int64}.get(column.dtype.kind, float))
    return Columns(plain, notes=notes, units=units)


def _check_count(count: int) -> None:
    if count > data_file.MOST_NUMBERS:
        raise DataError(f"has {count} numbers, and at most {data_file.MOST_NUMBERS} are read; {_SMALLER}")


def _columns(named: dict[str, Any]) -> tuple[dict[str, Any], tuple[Note, ...]]:
    arrays = {name: np.asarray(value) for name, value in named.items()}
    lists = {n: a for n, a in arrays.items() if a.ndim == 1 and len(a)}
    words = {n: a for n, a in lists.items() if all(isinstance(one, str) for one in a.tolist())}
    matrices = {n: a for n, a in arrays.items() if a.ndim == 2 and a.dtype.kind in "iufb"}
    for matrix in matrices.values():
        for names in words.values():
            if len(names) == matrix.shape[1]:
                return {str(n).strip(): matrix[:, k] for k, n in enumerate(names)}, ()
    vectors = {n: a for n, a in arrays.items() if a.ndim == 1 and (a.dtype.kind in "iufb" or n in words)}
    lengths = [len(a) for a in vectors.values() if a.dtype.kind in "iufb"]
    if len(matrices) == 1 and not lengths:
        [(name, matrix)] = matrices.items()
        last = matrix.shape[1]
        note = f"the columns of {name} have no names: they are called column_1 to column_{last}; columns= names them"
        return {f"column_{k + 1}": matrix[:, k] for k in range(matrix.shape[1])}, (Note(Code.FILE, note),)
    if not lengths and not matrices:
        there = ", ".join(f"{n} {a.shape}" for n, a in arrays.items()) or "nothing"
        raise DataError(f"holds {there}: vectors of one length, or a matrix and the names of its columns, are needed")

    # the vectors, and the columns of the matrices as NAME_1, NAME_2 ..., that have the usual number of rows
    rows = [*lengths, *map(len, matrices.values())]
    most = max(set(rows), key=lambda n: (rows.count(n), n))
    columns: dict[str, Any] = {}
    notes: list[Note] = []
    for name, array in arrays.items():
        if name in vectors and len(array) == most:
            columns[name] = array
        elif name in matrices and len(array) == most:
            columns |= {f"{name}_{k + 1}": array[:, k] for k in range(array.shape[1])}
            notes.append(Note(Code.FILE, f"the columns of {name} are called {name}_1 to {name}_{array.shape[1]}"))
    others = sorted(n for n in arrays if n not in {**vectors, **matrices} or len(arrays[n]) != most)
    if others:
        shapes = ", ".join(f"{n} ({' x '.join(map(str, arrays[n].shape)) or 'one value'})" for n in others)
        text = f"variables {shapes} have another shape and are not read: columns have {most} values"
        notes.append(Note(Code.COLUMNS_UNREAD, text, tuple(others)))
    return columns, tuple(notes)
