"""The files of an arm's measurement as one table: several series, joints and tracker apart, or a folder of sockets.

Files with the same columns are one series after the other; files with other columns, and as many rows, are joined row
by row. A folder of folders with hole_0.csv, hole_1.csv ... (or socket_K) is one place of a tool with sockets each; a
place is named by its path below that folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibench.bench.measured import sources
from calibench.bench.measured.files import check_alike, pairs_of, read_socket, socket_files, socket_note
from calibench.calibration.readings import Table
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.options import suggest
from calibench.discrepancy import MeasuredData

MACHINE = "arm"


def read_table(named: str, stated: Mapping[str, Any]) -> Table:
    """Return the table of ``data=named``: a file, a glob, files parted by commas, or a folder. Raises `DataError`.

    Files of one stem are told apart by the names of their folders.
    """
    path = Path(named).expanduser()
    if named and path.is_dir():
        return _of_folder(path, stated)
    named_sources = sources(named, MACHINE)
    read = [replace(source.read(stated, part=len(named_sources) > 1), name=source.case) for source in named_sources]
    if len(read) == 1:
        return _of_one(read[0])
    _check_names(read, stated)
    first = set(read[0].columns)
    if all(set(one.columns) == first for one in read):
        return _one_after_the_other([_of_one(one) for one in read])
    return _row_by_row(read)


def _of_one(data: MeasuredData) -> Table:
    return Table.of(data.columns, data.name, units=data.units, stated=data.metadata, notes=data.notes)


def _one_after_the_other(tables: Sequence[Table]) -> Table:
    for one in tables[1:]:
        other = {name for name in one.units if one.units[name] != tables[0].units.get(name)}
        if other:
            raise DataError(f"{one.name}: column {min(other)} is in another unit than in {tables[0].name}")
    columns = {name: np.concatenate([one.columns[name] for one in tables]) for name in tables[0].columns}
    file, row = (np.concatenate([getattr(one, key) for one in tables]) for key in ("file", "row"))
    name = "_".join(one.name for one in tables) if len(tables) <= 3 else tables[0].name
    notes = once(note for one in tables for note in one.notes)
    return Table(
        columns=columns, units=tables[0].units, stated=tables[0].stated, file=file, row=row, name=name, notes=notes
    )


def _check_names(read: Sequence[MeasuredData], stated: Mapping[str, Any]) -> None:
    """Refuse a column in `columns=` and `units=` that none of the files has."""
    there = list(dict.fromkeys(name for one in read for name in one.columns))
    names = pairs_of("columns", stated.get("columns", {}))
    lost = [("columns", source) for target, source in names.items() if target not in there]
    known = {*there, *names.values()}
    lost += [("units", name) for name in pairs_of("units", stated.get("units", {})) if name not in known]
    for key, name in lost:
        raise DataError(f"{key}: {name} is no column of {', '.join(one.name for one in read)}; {suggest(name, there)}")


def _row_by_row(read: Sequence[MeasuredData]) -> Table:
    """Return files that are joined row by row, such as joints and tracker, as one table. Raises `DataError`."""
    lengths = {one.name: len(one) for one in read}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise DataError(
            f"files are joined row by row, and these have not as many rows ({counts}); leave out the rows that one of "
            "them lacks"
        )
    columns: dict[str, Any] = {}
    for one in read:
        twice = [name for name in one.columns if name in columns and not _alike(columns[name], one.columns[name])]
        if twice:
            raise DataError(f"{one.name}: column {twice[0]} is in another file too, with other numbers; rename one")
        columns |= one.columns
    joined = f"{', '.join(lengths)} are joined row by row"
    return Table.of(
        columns, read[0].name, units={name: unit for one in read for name, unit in one.units.items()},
        stated={key: value for one in read for key, value in one.metadata.items()},
        notes=once([*(note for one in read for note in one.notes), Note(Code.FILE, joined)]),
    )  # fmt: skip


def _alike(a: Any, b: Any) -> bool:
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f" and b.dtype.kind == "f"))


def _of_folder(folder: Path, stated: Mapping[str, Any]) -> Table:
    """Return the postures of all sockets of all places below a folder."""
    files = socket_files(folder)
    if not files:
        raise DataError(
            f"{folder}: holds no hole_0.csv, hole_1.csv or socket_0.csv in folders by place; name a file of readings"
        )
    read = {file.label: read_socket(file, MACHINE, stated) for file in files}
    check_alike(folder, read)
    whole = _one_after_the_other([_of_one(one) for one in read.values()])
    return replace(whole, name=folder.name, notes=(Note(Code.FILE, socket_note(files)), *whole.notes))
