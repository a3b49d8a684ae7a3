"""A run, looked up by the first digits of its id."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench.bench.store.manifest import StoreError, studies_in
from calibench.bench.store.runs import ResultStore
from calibench.core.counted import listed

_TOLD = ("problem", "optimizer", "repetition", "status")  # of a candidate
_LISTED = 8  # candidates that are named


@final
@dataclass(frozen=True)
class Found:
    """A run where it was found: its row, its trace (evaluations, charged, best_value, restart), its study's folder."""

    row: dict[str, Any]
    trace: pd.DataFrame
    folder: Path


def find_run(parent: Path, prefix: str) -> Found:
    """Return the run whose id begins with `prefix`, from any study under `parent`.

    `parent` is the folder of the studies, or of one study. Raises `StoreError` where there is none, or more than one:
    then with the candidates.
    """
    if not parent.is_dir():
        raise StoreError(f"{parent}: there is no such results folder; name one with results=DIR")
    found: dict[str, tuple[dict[str, Any], Path]] = {}
    here = parent.resolve()
    for folder in studies_in(parent) or [one for one in studies_in(here.parent) if one == here]:
        runs = ResultStore(folder).runs()
        for row in runs[runs["run_id"].str.startswith(prefix)].to_dict("records"):
            found[str(row["run_id"])] = {str(name): value for name, value in row.items()}, folder
    if not found:
        raise StoreError(f"{prefix}: no run under {parent} has an id that begins so")
    if len(found) > 1:
        names = _candidates([row for row, _ in found.values()])
        raise StoreError(f"{prefix}: {len(found)} runs begin so: {names}; give more digits")
    [(run_id, (told, home))] = found.items()
    traces = ResultStore(home).traces()
    return Found(told, traces[traces["run_id"] == run_id].reset_index(drop=True), home)


def _candidates(rows: list[dict[str, Any]]) -> str:
    """Return the runs by as many digits as tell them apart, each with what it is."""
    rows = sorted(rows, key=lambda row: str(row["run_id"]))
    ids = [str(row["run_id"]) for row in rows]
    digits = next(n for n in range(1, len(ids[0]) + 1) if len({name[:n] for name in ids}) == len(ids))
    said = [f"{row['run_id'][:digits]} ({', '.join(str(row[name]) for name in _TOLD)})" for row in rows]
    return listed(said, _LISTED)
