"""The files of an arm's measurement as one table: several series, joints and tracker apart, or a folder of sockets.

Files with the same columns are one series after the other; files with other columns, and as many rows, are joined row
by row. A folder of folders with hole_0.csv, hole_1.csv ... (or socket_K) is one place of a tool with sockets each; a
place is named by its path below that folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.bench.measured import sources
from calibench.bench.measured.files import check_alike, pairs_of, read_socket, socket_files, socket_note
from calibench.core.options import suggest
from calibench.discrepancy import DataError, MeasuredData

MACHINE = "arm"


@final
@dataclass(frozen=True, eq=False)
class Table:
    """Columns name -> (n,) in base units where `units` states one, and where they come from.

    `file` and `row` (n,) say which reading of which file a row is, for messages; `name` is the case.
    """

    columns: Mapping[str, Any]
    units: Mapping[str, str]
    stated: Mapping[str, Any]
    file: Any
    row: Any
    name: str
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.row)

    def told(self, i: int) -> str:
        """Return how a message names a row: its number, and its file where there are several."""
        several = len(set(self.file.tolist())) > 1
        return f"{self.file[i]} row {self.row[i]}" if several else f"row {self.row[i]}"


def read_table(named: str, stated: Mapping[str, Any]) -> Table:
    """Return the table of ``data=named``: a file, a glob, files parted by commas, or a folder. Raises `DataError`.

    Files of one stem are told apart by the names of their folders.
    """
    path = Path(named).expanduser()
    if named and path.is_dir():
        return _of_folder(path, stated)
    found = sources(named, MACHINE)
    read = [replace(source.read(stated, part=len(found) > 1), name=source.case) for source in found]
    if len(read) == 1:
        return _of_one(read[0], read[0].name)
    _check_names(read, stated)
    first = set(read[0].columns)
    if all(set(one.columns) == first for one in read):
        return _one_after_the_other([_of_one(one, one.name) for one in read])
    return _row_by_row(read)


def _of_one(data: MeasuredData, file: str) -> Table:
    n = len(data)
    return Table(
        data.columns, data.units, data.metadata, np.full(n, file), np.arange(1, n + 1), data.name,
        tuple(note.text for note in data.notes),
    )  # fmt: skip


def _one_after_the_other(tables: Sequence[Table]) -> Table:
    for one in tables[1:]:
        other = {name for name in one.units if one.units[name] != tables[0].units.get(name)}
        if other:
            raise DataError(f"{one.name}: column {min(other)} is in another unit than in {tables[0].name}")
    columns = {name: np.concatenate([one.columns[name] for one in tables]) for name in tables[0].columns}
    file, row = (np.concatenate([getattr(one, key) for one in tables]) for key in ("file", "row"))
    name = "_".join(one.name for one in tables) if len(tables) <= 3 else tables[0].name
    notes = tuple(dict.fromkeys(note for one in tables for note in one.notes))
    return Table(columns, tables[0].units, tables[0].stated, file, row, name, notes)


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
        said = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise DataError(
            f"files are joined row by row, and these have not as many rows ({said}); leave out the rows that one of "
            "them lacks"
        )
    columns: dict[str, Any] = {}
    for one in read:
        twice = [name for name in one.columns if name in columns and not _alike(columns[name], one.columns[name])]
        if twice:
            raise DataError(f"{one.name}: column {twice[0]} is in another file too, with other numbers; rename one")
        columns |= one.columns
    n = len(read[0])
    units = {name: unit for one in read for name, unit in one.units.items()}
    stated = {key: value for one in read for key, value in one.metadata.items()}
    notes = tuple(dict.fromkeys(note.text for one in read for note in one.notes))
    joined = f"{', '.join(lengths)} are joined row by row"
    first = read[0].name
    return Table(columns, units, stated, np.full(n, first), np.arange(1, n + 1), first, (*notes, joined))


def _alike(a: Any, b: Any) -> bool:
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f" and b.dtype.kind == "f"))


def _of_folder(folder: Path, stated: Mapping[str, Any]) -> Table:
    """Return the postures of all sockets of all places below a folder."""
    files = socket_files(folder)
    if not files:
        raise DataError(
            f"{folder}: holds no hole_0.csv, hole_1.csv or socket_0.csv in folders by place; name a file of readings"
        )
    read = {file.told: read_socket(file, MACHINE, stated) for file in files}
    check_alike(folder, read)
    whole = _one_after_the_other([_of_one(one, told) for told, one in read.items()])
    return replace(whole, name=folder.name, notes=(socket_note(files), *whole.notes))
