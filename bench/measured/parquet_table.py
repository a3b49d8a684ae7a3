"""A Parquet file's table, after its footer was looked at: Arrow makes memory ready for what the footer says.

A file of a few kilobytes can state a billion rows, and unpack to gigabytes; with a hundred thousand columns Arrow does
not raise but aborts. The footer is small, and says it all beforehand.
"""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq

from calibench.core.tables.data_file import LARGEST_UNPACKED, LONGEST_FOOTER, MEGABYTE, MOST_NUMBERS, check_columns
from calibench.discrepancy import DataError

_END = 8  # bytes: the length of the footer, little endian, and PAR1
_MOST_OBJECTS = 1_000_000  # in one list of the footer
_SMALLER = "take part of the readings or of the columns"


def table_of(content: bytes) -> pa.Table:
    """Return the table. Raises `DataError` or `ValueError` for one beyond the bounds, and what Arrow raises."""
    footer = int.from_bytes(content[-_END:-4], "little")
    if content[-4:] == b"PAR1" and LONGEST_FOOTER < footer < len(content):
        raise DataError(
            f"has {footer / MEGABYTE:.0f} MB that tell of its columns, and at most {LONGEST_FOOTER // MEGABYTE} MB are "
            f"read; leave out columns, or write fewer row groups"
        )
    file = pq.ParquetFile(
        pa.BufferReader(content), thrift_string_size_limit=LONGEST_FOOTER, thrift_container_size_limit=_MOST_OBJECTS
    )
    about = file.metadata
    check_columns(about.num_columns)
    if about.num_rows * about.num_columns > MOST_NUMBERS:
        raise DataError(
            f"has {about.num_rows} rows of {about.num_columns} columns, and at most {MOST_NUMBERS} cells are read; "
            f"{_SMALLER}"
        )
    unpacked = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
    if unpacked > LARGEST_UNPACKED:
        raise DataError(
            f"unpacks to {unpacked / MEGABYTE:.0f} MB, and at most {LARGEST_UNPACKED // MEGABYTE} MB are read; "
            f"{_SMALLER}"
        )
    return file.read()
