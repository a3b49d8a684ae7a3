"""A sweep as it runs, followed by what lies in its folder, so that processes, shards and Dask are seen alike.

`Follower.look` is called again and again. It returns what has changed since: counts, pace, what runs now, and of each
cell the median of the best value over what was charged, which grows as runs end. Nothing in the folder is changed.
"""

import json
import os
import time
from pathlib import Path
from typing import Any, Literal, final

import numpy as np
import pyarrow as pa

from calibench.bench.execution.in_progress import Running, hosts_at_work, read_running
from calibench.bench.statistics.progress import SweepProgress, sweep_progress
from calibench.bench.store.arrays import index_in
from calibench.bench.store.columns import Array
from calibench.bench.store.journal import journals_in
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.schema import POINT
from calibench.core.words import plain, span

Status = Literal["running", "done", "killed", "stopped"]
_POINTS = 100  # of a curve
_AGAIN = 5.0  # seconds after which all is told again, changed or not: the pace falls while nothing ends
_DIGITS = 5
_CELLS_LEFT = 30  # that are listed
_CHARGED, _BEST = POINT.index("charged"), POINT.index("best_value")
_WORDS: dict[Status, str] = {
    "running": "running", "done": "all planned runs are done", "killed": "killed: who carried it is gone",
    "stopped": "stopped: nobody is at work on it here",
}  # fmt: skip
Cell = tuple[str, str]  # problem, optimizer
State = tuple[Any, ...]


@final
class Follower:
    """What one reader has been told of a sweep, and what is new to it."""

    def __init__(self, folder: Path) -> None:
        self.store = ResultStore(folder)
        self._seen: set[str] = set()
        self._state: State = ()
        self._tables: State = ()
        self._at = 0.0
        self._grid: Array = np.zeros(0)
        self._runs: dict[Cell, list[Array]] = {}
        self._growing: dict[str, Array] = {}

    def look(self) -> dict[str, Any] | None:
        """Return what to tell of the sweep, as plain values; None where nothing has changed. Raises `ValueError`."""
        state = state_of(self.store.folder)
        if state == self._state and time.monotonic() - self._at < _AGAIN:
            return None
        event: dict[str, Any] = {}
        grid = _grid(self.store.manifest())
        if not np.array_equal(grid, self._grid):  # at the first look, and where a larger budget has joined
            self._grid, self._seen, self._runs, self._growing, self._tables = grid, set(), {}, {}, ()
            event["at"] = grid.tolist()
        progress, running = sweep_progress(self.store), read_running(self.store.folder)
        changed = self._new_runs()
        self._state, self._at = state, time.monotonic()
        status = _status(self.store.folder, progress)
        way = f"; the same command goes on: {progress.command}" if progress.command else ""
        return event | {
            "status": status, "words": _WORDS[status] + (way if status in ("killed", "stopped") else ""),
            "planned": max(progress.planned, progress.done), "done": progress.done, "failed": progress.failed,
            "timeouts": progress.timeouts, "left": progress.to_do,
            "pace": f"{plain(progress.pace, 3)} runs/s" if progress.pace > 0 else "–",
            "eta": span(progress.eta_s) if progress.eta_s is not None and status == "running" else "–",
            "hosts": sorted(progress.hosts),
            "reasons": [[reason.count, reason.status, reason.text, reason.run_id] for reason in progress.reasons],
            "cells": sorted(([n, label] for label, n in progress.left.items()), reverse=True)[:_CELLS_LEFT],
            "curves": [self._curve(cell) for cell in sorted(changed)],
            "running": [self._running(run) for run in running],
        }  # fmt: skip

    def _new_runs(self) -> set[Cell]:
        """Take the curves of runs that ended since the last look; return their cells."""
        changed = set()
        for reader in journals_in(self.store.folder):
            for record in reader:
                if record.run_id not in self._seen:
                    row = dict(record.common) | dict(zip(record.names, json.loads(record.row), strict=True))
                    points = json.loads(record.trace)
                    changed.add(self._take(row, np.array(points[_CHARGED], float), np.array(points[_BEST], float)))
        tables = tuple(_stat(self.store.folder / name) for name in ("runs.parquet", "traces.parquet"))
        if tables != self._tables:
            self._tables = tables
            changed |= self._of_tables()
        return changed

    def _of_tables(self) -> set[Cell]:
        rows = self.store.rows(["run_id", "problem", "optimizer"]).to_pylist()
        new = [row for row in rows if row["run_id"] not in self._seen]
        if not new:
            return set()
        traces = self.store.traces()
        ids = pa.array([row["run_id"] for row in new], pa.string())
        found = index_in(pa.array(traces["run_id"], pa.string()), ids).to_numpy(zero_copy_only=False).astype(float)
        known = np.flatnonzero(~np.isnan(found))
        order = known[np.argsort(found[known], kind="stable")]
        ends = np.searchsorted(found[order], np.arange(len(new) + 1))
        charged, best = (traces[name].to_numpy(dtype=float)[order] for name in ("charged", "best_value"))
        return {self._take(row, charged[a:b], best[a:b]) for row, a, b in zip(new, ends, ends[1:], strict=False)}

    def _take(self, row: dict[str, Any], charged: Array, best: Array) -> Cell:
        cell = str(row["problem"]), str(row["optimizer"])
        self._seen.add(row["run_id"])
        self._growing.pop(row["run_id"], None)
        last = np.searchsorted(charged, self._grid, side="right") - 1
        values = np.where(last >= 0, best[np.maximum(last, 0)] if len(best) else np.nan, np.nan)
        self._runs.setdefault(cell, []).append(values)
        return cell

    def _curve(self, cell: Cell) -> dict[str, Any]:
        """Return the median over the runs of a cell; a run without a value is infinitely bad."""
        stack = np.array(self._runs[cell])
        middle = np.median(np.where(np.isnan(stack), np.inf, stack), axis=0)
        return {"problem": cell[0], "method": cell[1], "runs": len(stack), "y": _numbers(middle)}

    def _running(self, run: Running) -> dict[str, Any]:
        """Return a run in progress, with its best values at the looks so far."""
        curve = self._growing.setdefault(run.run_id, np.full(len(self._grid), np.nan))
        if run.best_value is not None and len(curve):
            here = max(0, int(np.searchsorted(self._grid, run.spent, side="right")) - 1)
            before = np.flatnonzero(~np.isnan(curve[:here]))
            last = int(before[-1]) if len(before) else here
            curve[last + 1 : here] = curve[last]  # as it was at the look before
            curve[here] = run.best_value
        return {
            "run_id": run.run_id, "problem": run.problem, "method": run.optimizer, "line": run.line(),
            "y": _numbers(curve),
        }  # fmt: skip


def state_of(folder: Path) -> State:
    """Return what changes as a sweep goes on: names, sizes and times of its files, and where somebody is at work."""
    paths = [folder / name for name in ("manifest.json", "runs.parquet", "traces.parquet")]
    for name in ("journal", "running"):
        paths += sorted((folder / name).glob("*"))
    return (*map(_stat, paths), *sorted(hosts_at_work(folder)))


def _stat(path: Path) -> tuple[str, int, int]:
    try:
        found = os.stat(path)
    except OSError:
        return path.name, -1, 0
    return path.name, found.st_size, found.st_mtime_ns


def is_running(folder: Path) -> bool:
    """Tell whether somebody is at work in a folder, as far as this machine can tell."""
    return (folder / "running").is_dir() and bool(hosts_at_work(folder))


def _status(folder: Path, progress: SweepProgress) -> Status:
    if progress.hosts and progress.to_do:
        return "running"
    if not progress.to_do:
        return "done"
    left = any((folder / "running").glob("*"))  # who ends by itself takes its own away
    return "killed" if left else "stopped"


def _grid(manifest: dict[str, Any]) -> Array:
    """Return the counts at which curves are told, evenly apart on a logarithmic axis up to the largest budget."""
    most = max([2, *(int(one) for one in (manifest.get("budgets") or {}).values())])
    counts: Array = np.unique(np.round(np.geomspace(1, most, _POINTS)))
    return counts


def _numbers(values: Array) -> list[float | None]:
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in values.tolist()]


def as_event(event: dict[str, Any]) -> bytes:
    """Return a server-sent event."""
    return f"data: {json.dumps(event, separators=(',', ':'), allow_nan=False)}\n\n".encode()
