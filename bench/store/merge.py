"""Several folders of results made one: shards of a sweep that ran apart, or studies that are to be read together.

A run that stands in two of them is taken once. Where its two rows differ in more than times and places, nothing is
merged before somebody says which is meant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pyarrow as pa

from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.store.arrays import is_in
from calibench.bench.store.collection import collect_into, nested
from calibench.bench.store.manifest import StoreError, in_other_shards, write_manifest
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.schema import RUNS_SCHEMA
from calibench.bench.store.tables import Tables
from calibench.core.words import counted

_CHUNK = 10_000  # runs at a time
_OF_THE_PLACE = ("study", "wall_s", "cpu_s")
_COMPARED = [column.name for column in COLUMNS if column.group != "origin" and column.name not in _OF_THE_PLACE]


@final
@dataclass(frozen=True)
class Merged:
    """The result: runs in the folder now, those that stood in several, those planned and not done.

    `in_other_shards` counts the runs of shards of the same sweep that are not among what was merged.
    """

    runs: int
    twice: int
    left: int
    in_other_shards: int = 0


def merge(sources: Sequence[Path], target: Path, keep_first: bool = False) -> Merged:
    """Make `target` the study of all runs in `sources` and of those it has already; the sources stay as they are.

    Of a run with two rows that differ, the first is taken where `keep_first` says so. Raises `StoreError` where a
    folder is none of ours, or such a run is found and it does not.
    """
    stores = [ResultStore(path) for path in sources]
    manifests = [store.manifest() for store in stores]
    into = ResultStore(target)
    if any(path.resolve() == target.resolve() for path in sources):
        raise StoreError(f"{target}: is merged into, and stands among what is to be merged; give another --to")
    twice = _in_several([*([into] if target.exists() else []), *stores], keep_first)
    into.open()
    into.collect()
    with into.locked():
        mine = into.manifest()
        tables = Tables(into.folder, str(mine["study"]))
        collect_into(tables, _new(stores, str(mine["study"]), tables.complete()), set(), lambda record: None)
        write_manifest(into.folder, _joined([mine, *manifests]))
        known = tables.complete()
    manifest = into.manifest()
    left = len(manifest["planned"].keys() - known)
    return Merged(len(known), twice, left, len(in_other_shards(manifest, known)))


def _new(stores: Sequence[ResultStore], study: str, known: set[str]) -> Iterator[pa.Table]:
    """Yield the runs of the stores that are not `known`, each once, as runs of `study`."""
    seen = set(known)
    for store in stores:
        rows, traces = store.tables()
        new = [run_id not in seen for run_id in rows["run_id"].to_pylist()]
        rows = rows.filter(pa.array(new, pa.bool_()))
        seen.update(rows["run_id"].to_pylist())
        at = RUNS_SCHEMA.get_field_index("study")
        for begin in range(0, len(rows), _CHUNK):
            some = rows.slice(begin, _CHUNK)
            some = some.set_column(at, RUNS_SCHEMA.field("study"), pa.array([study] * len(some), pa.string()))
            yield nested(some, traces.filter(is_in(traces["run_id"], some["run_id"].combine_chunks())))


def _in_several(stores: Sequence[ResultStore], keep_first: bool) -> int:
    """Return how many runs stand in several stores; raise where two rows of one differ and nobody says which counts."""
    where: dict[str, list[int]] = {}
    for i, store in enumerate(stores):
        for run_id in store.finished():
            where.setdefault(run_id, []).append(i)
    several = {run_id: found for run_id, found in where.items() if len(found) > 1}
    if not several or keep_first:
        return len(several)
    first: dict[str, dict[str, Any]] = {}
    unlike = {}
    for i in sorted({i for found in several.values() for i in found}):
        rows, _ = stores[i].tables()
        chosen = rows.filter(is_in(rows["run_id"], pa.array(list(several), pa.string()))).select(_COMPARED)
        for row in chosen.to_pylist():
            before = first.setdefault(row["run_id"], row)
            columns = [name for name, value in row.items() if not _same(value, before[name])]
            if columns:
                unlike[row["run_id"]] = columns
    if unlike:
        run_id, columns = next(iter(unlike.items()))
        raise StoreError(
            f"{counted(len(unlike), 'run')} stand in several folders with rows that differ, such as {run_id} in "
            f"{', '.join(columns[:4])}; leave a folder out, or take the first of each with --keep-first"
        )
    return len(several)


def _same(a: Any, b: Any) -> bool:
    return bool(a == b) or (a != a and b != b)  # NaN is NaN


def _joined(manifests: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return one manifest: the first's name, the plans, commands, files and costs of all."""
    joined = dict(manifests[0])
    for other in manifests[1:]:
        joined["planned"] = {**joined["planned"], **other["planned"]}
        for key in ("called", "budgets", "files"):
            joined[key] = {**joined.get(key, {}), **other.get(key, {})}
        for key in ("commands", "costs"):
            before = joined.get(key, [])
            joined[key] = [*before, *(item for item in other.get(key, []) if item not in before)]
    gone = {run_id for manifest in manifests for run_id in manifest.get("abandoned", ())} - joined["planned"].keys()
    if gone:
        joined["abandoned"] = sorted(gone)
    others = {run_id for manifest in manifests for run_id in manifest.get("other_shards", ())}
    if others:
        joined["other_shards"] = sorted(others - joined["planned"].keys())
    return joined
