"""A Parquet file's table, after its footer was looked at: Arrow makes memory ready for what the footer says.

A file of a few kilobytes can state a billion rows, and unpack to gigabytes; with a hundred thousand columns Arrow does
not raise but aborts. The footer is small, and says it beforehand, but for lists, which are no columns here, and for one
long word that stands in many rows: words are read as numbers into a list of words, and looked at as such.
"""

from __future__ import annotations

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from calibench.bench.measured.cells import check_letters
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
    file = _opened(content, [])
    about = file.metadata
    check_columns(about.num_columns)
    groups = [about.row_group(i) for i in range(about.num_row_groups)]
    rows = sum(group.num_rows for group in groups)
    if rows * about.num_columns > MOST_NUMBERS:
        raise DataError(
            f"has {rows} rows of {about.num_columns} columns, and at most {MOST_NUMBERS} cells are read; {_SMALLER}"
        )
    words = []
    for field in file.schema_arrow:
        if is_text(field.type):
            words.append(field.name)
        if pa.types.is_nested(field.type) or pa.types.is_fixed_size_binary(field.type):
            raise DataError(f"column {field.name}: numbers, words or true and false are needed, it holds {field.type}")
    unpacked = sum(group.total_byte_size for group in groups)
    if unpacked > LARGEST_UNPACKED:
        raise DataError(
            f"unpacks to {unpacked / MEGABYTE:.0f} MB, and at most {LARGEST_UNPACKED // MEGABYTE} MB are read; "
            f"{_SMALLER}"
        )
    table = _opened(content, words).read()
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_dictionary(column.type) and is_text(column.type.value_type):
            widest = (pc.max(pc.binary_length(part.dictionary)).as_py() for part in column.chunks)
            check_letters(name, max((width or 0 for width in widest), default=0), len(column))
    return table


def is_text(kind: pa.DataType) -> bool:
    """Tell whether a column of this type holds words."""
    told = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
    return any(is_it(kind) for is_it in (*told, pa.types.is_binary, pa.types.is_large_binary))


def _opened(content: bytes, words: list[str]) -> pq.ParquetFile:
    return pq.ParquetFile(
        pa.BufferReader(content), thrift_string_size_limit=LONGEST_FOOTER, thrift_container_size_limit=_MOST_OBJECTS,
        read_dictionary=words,
    )  # fmt: skip
