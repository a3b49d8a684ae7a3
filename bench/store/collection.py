"""Collecting: finished runs, from journals and the tables there are, into two new tables, in bounded memory.

The runs are sorted by what they are, so that the tables do not depend on who finished first. What does not fit in
memory at once is sorted in pieces that are kept beside the tables; then all pieces, and the tables there were, are read
side by side in their common order, some thousand runs at a time.
"""

import itertools
import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from secrets import token_hex
from typing import Any, final

import numpy as np
import pyarrow as pa
from pyarrow._compute import SortOptions

from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.store import arrays
from calibench.bench.store.atomic_file import temporary_name, write_whole
from calibench.bench.store.journal import JournalReader, Record
from calibench.bench.store.tables import ORDER, RUNS, TRACES, Tables, metadata, sealed_writer

_CHUNK = 4_000  # runs that are merged at a time
_READ = 2 << 20  # bytes of lines that are read from JSON at a time
_READERS = 4  # processes that do so at once, at most
_PIECE = 6 << 20  # bytes of a sorted piece
PIECE = "piece-"  # names of their files begin so
_BATCH = 500  # runs of a piece that are read from its file at a time


@final
@dataclass(frozen=True)
class Source:
    """Runs with their traces in the order of `keys`, columns `tables.ORDER`: `take` returns the next of both."""

    keys: pa.Table
    take: Callable[[int], tuple[pa.Table, pa.Table]]


def collect_into(tables: Tables, new: Iterable[pa.Table], drop: set[str]) -> None:
    """Replace the tables by what they hold, without the runs to `drop`, and the `new` runs; the traces appear first."""
    pieces = _pieces(new)
    some = list(itertools.islice(pieces, 1))
    if not some and not drop and tables.are_one_pair():
        return
    origin = metadata(token_hex(8))
    runs_schema, traces_schema = arrays.RUNS_SCHEMA.with_metadata(origin), arrays.TRACES_SCHEMA.with_metadata(origin)
    new_runs = temporary_name(tables.folder / RUNS)

    def write_both(traces_file: Any) -> None:
        keys = pa.concat_tables([source.keys for source in sources] or [_keys(arrays.empty_table(arrays.RUNS_SCHEMA))])
        order = _order(keys)
        whose = order
        if sources:
            whose = np.repeat(np.arange(len(sources)), [len(source.keys) for source in sources])[order]
        with (
            open(new_runs, "wb") as runs_file,
            sealed_writer(runs_file, runs_schema) as runs_out,
            sealed_writer(traces_file, traces_schema) as traces_out,
        ):
            for begin in range(0, len(order), _CHUNK):
                mine = whose[begin : begin + _CHUNK]  # the i-th row is the next of source mine[i]
                some = [sources[i].take(int(n)) for i, n in enumerate(np.bincount(mine)) if n]
                place = np.empty(len(mine), dtype=np.int64)
                place[np.argsort(mine, kind="stable")] = np.arange(len(mine))
                rows, traces = (pa.concat_tables(parts) for parts in zip(*some, strict=True))
                rows, traces = in_order(rows, traces, place)
                runs_out.write_table(arrays.cast_table(rows.combine_chunks(), runs_schema))
                traces_out.write_table(arrays.cast_table(traces, traces_schema))

    with ExitStack() as stack:
        sources: list[Source] = []
        for piece in itertools.chain(some, pieces):
            batches: Iterable[pa.RecordBatch] = piece.to_batches()
            if sources:  # all but the first are kept in a file
                path = temporary_name(tables.folder / f"{PIECE}{token_hex(4)}")
                stack.callback(path.unlink, missing_ok=True)
                with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, piece.schema) as writer:
                    writer.write_table(piece, max_chunksize=_BATCH)
                batches = pa.ipc.open_stream(stack.enter_context(pa.OSFile(str(path), "rb")))
            sources.append(_source(piece, batches))
        if (before := _stored(tables, drop)) is not None:
            sources.append(before)
        stack.callback(new_runs.unlink, missing_ok=True)
        write_whole(tables.folder / TRACES, write_both)
        with open(new_runs, "rb+") as written:
            os.fsync(written.fileno())
        os.replace(new_runs, tables.folder / RUNS)


def part_table(records: Sequence[Record]) -> tuple[pa.Table, list[Record]]:
    """Return records as a table of schema `PART_SCHEMA`, and those of which no row can be made."""
    fields = [arrays.TRACES_SCHEMA.field(name) for name in arrays.POINT]
    kind = arrays.PART_SCHEMA.field(arrays.TRACE).type
    tables = []
    try:  # column by column: records of one writer share the names and what is common
        for (names, common), some in itertools.groupby(records, lambda record: (record.names, record.common)):
            own = list(some)
            values = json.loads(b"[%b]" % b",".join(record.row for record in own))  # as one text: that takes less time
            columns = dict(zip(names, zip(*values, strict=True), strict=True))
            rows = [
                arrays.array_of(columns[field.name], field.type)
                if field.name in columns
                else pa.repeat(arrays.array_of([common.get(field.name)], field.type)[0], len(own))
                for field in arrays.RUNS_SCHEMA
            ]
            points: list[list[Any]] = [[] for _ in arrays.POINT]
            offsets = [0]
            for trace in json.loads(b"[%b]" % b",".join(record.trace for record in own)):
                for column, values in zip(points, trace, strict=True):
                    column += values
                offsets.append(len(points[0]))
            traces = pa.StructArray.from_arrays(
                [arrays.array_of(column, field.type) for column, field in zip(points, fields, strict=True)],
                fields=fields,
            )
            rows.append(pa.ListArray.from_arrays(arrays.array_of(offsets, pa.int32()), traces, type=kind))
            tables.append(pa.Table.from_arrays(rows, schema=arrays.PART_SCHEMA))
        return pa.concat_tables(tables), []
    except (ValueError, TypeError, OverflowError, pa.ArrowException):
        if len(records) < 2:
            return arrays.empty_table(arrays.PART_SCHEMA), [*records]
    half = len(records) // 2
    (first, lost), (second, more) = part_table(records[:half]), part_table(records[half:])
    return pa.concat_tables([first, second]), lost + more


def nested(rows: pa.Table, traces: pa.Table) -> pa.Table:
    """Return rows and their traces, which stand in the order of the rows, as one table of schema `PART_SCHEMA`."""
    place = arrays.numbers(arrays.index_in(traces["run_id"], rows["run_id"].combine_chunks()))
    counts = np.bincount(place.astype(np.int64), minlength=len(rows))
    fields = [arrays.TRACES_SCHEMA.field(name) for name in arrays.POINT]
    offsets = arrays.array_of(np.concatenate([[0], np.cumsum(counts)]).tolist(), pa.int32())
    points = pa.StructArray.from_arrays([traces[name].combine_chunks() for name in arrays.POINT], fields=fields)
    field = arrays.PART_SCHEMA.field(arrays.TRACE)
    return rows.append_column(field, pa.ListArray.from_arrays(offsets, points, type=field.type))


def points_of(parts: pa.Table) -> pa.Table:
    """Return the traces of a table of schema `PART_SCHEMA` as a table of points."""
    traces = parts[arrays.TRACE].combine_chunks()
    of_run = arrays.compute("take", parts["run_id"].combine_chunks(), arrays.compute("list_parent_indices", traces))
    points = arrays.compute("list_flatten", traces).flatten()
    return pa.Table.from_arrays([of_run, *points], schema=arrays.TRACES_SCHEMA)


def in_order(rows: pa.Table, traces: pa.Table, place: arrays.Counts | None = None) -> tuple[pa.Table, pa.Table]:
    """Return rows and traces sorted by what a run is, or by `place`, and the points of a run by evaluations."""
    rows = arrays.compute("take", rows, arrays.indices(_order(rows) if place is None else place))
    by_run = traces.append_column("_order", arrays.index_in(traces["run_id"], rows["run_id"].combine_chunks()))
    order = SortOptions(sort_keys=[("_order", "ascending"), ("evaluations", "ascending")])
    by_run = arrays.compute("take", by_run, arrays.compute("sort_indices", by_run, options=order))
    return rows, by_run.drop_columns(["_order"])


def in_journals(
    journals: Sequence[JournalReader], known: Collection[str], refuse: Callable[[Record], None], workers: int = 1
) -> Iterator[pa.Table]:
    """Yield the runs of journals that are not `known`, each once, as tables of schema `PART_SCHEMA`.

    A record that no row can be made of is given to `refuse` and left out. So many `workers` (processes) read at once.
    """
    spans = [(journal, span) for journal in journals for span in journal.parts(_READ)]
    size, seen = min(workers, _READERS, len(spans), os.cpu_count() or 1), set(known)

    def read(number: int) -> tuple[pa.Table, list[Record], int]:
        span = spans[number][1]
        table, refused = part_table(list(span))
        return table, refused, span.damaged

    with WorkerPool(read, size) if size > 1 and CAN_FORK else nullcontext() as pool:
        if pool is not None:
            pool.begin(range(len(spans)))
        for number, (journal, _) in enumerate(spans):
            table, refused, damaged = read(number) if pool is None else pool.take()
            journal.damaged += damaged
            for record in refused:
                if record.run_id not in seen:
                    refuse(record)
            first = []
            for run_id in table["run_id"].to_pylist():
                first.append(run_id not in seen)
                seen.add(run_id)
            yield table if all(first) else arrays.kept(table, arrays.mask_of(np.array(first, dtype=bool)))


def _pieces(new: Iterable[pa.Table]) -> Iterator[pa.Table]:
    """Yield the runs as sorted tables of bounded size."""
    held: list[pa.Table] = []
    for table in itertools.chain(new, [None]):  # None: the end
        held += [] if table is None else [table]
        if sum(map(len, held)) and (table is None or sum(each.nbytes for each in held) > _PIECE):
            whole = pa.concat_tables(held).combine_chunks()
            held = [arrays.compute("take", whole, arrays.indices(_order(whole)))]
            del whole
            yield held.pop()


def _source(table: pa.Table, batches: Iterable[pa.RecordBatch]) -> Source:
    """Return runs of schema `PART_SCHEMA` in order, whose rows are in `batches`, as a source."""
    rows = _Sequence(iter(batches), arrays.PART_SCHEMA)

    def take(count: int) -> tuple[pa.Table, pa.Table]:
        chosen = rows.take(count).combine_chunks()
        return chosen.select(arrays.RUNS_SCHEMA.names), points_of(chosen)

    return Source(_keys(table), take)


@final
class _Sequence:
    """A table that is read from front to end, some rows at a time."""

    def __init__(self, batches: Iterator[pa.RecordBatch], schema: pa.Schema) -> None:
        self._schema, self._batches = schema, batches
        self._held = arrays.empty_table(schema)

    def take(self, count: int) -> pa.Table:
        """Return the next `count` rows."""
        parts = [self._held]
        while sum(map(len, parts)) < count:
            parts.append(arrays.in_schema(pa.Table.from_batches([next(self._batches)]), self._schema))
        found = pa.concat_tables(parts)
        self._held = found.slice(count).combine_chunks() if len(found) > count else arrays.empty_table(self._schema)
        return found.slice(0, count)


def _stored(tables: Tables, drop: set[str]) -> Source | None:
    """Return the tables there are as a source, runs to `drop` read over; those not in our order are read whole."""
    runs_file, traces_file = tables.open(RUNS), tables.open(TRACES)
    if runs_file is None:
        return None
    keys = _keys(tables.runs(ORDER))
    complete = tables.complete() - drop
    keep = np.array([run_id in complete for run_id in keys["run_id"].to_pylist()], dtype=bool)
    ids = keys["run_id"].combine_chunks()

    # how many points of a trace each run has; None where the traces stand in another order
    counts: arrays.Counts | None = None
    if traces_file is not None:
        counts, last_at = np.zeros(len(ids), dtype=np.int64), -1
        for batch in traces_file.iter_batches(batch_size=1 << 18, columns=["run_id"], use_threads=False):
            place = arrays.index_in(batch["run_id"], ids)
            at_run = arrays.numbers(place).astype(np.int64)
            if place.null_count or (len(at_run) and (at_run[0] < last_at or (np.diff(at_run) < 0).any())):
                counts = None
                break
            counts += np.bincount(at_run, minlength=len(ids))
            last_at = int(at_run[-1]) if len(at_run) else last_at
    if counts is None or traces_file is None or not (np.diff(_order(keys)) == 1).all():
        rows, traces = arrays.kept(tables.runs(), arrays.mask_of(keep)), tables.traces()
        traces = arrays.kept(traces, arrays.is_in(traces["run_id"], rows["run_id"].combine_chunks()))
        parts = nested(*in_order(rows, traces))
        return _source(parts, parts.to_batches())

    ours, theirs = (
        _Sequence(file.iter_batches(batch_size=_CHUNK, use_threads=False), schema)
        for file, schema in ((runs_file, arrays.RUNS_SCHEMA), (traces_file, arrays.TRACES_SCHEMA))
    )
    points, at = counts, iter(np.flatnonzero(keep).tolist())
    begin = 0

    def take(count: int) -> tuple[pa.Table, pa.Table]:
        nonlocal begin
        *_, last = itertools.islice(at, count)
        span = slice(begin, last + 1)
        rows = arrays.kept(ours.take(last + 1 - begin), arrays.mask_of(keep[span]))
        traces = arrays.kept(theirs.take(int(points[span].sum())), arrays.mask_of(np.repeat(keep[span], points[span])))
        begin = last + 1
        return rows, traces

    return Source(arrays.kept(keys, arrays.mask_of(keep)), take)


def _keys(table: pa.Table) -> pa.Table:
    """Return the columns that order the rows, a text that comes often kept once."""
    columns = {name: table[name] for name in ORDER}
    often = [name for name in ORDER if name != "run_id" and pa.types.is_string(columns[name].type)]
    return pa.table(columns | {name: arrays.compute("dictionary_encode", columns[name]) for name in often})


def _order(rows: pa.Table) -> arrays.Counts:
    """Return the places of rows in the order of `ORDER`, shape (n,); texts are compared by their bytes."""
    keys = []
    for name in ORDER:
        column = rows[name]
        coded = arrays.compute("dictionary_encode", column) if pa.types.is_string(column.type) else column
        coded = coded.unify_dictionaries().combine_chunks()
        if pa.types.is_dictionary(coded.type):
            values = coded.dictionary
            rank = np.empty(len(values), dtype=np.int64)
            rank[arrays.numbers(arrays.compute("array_sort_indices", values))] = np.arange(len(values))
            keys.append(rank[arrays.numbers(coded.indices)])
        else:
            keys.append(arrays.numbers(coded))
    return np.lexsort(keys[::-1]) if len(rows) else np.empty(0, dtype=np.int64)
