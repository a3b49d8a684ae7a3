"""Collecting: finished runs, from journals and the tables there are, into two new tables, in bounded memory.

The runs are sorted by what they are, so that the tables do not depend on who finished first. What does not fit in
memory at once is sorted in pieces that are kept beside the tables; then all pieces, and the tables there were, are read
side by side in their common order, some thousand runs at a time.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any, Protocol, final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from calibench.bench.store.arrays import (
    array_of,
    cast_table,
    dictionary_encode,
    empty_table,
    in_ascending_order,
    index_in,
    indices,
    is_in,
    kept,
    list_flatten,
    list_parent_indices,
    mask_of,
    numbers,
    scalar_of,
    sort_indices,
    take,
)
from calibench.bench.store.atomic_file import temporary_name, write_whole
from calibench.bench.store.journal import Record
from calibench.bench.store.schema import PART_SCHEMA, POINT, RUNS_SCHEMA, TRACE, TRACES_SCHEMA, in_schema
from calibench.bench.store.tables import ORDER, RUNS, TRACES, Tables, metadata, sealed_writer

Index = NDArray[np.int64]
_CHUNK = 4_000  # runs that are merged at a time
_READ = 4 << 20  # bytes of lines that are read from JSON at a time
_PIECE = 16 << 20  # bytes of a sorted piece
PIECE = "piece-"  # names of their files begin so
_BATCH = 500  # runs of a piece that are read from its file at a time


class Source(Protocol):
    """Runs with their traces in the order of `tables.ORDER`."""

    keys: pa.Table

    def take(self, count: int) -> tuple[pa.Table, pa.Table]:
        """Return the next `count` rows and the points of their traces."""
        ...


def collect_into(
    tables: Tables, new: Iterable[Record | pa.Table], drop: set[str], refuse: Callable[[Record], None]
) -> None:
    """Replace the tables by what they hold, without the runs to `drop`, and the `new` runs.

    A new run is a record of a journal, or a table of schema `PART_SCHEMA`. A record that no row can be made of is
    given to `refuse` and left out.
    """
    with ExitStack() as stack:
        sources: list[Source] = []
        for piece in _pieces(new, refuse):
            sources.append(_kept(piece, tables.folder, stack) if sources else _held(piece))
        if (before := _stored(tables, drop)) is not None:
            sources.append(before)
        _write(tables.folder, sources)


def part_table(records: Sequence[Record], refuse: Callable[[Record], None] = lambda record: None) -> pa.Table:
    """Return records as a table of schema `PART_SCHEMA`; those of which no row can be made go to `refuse`."""
    try:
        return _table_of(records)
    except (ValueError, TypeError, OverflowError, pa.ArrowException):
        if len(records) == 1:
            refuse(records[0])
            return empty_table(PART_SCHEMA)
    half = len(records) // 2
    return pa.concat_tables([part_table(some, refuse) for some in (records[:half], records[half:])])


def _table_of(records: Sequence[Record]) -> pa.Table:
    """Return the table of records, column by column; those of one writer share the names and what is common."""
    tables = []
    for (names, common), some in itertools.groupby(records, lambda record: (record.names, record.common)):
        own = list(some)
        columns = dict(zip(names, zip(*(record.values() for record in own), strict=True), strict=True))
        rows = [
            array_of(columns[field.name], field.type)
            if field.name in columns
            else pa.repeat(scalar_of(common.get(field.name), field.type), len(own))
            for field in RUNS_SCHEMA
        ]
        tables.append(pa.Table.from_arrays([*rows, _traces_of(own)], schema=PART_SCHEMA))
    return pa.concat_tables(tables)


def nested(rows: pa.Table, traces: pa.Table) -> pa.Table:
    """Return rows and their traces, which stand in the order of the rows, as one table of schema `PART_SCHEMA`."""
    place = numbers(index_in(traces["run_id"], rows["run_id"].combine_chunks()))
    counts = np.bincount(place.astype(np.int64), minlength=len(rows))
    fields = [TRACES_SCHEMA.field(name) for name in POINT]
    columns = [traces[name].combine_chunks() for name in POINT]
    offsets = array_of(np.concatenate([[0], np.cumsum(counts)]).tolist(), pa.int32())
    points = pa.StructArray.from_arrays(columns, fields=fields)
    kind = PART_SCHEMA.field(TRACE).type
    return rows.append_column(PART_SCHEMA.field(TRACE), pa.ListArray.from_arrays(offsets, points, type=kind))


def points_of(parts: pa.Table) -> pa.Table:
    """Return the traces of a table of schema `PART_SCHEMA` as a table of points."""
    traces = parts[TRACE].combine_chunks()
    of_run = take(parts["run_id"].combine_chunks(), list_parent_indices(traces))
    return pa.Table.from_arrays([of_run, *list_flatten(traces).flatten()], schema=TRACES_SCHEMA)


def in_order(rows: pa.Table, traces: pa.Table) -> tuple[pa.Table, pa.Table]:
    """Return rows and traces sorted by what a run is, and the points of a run by evaluations."""
    rows = take(rows, indices(_order(rows)))
    return rows, _sorted_traces(rows, traces)


def _sorted_traces(rows: pa.Table, traces: pa.Table) -> pa.Table:
    place = index_in(traces["run_id"], rows["run_id"].combine_chunks())
    by_run = traces.append_column("_order", place)
    return in_ascending_order(by_run, ("_order", "evaluations")).drop_columns(["_order"])


def _traces_of(records: Sequence[Record]) -> pa.Array:
    """Return the traces as lists of points, null in none."""
    columns: list[list[Any]] = [[] for _ in POINT]
    offsets = [0]
    for record in records:
        for column, values in zip(columns, record.trace(), strict=True):
            column += values
        offsets.append(len(columns[0]))
    fields = [TRACES_SCHEMA.field(name) for name in POINT]
    points = pa.StructArray.from_arrays(
        [array_of(column, field.type) for column, field in zip(columns, fields, strict=True)], fields=fields
    )
    return pa.ListArray.from_arrays(array_of(offsets, pa.int32()), points, type=PART_SCHEMA.field(TRACE).type)


def _pieces(new: Iterable[Record | pa.Table], refuse: Callable[[Record], None]) -> Iterator[pa.Table]:
    """Yield the runs as sorted tables of bounded size."""
    held: list[pa.Table] = []
    for table in _read(new, refuse):
        held.append(table)
        if sum(each.nbytes for each in held) > _PIECE:
            yield _sorted_piece(held)
            held = []
    if held:
        yield _sorted_piece(held)


def _read(new: Iterable[Record | pa.Table], refuse: Callable[[Record], None]) -> Iterator[pa.Table]:
    waiting: list[Record] = []
    size = 0
    for one in new:
        if isinstance(one, pa.Table):
            yield one
            continue
        waiting.append(one)
        size += one.size
        if size > _READ:
            yield part_table(waiting, refuse)
            waiting, size = [], 0
    if waiting:
        yield part_table(waiting, refuse)


def _sorted_piece(tables: list[pa.Table]) -> pa.Table:
    whole = pa.concat_tables(tables).combine_chunks()
    return take(whole, indices(_order(whole)))


@final
class _Sequence:
    """A table that is read from front to end, some rows at a time."""

    def __init__(self, batches: Iterator[pa.RecordBatch], schema: pa.Schema) -> None:
        self._schema, self._batches = schema, batches
        self._held = empty_table(schema)

    def take(self, count: int) -> pa.Table:
        """Return the next `count` rows."""
        parts = [self._held]
        while sum(map(len, parts)) < count:
            parts.append(in_schema(pa.Table.from_batches([next(self._batches)]), self._schema))
        found = pa.concat_tables(parts)
        self._held = found.slice(count).combine_chunks() if len(found) > count else empty_table(self._schema)
        return found.slice(0, count)


@final
@dataclass
class _Piece:
    """A sorted piece, in memory or in a file."""

    keys: pa.Table
    _rows: _Sequence

    def take(self, count: int) -> tuple[pa.Table, pa.Table]:
        chosen = self._rows.take(count).combine_chunks()
        return chosen.select(RUNS_SCHEMA.names), points_of(chosen)


def _keys(table: pa.Table) -> pa.Table:
    """Return the columns that order the rows, a text that comes often kept once."""
    return pa.table({name: _coded(table[name]) if name != "run_id" else table[name] for name in ORDER})


def _coded(column: pa.ChunkedArray) -> pa.ChunkedArray:
    return dictionary_encode(column) if pa.types.is_string(column.type) else column


def _held(table: pa.Table) -> _Piece:
    """Return a piece that stays in memory."""
    return _Piece(_keys(table), _Sequence(iter(table.to_batches()), PART_SCHEMA))


def _kept(table: pa.Table, folder: Path, stack: ExitStack) -> _Piece:
    """Return a piece that is stored in a file until `stack` ends."""
    path = temporary_name(folder / f"{PIECE}{token_hex(4)}")
    stack.callback(path.unlink, missing_ok=True)
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, table.schema) as writer:
        writer.write_table(table, max_chunksize=_BATCH)
    file = stack.enter_context(pa.OSFile(str(path), "rb"))
    return _Piece(_keys(table), _Sequence(iter(pa.ipc.open_stream(file)), PART_SCHEMA))


@final
class _Stored:
    """The tables there are, from front to end; runs that are dropped are read over."""

    def __init__(self, keys: pa.Table, keep: NDArray[np.bool_], points: Index, runs: _Sequence, traces: _Sequence):
        self.keys = kept(keys, mask_of(keep))
        self._keep, self._points, self._runs, self._traces = keep, points, runs, traces
        self._kept = np.flatnonzero(keep)
        self._next = self._taken = 0

    def take(self, count: int) -> tuple[pa.Table, pa.Table]:
        last = int(self._kept[self._taken + count - 1]) + 1
        span = slice(self._next, last)
        keep, points = self._keep[span], self._points[span]
        rows = kept(self._runs.take(last - self._next), mask_of(keep))
        traces = kept(self._traces.take(int(points.sum())), mask_of(np.repeat(keep, points)))
        self._next, self._taken = last, self._taken + count
        return rows, traces


def _stored(tables: Tables, drop: set[str]) -> Source | None:
    """Return the tables there are as a source; None where there are none.

    Tables that are not in our order, of which the traces are in another, or of which some traces are missing are read
    whole and sorted.
    """
    runs_file, traces_file = tables.open(RUNS), tables.open(TRACES)
    if runs_file is None:
        return None
    keys = _keys(tables.runs(ORDER))
    complete = tables.complete() - drop
    keep = np.array([run_id in complete for run_id in keys["run_id"].to_pylist()], dtype=bool)
    lengths = _points_of_each(traces_file, keys["run_id"].combine_chunks())
    if lengths is not None and traces_file is not None and (np.diff(_order(keys)) == 1).all():
        runs, traces = (file.iter_batches(batch_size=_CHUNK, use_threads=False) for file in (runs_file, traces_file))
        return _Stored(keys, keep, lengths, _Sequence(runs, RUNS_SCHEMA), _Sequence(traces, TRACES_SCHEMA))
    rows, points = kept(tables.runs(), mask_of(keep)), tables.traces()
    points = kept(points, is_in(points["run_id"], rows["run_id"].combine_chunks()))
    return _InMemory(*in_order(rows, points))


def _points_of_each(file: pq.ParquetFile | None, ids: pa.Array) -> Index | None:
    """Return how many points of a trace each run has, shape (runs,); None where the traces stand in another order."""
    counts = np.zeros(len(ids), dtype=np.int64)
    if file is None:
        return None
    last = -1
    for batch in file.iter_batches(batch_size=1 << 18, columns=["run_id"], use_threads=False):
        place = index_in(batch["run_id"], ids)
        if place.null_count:
            return None
        at = numbers(place).astype(np.int64)
        if len(at) and (at[0] < last or (np.diff(at) < 0).any()):
            return None
        counts += np.bincount(at, minlength=len(ids))
        last = int(at[-1]) if len(at) else last
    return counts


@final
class _InMemory:
    """Rows and traces in order, held whole."""

    def __init__(self, rows: pa.Table, traces: pa.Table) -> None:
        self.keys = _keys(rows)
        self._rows, self._traces = rows, traces
        self._next = 0

    def take(self, count: int) -> tuple[pa.Table, pa.Table]:
        rows = self._rows.slice(self._next, count)
        self._next += count
        return rows, kept(self._traces, is_in(self._traces["run_id"], rows["run_id"].combine_chunks()))


def _order(rows: pa.Table) -> Index:
    """Return the places of rows in the order of `ORDER`, shape (n,); texts are compared by their bytes."""
    keys = []
    for name in ORDER:
        coded = _coded(rows[name]).unify_dictionaries().combine_chunks()
        if pa.types.is_dictionary(coded.type):
            values = coded.dictionary
            rank = np.empty(len(values), dtype=np.int64)
            rank[numbers(sort_indices(values))] = np.arange(len(values))
            keys.append(rank[numbers(coded.indices)])
        else:
            keys.append(numbers(coded))
    return np.lexsort(keys[::-1]) if len(rows) else np.empty(0, dtype=np.int64)


def _write(folder: Path, sources: Sequence[Source]) -> None:
    """Write the two tables from sources; each appears whole, the traces first."""
    keys = pa.concat_tables([source.keys for source in sources] or [_keys(empty_table(RUNS_SCHEMA))])
    order = _order(keys)
    whose = np.repeat(np.arange(len(sources)), [len(source.keys) for source in sources])[order] if sources else order
    origin = metadata(token_hex(8))
    runs_schema, traces_schema = RUNS_SCHEMA.with_metadata(origin), TRACES_SCHEMA.with_metadata(origin)
    new_runs = temporary_name(folder / RUNS)

    def write_both(traces_file: Any) -> None:
        with (
            open(new_runs, "wb") as runs_file,
            sealed_writer(runs_file, runs_schema) as runs_out,
            sealed_writer(traces_file, traces_schema) as traces_out,
        ):
            for begin in range(0, len(order), _CHUNK):
                rows, traces = _merged(sources, whose[begin : begin + _CHUNK])
                runs_out.write_table(cast_table(rows, runs_schema))
                traces_out.write_table(cast_table(traces, traces_schema))

    try:
        write_whole(folder / TRACES, write_both)
        with open(new_runs, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(new_runs, folder / RUNS)
    finally:
        new_runs.unlink(missing_ok=True)


def _merged(sources: Sequence[Source], whose: Index) -> tuple[pa.Table, pa.Table]:
    """Return the next rows in their order: the i-th is the next of source ``whose[i]``; and their traces."""
    found = [(i, sources[i].take(int(n))) for i, n in enumerate(np.bincount(whose, minlength=len(sources))) if n]
    rows = pa.concat_tables([rows for _, (rows, _) in found])
    place = np.empty(len(whose), dtype=np.int64)
    place[np.argsort(whose, kind="stable")] = np.arange(len(whose))
    rows = take(rows, indices(place)).combine_chunks()
    traces = pa.concat_tables([traces for _, (_, traces) in found])
    return rows, _sorted_traces(rows, traces)
