"""A ball in sockets: a folder of places, each with hole_0.csv, hole_1.csv ... (or socket_K), is one set of readings.

A place is named by its path below the folder. A row is a posture; which socket of which place it was taken in becomes
the columns `socket` and `place`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.bench.measured.files import read_measured
from calibench.core.counted import counted
from calibench.discrepancy import DataError, MeasuredData

_TEXTS = (".csv", ".txt", ".tsv")
_SOCKET = re.compile(r"(?:hole|socket)[_ -]?(\d+)", re.IGNORECASE)


@final
@dataclass(frozen=True)
class SocketFile:
    """The postures of one socket: where the file lies, the socket's number and its place, and how it is told."""

    path: Path
    socket: int
    place: str
    told: str


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
    return replace(data, columns={**data.columns, **own}, name=file.told)


def read_sockets(folder: Path, machine: str, stated: Mapping[str, Any]) -> MeasuredData:
    """Return the postures of all sockets of all places below a folder. Raises `DataError` for files that differ."""
    files = socket_files(folder)
    read = [read_socket(file, machine, stated) for file in files]
    check_alike(folder, {one.name: one for one in read})
    columns = {name: np.concatenate([one[name] for one in read]) for name in read[0].columns}
    notes = (socket_note(files), *dict.fromkeys(note for one in read for note in one.notes))
    return replace(read[0], columns=columns, name=folder.name, notes=notes)


def check_alike(folder: Path, read: Mapping[str, MeasuredData]) -> None:
    """Raise `DataError` for a file with other columns than the first, or in other units."""
    first, *others = read
    for told in others:
        if set(read[told].columns) != set(read[first].columns) or read[told].units != read[first].units:
            raise DataError(f"{folder}: {told} has other columns or units than {first}; write them alike")


def socket_note(files: list[SocketFile]) -> str:
    """Return how many places and files there are, as a note tells it."""
    return f"{counted(len({file.place for file in files}), 'place')}, {counted(len(files), 'file')} of sockets"
