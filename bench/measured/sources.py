"""What `data=` names: a file, a glob, a folder, one of the sets that ship with a machine, or several of these."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from hashlib import blake2b
from itertools import accumulate, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench.bench.measured import files as readers
from calibench.bench.measured.by_time import GAP, by_time
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.options import suggest
from calibench.core.tables.columns import Columns, Declared
from calibench.core.tables.data_file import LARGEST_PARQUET, read_whole

if TYPE_CHECKING:
    from calibench.discrepancy.model.measured import MeasuredData

OF_A_CALIBRATION = "readings.parquet"  # of every calibration, in a folder of its own


@final
@dataclass(frozen=True)
class Source:
    """One set of data: its case name, its file or folder of sockets, and the machine that was asked for.

    Those `beside` hold other columns of the same rows. Columns without a header are counted on from those `before`.
    """

    case: str
    path: Path | None
    machine: str
    printed: str = ""
    beside: tuple[Source, ...] = ()
    before: int = 0

    def read(self, stated: Mapping[str, Any]) -> MeasuredData:
        """Return the data, what is `stated` before their own metadata; raise `DataError`."""
        if self.path is not None:
            sockets = bool(readers.socket_files(self.path))
            content = self.columns(readers.declared_by(self.machine), stated)
            return readers.as_measured(content, self.path.name if sockets else self.path.stem, stated)
        from calibench.discrepancy.registries import description_of

        for key in ("columns", "units"):
            if key in stated:
                raise DataError(f"{key}=: goes with a file; {self.printed} is printed in a paper and has its own names")
        data = description_of(self.machine).printed[self.printed]()
        return replace(data, metadata={**data.metadata, **stated}, stated=frozenset(stated))

    def columns(self, declared: Declared, stated: Mapping[str, Any], part: bool = False) -> Columns:
        """Return the columns of the file, perhaps `part` of a table whose other files hold what is stated too."""
        assert self.path is not None
        if self.beside:
            alone = replace(self, beside=())
            return joined({one.case: one.columns(declared, stated, part=True) for one in (alone, *self.beside)}, stated)
        if "gap" in stated and not part:
            raise DataError(f"gap= joins files by their times, and {self.path} is one; leave it out")
        if not readers.socket_files(self.path):
            return readers.read_columns(self.path, declared, stated, part, self.before)
        by_label, note = readers.read_sockets(self.path, declared, stated)
        contents = list(by_label.values())
        columns = {name: np.concatenate([one.columns[name] for one in contents]) for name in contents[0].columns}
        notes = once((note, *(note for one in contents for note in one.notes)))
        return replace(contents[0], columns=columns, notes=notes)

    @property
    def data_id(self) -> str:
        """Return a digest of the file (or files) and the one beside it, "" if unreadable; the name of a printed set."""
        if self.path is None:
            return self.printed
        if self.beside:
            return "".join(one.data_id for one in (replace(self, beside=()), *self.beside))
        files = [file.path for file in readers.socket_files(self.path)] or [self.path]
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


def sources(named: str, machine: str | Declared, key: str = "data") -> list[Source]:
    """Return what ``data=named``, or another `key`, stands for, in the order of names; parts are parted by commas.

    The folder's name stands before the stem where two files have the same. Raises `DataError` where nothing has such a
    name.
    """
    declared = machine if isinstance(machine, Declared) else readers.declared_by(machine)
    by_key: dict[str, Source] = {}
    for word in [part for part in named.split(",") if part] if not _exists(Path(named)) else [named]:
        for source in _sources_of(word, declared, key):
            by_key.setdefault(source.printed or str(source.path), source)
    if not by_key:
        raise DataError(f"{key}=: a file, a glob, a folder or a name is needed, such as {key}=run7.parquet")
    count = Counter(source.case for source in by_key.values())
    cases: dict[str, Source] = {}
    for source in by_key.values():
        case = source.case
        if count[case] > 1 and source.path is not None:
            case = f"{_as_case(source.path.resolve().parent.name)}_{case}"
        while case in cases:
            case += "_"
        cases[case] = replace(source, case=case)
    return list(cases.values())


def sets(named: str, machine: str | Declared, stated: Mapping[str, Any]) -> list[Source]:
    """Return what `sources` does, files of an arm as one set where they hold other columns of as many rows."""
    declared = machine if isinstance(machine, Declared) else readers.declared_by(machine)
    listed = sources(named, declared)
    if declared.machine != "arm" or not 1 < len(listed) <= _MOST_PARTS or any(one.path is None for one in listed):
        return listed
    contents = {one.case: one.columns(declared, stated, part=True) for one in listed}
    names = [set(one.columns) for one in contents.values()]
    bare = [readers.is_bare(one) for one in contents.values()]
    if not (bare[0] and len(names[0]) <= _PART) and all(one == names[0] for one in names):
        return listed
    before = accumulate(map(len, names), initial=0) if sum(bare) > 1 else repeat(0)
    parts = [replace(one, before=count) for one, count in zip(listed, before, strict=False)]
    try:
        joined({one.case: one.columns(declared, stated, part=True) for one in parts}, {})
    except DataError:  # sets of their own
        return listed
    return [replace(parts[0], beside=tuple(parts[1:]))]


_MOST_PARTS = 8  # files of one table
_PART = 7  # columns of a file without a header, which are joints or what was measured alone


def joined(contents: Mapping[str, Columns], stated: Mapping[str, Any]) -> Columns:
    """Return the columns of all files by time, or, by name, of as many rows."""
    if (in_time := by_time(contents, float(stated.get("gap", GAP)))) is not None:
        return in_time
    if "gap" in stated:
        raise DataError("gap= joins files by their times, and not each of these has times of its own; leave it out")
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    rows = {file: len(next(iter(one.columns.values()))) for file, one in contents.items()}
    if len(set(rows.values())) > 1:
        counts = ", ".join(f"{file} {n}" for file, n in rows.items())
        raise DataError(
            f"files are joined row by row, and these have not as many rows ({counts}); leave out the rows that one of "
            "them lacks"
        )
    for file, content in contents.items():
        for name, column in content.columns.items():
            if name in columns:
                floats = columns[name].dtype.kind == "f" and column.dtype.kind == "f"
                if not np.array_equal(columns[name], column, equal_nan=floats):
                    raise DataError(f"{file}: column {name} is in another file too, with other numbers; rename one")
            columns[name] = column
        units |= content.units

    # a column in columns= and units= that none of the files has
    names = readers.pairs_of("columns", stated.get("columns", {}))
    lost = [("columns", source) for target, source in names.items() if target not in columns]
    known = {*columns, *names.values()}
    lost += [("units", name) for name in readers.pairs_of("units", stated.get("units", {})) if name not in known]
    for key, name in lost:
        raise DataError(f"{key}: {name} is no column of {', '.join(contents)}; {suggest(name, list(columns))}")
    text = f"{', '.join(contents)} are joined row by row"
    notes = once([*(note for one in contents.values() for note in one.notes), Note(Code.FILE, text)])
    metadata = {key: value for one in contents.values() for key, value in one.metadata.items()}
    return Columns(columns, metadata, notes=notes, units=units)


def shipped_path(name: str, machine: str) -> Path:
    demonstrations = _demonstrations(readers.declared_by(machine))
    if name not in demonstrations:
        raise DataError(f"{name}: {suggest(name, demonstrations)}")
    return demonstrations[name]


def _sources_of(word: str, declared: Declared, key: str) -> list[Source]:
    machine, endings = declared.machine, (*readers.ENDINGS, *declared.files)
    path = Path(word).expanduser()

    def of_data(paths: Iterable[Path]) -> list[Path]:
        """Return those whose ending is that of data, sorted. A path that is no file stays, so that it is reported."""
        return sorted(p for p in paths if p.suffix.lower() in endings)

    def source(path: Path) -> Source:
        """Return a file's source; what a calibration writes, whose name is always the same, is called as its folder."""
        name = path.resolve().parent.name if path.name == OF_A_CALIBRATION else path.stem
        return Source(_as_case(name), path, machine)

    if path.is_dir():
        files = of_data(path.iterdir())
        sockets = readers.socket_files(path) if any(column.name == "socket" for column in declared.columns) else []
        if sockets and set(files) <= {file.path for file in sockets}:
            return [Source(_as_case(path.resolve().name), path, machine)]
        if not files:
            raise DataError(f"{key}={word}: the folder holds no {' or '.join(endings)} file")
        return [Source(_as_case(p.stem), p, machine) for p in files]
    if _exists(path) or (path.suffix.lower() in endings and not glob.has_magic(word)):
        return [source(path)]
    if glob.has_magic(word):
        files = of_data(Path(p) for p in glob.iglob(str(path), recursive=True))
        if not files:
            raise DataError(f"{key}={word}: matches no {' or '.join(endings)} file")
        return [source(p) for p in files]
    demonstrations = _demonstrations(declared)
    if word in declared.printed:
        return [Source(word, None, machine, printed=word)]
    if word in demonstrations:
        return [Source(word, demonstrations[word], machine)]
    names = [*demonstrations, *declared.printed]
    ways = f"; the names of {machine}: {suggest(word, names)}" if names else ""
    raise DataError(f"{key}={word}: there is no such file, folder or name{ways}")


def _as_case(name: str) -> str:
    """Return a name with _ for each character that cannot be shown, and for dots alone, which as a path lead away."""
    return "".join(c if c.isprintable() else "_" for c in name) if name.strip(".") else "_" * len(name)


def _exists(path: Path) -> bool:
    """Tell whether there is a file or folder; a list of files may be longer than the name of one."""
    try:
        return path.exists()
    except OSError:
        return False


def _demonstrations(declared: Declared) -> dict[str, Path]:
    folder, endings = declared.demonstrations, (*readers.ENDINGS, *declared.files)
    return {p.stem: p for p in sorted(folder.glob("*")) if p.suffix in endings} if folder else {}
