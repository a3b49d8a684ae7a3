"""A digest of the files that a problem is given as options of type `Path`, so that a change is noticed.

A problem that has a `data_id` names its data itself, and its files are not read. A relative path is searched for in the
working folder, then beside the module of the class.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from hashlib import blake2b, file_digest
from pathlib import Path, PurePath
from typing import Any

from calibench.bench.provenance.run_id import made_as, seen_options
from calibench.core import sources

_DEPTH = 12  # of objects in objects, as in `plain`


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
    """Return the digest of a file's content; '' for a file that is missing or cannot be read."""
    for place in (Path(path), *(() if home is None else (home.parent / path,))):
        try:
            if place.is_file():
                told = place.stat()
                return _digest(place.absolute(), told.st_size, told.st_mtime_ns)
        except OSError:  # the problem itself will say so
            continue
    return ""


@lru_cache(maxsize=256)
def _digest(file: Path, size: int, changed: int) -> str:
    with file.open("rb") as stream:
        return file_digest(stream, lambda: blake2b(digest_size=12)).hexdigest()
