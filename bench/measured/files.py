"""Measured data on disk: Parquet, CSV, Excel or MATLAB, their units, and what was stated about them.

Parquet: the unit of a column stands in its field's metadata under ``unit``; machine, noise and nominal values are JSON
in the file's metadata under ``measured_data``. CSV: the header names the unit (``enc_1 [rad]``), and the same JSON is
the first line (``# measured_data: {...}``) or a file beside it of the same stem (``run7.json`` for ``run7.csv``).
What the command line states goes before what the file does. Without a unit a column is in the documented one; a unit
that is not known is refused, for what it means is not ours to guess. `columns` and `units` name what the file does not.
A machine may declare formats of its field (`Description.files`); they are read where that machine is asked for.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from calibench.bench.measured.cells import as_words
from calibench.bench.measured.csv_columns import csv_lines, of_table, read_csv
from calibench.bench.measured.found import Found
from calibench.bench.measured.matlab_table import read_matlab
from calibench.bench.measured.parquet_table import is_text, table_of
from calibench.bench.measured.renamed import of_part, pairs_of, renamed
from calibench.bench.measured.units import factor, units_of
from calibench.bench.store.files.atomic_file import write_whole
from calibench.core.options import shown
from calibench.core.tables.data_file import (
    LARGEST_METADATA,
    LARGEST_OWN,
    LARGEST_PARQUET,
    LARGEST_TEXT,
    read_whole,
    text_of,
)
from calibench.core.tables.excel_table import read_excel
from calibench.core.tables.no_number import way_out
from calibench.core.words import DEEPEST, depth
from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.labels import columns_of_text
from calibench.discrepancy.model.description import Foreign
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
        told = frozenset(stated or {}) - {"columns", "units"}
        return MeasuredData(table, of, about, path.stem, (*found.notes, *notes), units=base, stated=told)
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
        return _foreign(replace(foreign, notes=(*foreign.notes, f"read as a file that ends in {own}")))
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
        return replace(found, notes=(*notes, *found.notes))
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
) -> tuple[dict[str, Any], tuple[str, ...], dict[str, str]]:
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
        f"{', '.join(names)}: stated in {unit.strip()}, turned into {base}" for (unit, base), names in turned.items()
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
