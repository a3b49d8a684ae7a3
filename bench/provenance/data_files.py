"""A digest of the files that a problem is given as options of type `Path`, so that a change is noticed.

A problem that has a `data_id` names its data itself, and its files are not read. A relative path is searched for in the
working folder, then beside the module of the class. Of a folder all files count, with their names, at any depth; hidden
ones and `__pycache__` do not.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from hashlib import blake2b, file_digest
from pathlib import Path, PurePath
from typing import Any

from calibench.bench.provenance.run_id import made_as, seen_options
from calibench.core import sources

_DEPTH = 12  # of objects in objects, as in `plain`
_MOST = 10_000  # files and folders in a folder: to look through them takes some 50 ms, with every run


def digest_of_files(problem: Any) -> str:
    """Return 12 digits for the content of the files that the options of `problem` name; '' where there are none."""
    if isinstance(problem, type) or getattr(problem, "data_id", None) is not None:
        return ""
    made = made_as(problem)
    options = seen_options(problem) if made is None else made.arguments
    home = sources.file_of(type(problem).__module__)
    found = [content for path in _paths(options) if (content := _content(path, home))]
    return blake2b("".join(found).encode(), digest_size=6).hexdigest() if found else ""


def _paths(value: Any, depth: int = 0) -> Iterator[PurePath]:
    if isinstance(value, PurePath):
        yield value
    elif depth < _DEPTH:
        if isinstance(value, Mapping):
            inner = [value[key] for key in sorted(value, key=str)]
        elif is_dataclass(value) and not isinstance(value, type):
            inner = [getattr(value, field.name, None) for field in fields(value)]
        else:
            inner = list(value) if isinstance(value, list | tuple) else []
        for each in inner:
            yield from _paths(each, depth + 1)


def _content(path: PurePath, home: Path | None) -> str:
    """Return the digest of the content of a file, or else of a folder; '' for what is missing or cannot be read."""
    places = (Path(path), *(() if home is None else (home.parent / path,)))
    for place in places:
        try:
            if place.is_file():
                told = place.stat()
                return _digest(place.absolute(), told.st_size, told.st_mtime_ns)
        except OSError:  # the problem itself will say so
            continue
    for place in places:
        try:
            if place.is_dir():
                return _digest_of_folder(place.absolute(), _files_of(place))
        except OSError:
            continue
    return ""


def _files_of(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Return name, size and time of all files in a folder, sorted; a folder that links lead to again counts once.

    Raises `ValueError` where there are too many of them to look through at every run.
    """
    found: list[tuple[str, int, int]] = []
    entries, seen, left = 0, {_place(folder.stat())}, [("", folder)]
    while left:
        above, inside = left.pop()
        for entry in sorted(os.scandir(inside), key=lambda entry: entry.name):
            if entry.name.startswith(".") or entry.name == "__pycache__":
                continue
            entries += 1
            if entries > _MOST:
                raise ValueError(
                    f"the folder {folder} holds more than {_MOST} files and folders, too many to notice a change in; "
                    "let an option name the folder of the data alone, or give the problem a data_id"
                )
            name = f"{above}{entry.name}"
            try:
                told = entry.stat()
            except OSError:  # a link to nothing
                continue
            if stat.S_ISREG(told.st_mode):
                found.append((name, told.st_size, told.st_mtime_ns))
            elif stat.S_ISDIR(told.st_mode) and (place := _place(told)) not in seen:
                seen.add(place)
                left.append((f"{name}/", inside / entry.name))
    return tuple(sorted(found))


def _place(told: os.stat_result) -> tuple[int, int]:
    return told.st_dev, told.st_ino


@lru_cache(maxsize=64)
def _digest_of_folder(folder: Path, files: tuple[tuple[str, int, int], ...]) -> str:
    told = blake2b(digest_size=12)
    for name, size, changed in files:
        try:
            content = _digest(folder / name, size, changed)
        except OSError:
            content = ""
        told.update(f"{name}\0{content}\0".encode("utf-8", "surrogateescape"))
    return told.hexdigest()


@lru_cache(maxsize=_MOST)
def _digest(file: Path, size: int, changed: int) -> str:
    with file.open("rb") as stream:
        return file_digest(stream, lambda: blake2b(digest_size=12)).hexdigest()
