"""What a report was made from, kept beside it: what is still true is not made again.

``.report.json`` in the folder of a study holds the size and the time of change of each file there and of those that
the runs name, the code and libraries, what was printed, and a digest of what each figure was drawn from. Nothing here
loads pandas: the answer "nothing has changed" takes a fraction of a second.
"""

import json
import os
import pickle
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self, final

from calibench import bench
from calibench.bench.store.atomic_file import write_whole

RECORD = ".report.json"
ENDINGS = ("svg", "png", "csv")  # of the files of a figure
_LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow", "matplotlib", "jinja2")
_PARTS = ("bench", "calibration", "conf", "core", "discrepancy", "optimizers", "problems")
State = dict[str, list[int]]


@final
@dataclass(frozen=True, kw_only=True)
class Kept:
    """What is known of the last report: `files` as it left them, those `written`, its `text`, and the digest of what
    each of its `figures` was drawn from."""

    code: str = ""
    files: State = field(default_factory=dict)
    written: Sequence[str] = ()
    text: str = ""
    figures: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Return what is kept in `folder`; of other code what was `written` alone, of a damaged file nothing."""
        try:
            kept = cls(**json.loads((folder / RECORD).read_text(encoding="utf-8")))
            return kept if kept.code == code() else cls(written=tuple(kept.written))
        except (OSError, ValueError, TypeError):
            return cls()

    def is_current(self, folder: Path) -> bool:
        """Tell whether every file is as the report left it, and there is no other."""
        return bool(self.text) and self.files == state_of(folder, self.files)

    def has_figure(self, name: str, drawn_from: str, paths: Iterable[Path]) -> bool:
        """Tell whether the files of a figure are as the report left them, and were drawn from the same."""
        same = all(state_of_file(path) == self.files.get(f"figures/{path.name}", []) for path in paths)
        return bool(drawn_from) and self.figures.get(name) == drawn_from and same

    def write(self, folder: Path) -> None:
        write_whole(folder / RECORD, json.dumps(asdict(self)).encode())


def state_of(folder: Path, names: Iterable[str] = ()) -> State:
    """Return the state of all files in `folder`, by their relative path, and of those of `names` that are absolute."""
    found = {}
    for place, _, files in os.walk(folder):
        for file in sorted({*files} - {RECORD, ".lock"}):  # `code` is a digest
            path = Path(place) / file
            found[path.relative_to(folder).as_posix()] = state_of_file(path)
    return found | {name: state_of_file(Path(name)) for name in names if os.path.isabs(name)}


def state_of_file(path: Path) -> list[int]:
    """Return size and time of change [ns] of a file, nothing of one that is not there."""
    try:
        known = path.stat()
    except OSError:
        return []
    return [known.st_size, known.st_mtime_ns]


def files_named(options: Iterable[str]) -> list[str]:
    """Return the absolute paths of the files that options, as runs have them, name."""

    def texts(value: Any) -> Iterable[str]:
        if isinstance(value, str):
            yield value
        for inside in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            yield from texts(inside)

    every = {text for one in set(options) for text in texts(json.loads(one))}
    return sorted(os.path.abspath(text) for text in every if os.path.isfile(text))


@cache
def code() -> str:
    """Return a digest of the package's files, by size and time of change, and of the libraries' versions."""
    root = Path(bench.__file__).resolve().parent.parent
    states = {part: state_of(root / part) for part in _PARTS}
    own = {part: {n: s for n, s in state.items() if "__pycache__" not in n} for part, state in states.items()}
    return digest([own, sys.version, {name: version(name) for name in _LIBRARIES}])


def digest(value: Any) -> str:
    """Return a digest of a value by its pickle: equal digests are equal values; "" of what has none."""
    seen = blake2b(digest_size=16)
    try:
        hashed: Any = SimpleNamespace(write=seen.update)  # a file of which nothing is kept
        pickle.Pickler(hashed, protocol=5).dump(value)
    except (pickle.PicklingError, AttributeError, TypeError):  # a function within another one
        return ""
    return seen.hexdigest()
