"""What `data=` names: a file, a glob, a folder, one of the sets that ship with a machine, or several of these."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path
from typing import Any, final

from calibench.bench.measured.files import endings_of, read_measured, read_sockets, socket_files
from calibench.core.options import suggest
from calibench.core.tables.data_file import LARGEST_PARQUET, read_whole
from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.registries import description_of

OF_A_CALIBRATION = "readings.parquet"  # of every calibration, in a folder of its own


@final
@dataclass(frozen=True)
class Source:
    """One set of data: its case name, its file or folder of sockets, and the machine that was asked for."""

    case: str
    path: Path | None
    machine: str
    printed: str = ""

    def read(self, stated: Mapping[str, Any], part: bool = False) -> MeasuredData:
        """Return the data, perhaps `part` of a table whose other files hold what is stated too; raise `DataError`."""
        if self.path is not None and socket_files(self.path):
            return read_sockets(self.path, self.machine, stated)
        if self.path is not None:
            return read_measured(self.path, self.machine, stated, part=part)
        for key in ("columns", "units"):
            if key in stated:
                raise DataError(f"{key}=: goes with a file; {self.printed} is printed in a paper and has its own names")
        data = description_of(self.machine).printed[self.printed]()
        return replace(data, metadata={**data.metadata, **stated}, stated=frozenset(stated))

    @property
    def data_id(self) -> str:
        """Return a digest of the file (or files) and the one beside it, "" if unreadable; the name of a printed set."""
        if self.path is None:
            return self.printed
        files = [file.path for file in socket_files(self.path)] or [self.path]
        digest = blake2b(digest_size=8)
        try:
            for file in files:
                beside = file.with_suffix(".json")
                for part in [file, beside] if file.suffix.lower() != ".parquet" and beside.exists() else [file]:
                    digest.update(read_whole(part, LARGEST_PARQUET))
                if len(files) > 1:  # of sockets: a posture says nothing without its place
                    digest.update(f"\0{file.relative_to(self.path)}\0{file.stat().st_size}\0".encode())
        except (OSError, ValueError):
            return ""
        return digest.hexdigest()


def sources(named: str, machine: str) -> list[Source]:
    """Return what ``data=named`` stands for, in the order of names; parts are parted by commas.

    Raises `DataError` where nothing has such a name.
    """
    found: dict[str, Source] = {}
    for word in [part for part in named.split(",") if part] if not _exists(Path(named)) else [named]:
        for source in _named(word, machine):
            key = source.printed or str(source.path)
            found.setdefault(key, source)
    if not found:
        raise DataError("data=: a file, a glob, a folder or a name is needed, such as data=run7.parquet")
    return _told_apart(list(found.values()))


def shipped(machine: str) -> list[str]:
    """Return the names that ``data=`` knows without a file: simulated demonstrations, and printed tables."""
    return [*_demonstrations(machine), *_printed(machine)]


def shipped_path(name: str, machine: str) -> Path:
    """Return the file of a simulated demonstration. Raises `DataError` for a name there is not."""
    found = _demonstrations(machine)
    if name not in found:
        raise DataError(f"{name}: {suggest(name, found)}")
    return found[name]


def _called(path: Path) -> str:
    """Return a file's name; of what a calibration writes, whose name is always the same, that of its folder."""
    return path.resolve().parent.name if path.name == OF_A_CALIBRATION else path.stem


def _named(word: str, machine: str) -> list[Source]:
    path = Path(word).expanduser()
    if path.is_dir():
        files = _data_files(path.iterdir(), machine)
        in_sockets = socket_files(path) if _reads_sockets(machine) else []
        if in_sockets and set(files) <= {file.path for file in in_sockets}:
            return [Source(_shown(path.resolve().name), path, machine)]
        if not files:
            raise DataError(f"data={word}: the folder holds no {' or '.join(endings_of(machine))} file")
        return [Source(_shown(p.stem), p, machine) for p in files]
    if _exists(path) or (path.suffix.lower() in endings_of(machine) and not glob.has_magic(word)):
        return [Source(_shown(_called(path)), path, machine)]
    if glob.has_magic(word):
        files = _data_files((Path(p) for p in glob.iglob(str(path), recursive=True)), machine)
        if not files:
            raise DataError(f"data={word}: matches no {' or '.join(endings_of(machine))} file")
        return [Source(_shown(_called(p)), p, machine) for p in files]
    if word in _printed(machine):
        return [Source(word, None, machine, printed=word)]
    if word in _demonstrations(machine):
        return [Source(word, _demonstrations(machine)[word], machine)]
    names = shipped(machine)
    ways = f"; the names of {machine}: {suggest(word, names)}" if names else ""
    raise DataError(f"data={word}: there is no such file, folder or name{ways}")


def _reads_sockets(machine: str) -> bool:
    return any(column.name == "socket" for column in description_of(machine).columns)


def _shown(name: str) -> str:
    """Return a name with an underscore for each character that a table or a terminal cannot show.

    A name of dots alone becomes underscores, because as a path it would lead to another folder.
    """
    return "".join(c if c.isprintable() else "_" for c in name) if name.strip(".") else "_" * len(name)


def _data_files(paths: Iterable[Path], machine: str) -> list[Path]:
    """Return those whose ending is that of data, sorted. A path that is no file stays, so that it is reported."""
    return sorted(p for p in paths if p.suffix.lower() in endings_of(machine))


def _exists(path: Path) -> bool:
    """Tell whether there is a file or folder; a list of files may be longer than the name of one."""
    try:
        return path.exists()
    except OSError:
        return False


def _printed(machine: str) -> tuple[str, ...]:
    """Return the names of the sets of measurements that a paper prints for `machine`."""
    return tuple(description_of(machine).printed)


def _demonstrations(machine: str) -> dict[str, Path]:
    folder = description_of(machine).demonstrations
    return {p.stem: p for p in sorted(folder.glob("*")) if p.suffix in endings_of(machine)} if folder else {}


def _told_apart(listed: list[Source]) -> list[Source]:
    """Return the sources with the folder's name before the stem where two files have the same stem."""
    count: dict[str, int] = {}
    for source in listed:
        count[source.case] = count.get(source.case, 0) + 1
    named, taken = [], set()
    for source in listed:
        case = source.case
        if count[case] > 1 and source.path is not None:
            case = f"{_shown(source.path.resolve().parent.name)}_{case}"
        while case in taken:
            case += "_"
        taken.add(case)
        named.append(Source(case, source.path, source.machine, source.printed))
    return named
