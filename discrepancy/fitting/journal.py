"""The journal of a long search: its dear steps on disk, so that one that was killed goes on instead of beginning anew.

A search does the same steps in the same order whenever data, options and code are the same. So a step is known by its
place in that order, the k-th within the m-th, and by digits of what it is made of. What it gave is appended as plain
values (numbers, arrays, a formula), from which the search makes its objects again, to the last bit. A record is whole
or not there; steps that take less time than reading them are done again; a short search writes nothing.
"""

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from hashlib import blake2b
from pathlib import Path
from time import process_time
from typing import Any, TypeVar, final

import numpy as np

_DEAR = 0.02  # s of CPU of a step: a quicker one is done again
_LONG = 5.0  # s of CPU of a search: a shorter one writes nothing
_LENGTH, _DIGEST = 8, 16  # bytes before each record: how long it is, and its digest
_T = TypeVar("_T")


def _digest(*parts: bytes) -> bytes:
    return blake2b(b"\0".join(parts), digest_size=_DIGEST).digest()


@final
class Journal:
    """The steps of one search in a file at `path`; `replayed` counts those that were read instead of made."""

    def __init__(self, path: Path) -> None:
        self.path, self.replayed, self.began = path, 0, process_time()
        self.places = [0]  # of the present step among those of its own step, and so on
        self.waiting: list[bytes] = []
        self.known: dict[bytes, bytes] = {}
        left = memoryview(path.read_bytes() if path.is_file() else b"")
        while len(left) > _LENGTH + _DIGEST:
            length = int.from_bytes(left[:_LENGTH], "little")
            digest, record = (bytes(left[a:b]) for a, b in ((_LENGTH, _LENGTH + _DIGEST), (_LENGTH + _DIGEST, length)))
            if len(left) < length or digest != _digest(record):
                break  # cut off by the kill
            self.known[record[:_DIGEST]], left = record[_DIGEST:], left[length:]

    def write(self, key: bytes, value: object) -> None:
        record = key + pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        length = _LENGTH + _DIGEST + len(record)
        self.waiting.append(length.to_bytes(_LENGTH, "little") + _digest(record) + record)
        if process_time() - self.began > _LONG:
            with suppress(OSError):  # a full or read-only disk: the search cannot go on after a kill
                self.path.parent.mkdir(parents=True, exist_ok=True)
                with self.path.open("ab") as file:
                    file.write(b"".join(self.waiting))
            self.waiting.clear()


_JOURNAL: ContextVar[Journal | None] = ContextVar("journal", default=None)


@contextmanager
def keeping_steps(path: Path, anew: bool = False) -> Iterator[Journal]:
    """Inside the block, keep dear steps at `path`, and read those that are there, unless it is to begin `anew`.

    A block that ends leaves no file, and one that is interrupted does.
    """
    if anew:
        path.unlink(missing_ok=True)
    journal = Journal(path)
    before = _JOURNAL.set(journal)
    try:
        yield journal
    except Exception:  # it would come again
        path.unlink(missing_ok=True)
        raise
    finally:
        _JOURNAL.reset(before)
    path.unlink(missing_ok=True)


def kept_step(
    make: Callable[[], _T], of: tuple[object, ...], pack: Callable[[_T], Any] = lambda made: made,
    unpack: Callable[[Any], _T] = lambda kept: kept,
) -> _T:  # fmt: skip
    """Return what `make` returns, inside `keeping_steps` as it was kept before the search was killed.

    `of` are arrays and plain values that tell the step from another one. `pack` turns what was made into plain values,
    and `unpack` these into what was made.
    """
    journal = _JOURNAL.get()
    if journal is None:
        return make()
    journal.places[-1] += 1
    parts = (one.tobytes() if isinstance(one, np.ndarray) else repr(one).encode() for one in of)
    key = _digest(repr(journal.places).encode(), *parts)
    if (kept := journal.known.pop(key, None)) is not None:
        journal.replayed += 1
        return unpack(pickle.loads(kept))
    journal.places.append(0)
    began = process_time()
    try:
        made = make()
    finally:
        journal.places.pop()
    if process_time() - began > _DEAR:
        journal.write(key, pack(made))
    return made
