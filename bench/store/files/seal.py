"""A sealed Parquet file: it ends with a digest of itself, so that an edit with whatever tool is noticed.

The digest is of all bytes before the footer, and stands in the footer. So a table and its digest get their name in one
rename: beside it, in a manifest say, a kill between the two would leave a table that nobody reads again. What rewrites
a table keeps the metadata of its schema, which says that it is sealed, and leaves the digest out, or keeps it beside
other bytes. It is a guard against accidents and careless edits, not against who forges it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import BinaryIO, final

import pyarrow as pa
import pyarrow.parquet as pq

SEALED = "sealed"  # of the statements in the metadata of a schema: true in those of a sealed file
_DIGEST = b"calibench_digest"
_TAIL = 8  # bytes after the footer: its length, and Parquet's mark
_READ = 1 << 20


@contextmanager
def sealed_writer(file: BinaryIO, schema: pa.Schema) -> Iterator[pq.ParquetWriter]:
    """Yield a writer of the Parquet file that `file` becomes; it is sealed as the context ends."""
    digested = _Digested(file)
    with pq.ParquetWriter(digested, schema, compression="zstd") as writer:
        yield writer
        writer.add_key_value_metadata({_DIGEST.decode(): digested.digest.hexdigest()})


def is_whole(path: Path) -> bool:
    """Tell whether a file that says it is sealed is as it was written. Raises `OSError` and Arrow's exceptions."""
    with open(path, "rb") as file:  # one file, though another gets its name meanwhile
        told = (pq.read_metadata(file).metadata or {}).get(_DIGEST)
        return told is not None and told == _digest_of(file).encode()


def _digest_of(file: BinaryIO) -> str:
    """Return the digest of a Parquet file's bytes before the footer."""
    end = file.seek(-_TAIL, 2)
    left = end - int.from_bytes(file.read(4), "little")
    digest = blake2b(digest_size=16)
    file.seek(0)
    while left > 0 and (some := file.read(min(left, _READ))):
        digest.update(some)
        left -= len(some)
    return digest.hexdigest()


@final
class _Digested:
    """A file that is written through, with the digest of what was written; who opened it closes it."""

    closed = False

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._written, self.digest = file, 0, blake2b(digest_size=16)

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        self._written += len(data)
        return self._file.write(data)

    def tell(self) -> int:
        return self._written

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        pass
