"""A study of ours made of published results: rows of what is known of them, null for the rest.

An imported study is read, reported, compared and merged as any other. Its manifest says what it is and where it comes
from, and `bench run` does not add to it: what was not measured here stays apart until somebody merges it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench.bench.exchange.folders import write_folder
from calibench.bench.exchange.targets import gap_of_level
from calibench.bench.execution.run_row import COLUMNS, SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical, digest
from calibench.bench.store.runs import ResultStore
from calibench.core.tables.data_file import LARGEST_TEXT, read_whole, text_of
from calibench.problems.suites.gaps import COCO_GAPS


def text_of_file(of: str, path: Path) -> str:
    """Return the text of one file of a published folder. Raises `ValueError` for what is no such file."""
    try:
        return text_of(read_whole(path, LARGEST_TEXT))
    except (OSError, ValueError) as error:
        raise ValueError(f"import {of}: {path}: {error}") from None


@final
@dataclass(frozen=True)
class PublishedRun:
    """A run as it was published: evaluations made, and its improvements, (evaluation, value above the minimum) each.

    `problem_options` is JSON; `minimum` is added to the gaps, None: they are the values themselves. `targets` are
    levels, None: COCO's 51 gaps. `best` is the last gap in all its digits where the improvements have fewer; `best_x`
    its place. `told` has further columns that are known.
    """

    algorithm: str
    problem: str
    problem_options: str
    data_id: str
    dimension: int
    minimum: float | None
    evaluations: int
    improvements: Sequence[tuple[int, float]]
    targets: Sequence[float] | None
    best: float | None
    best_x: list[float] | None
    told: dict[str, Any]


def write_study(runs: Sequence[PublishedRun], format_name: str, source: Path, target: Path) -> Path:
    """Make the folder `target` a study of `runs`, read from `source`; return it."""
    repetitions: Counter[tuple[str, str, str, str]] = Counter()
    rows, traces = [], []
    read_at = datetime.now(UTC)
    for run in runs:
        key = (run.algorithm, str(run.told.get("optimizer_options")), run.problem, run.problem_options)
        row, trace = _row(run, format_name, repetitions[key], read_at)
        repetitions[key] += 1
        rows.append(row)
        traces += trace
    table = pd.DataFrame(rows, columns=[column.name for column in COLUMNS]).astype(object)
    points = pd.DataFrame(traces, columns=["run_id", "evaluations", "charged", "best_value", "restart"])

    def fill(folder: Path) -> None:
        source_of = {"format": format_name, "from": source.resolve().name, "runs": len(rows)}
        ResultStore(folder).fill(table, points, study=target.resolve().name, source=source_of)

    write_folder(target, fill)
    return target


def _row(
    run: PublishedRun, format_name: str, repetition: int, read_at: datetime
) -> tuple[dict[str, Any], list[tuple[Any, ...]]]:
    minimum = 0.0 if run.minimum is None else run.minimum
    levels = [minimum + gap for gap in COCO_GAPS] if run.targets is None else sorted(run.targets, reverse=True)
    gaps = [level if run.minimum is None else gap_of_level(level, minimum) for level in levels]
    hits = _hits(run.improvements, gaps)
    options = canonical({"published": format_name})
    number = digest("published", format_name, run.algorithm, run.told, run.problem, run.problem_options, repetition)
    last = run.improvements[-1] if run.improvements else (0, inf)
    nothing = not run.improvements  # as the data of a failed run are written
    known = {
        "run_id": number,
        "problem": run.problem,
        "problem_options": run.problem_options,
        "data_id": run.data_id,
        "dimension": run.dimension,
        "optimizer": run.algorithm,
        "optimizer_options": options,
        "library": run.algorithm,
        "library_version": "",
        "repetition": repetition,
        "evaluations": run.evaluations,
        "charged": run.evaluations,
        "status": "failed" if nothing else "ok",
        "error_type": "NoFiniteValue" if nothing else None,
        "error": "its data hold no finite value: it failed" if nothing else None,
        "best_value": minimum + (last[1] if run.best is None else run.best),
        "best_evaluation": last[0],
        "best_x": run.best_x,
        "targets": levels,
        "hits": hits,
        "hits_charged": hits,
        "minimum": run.minimum,
        **provenance(),
        "started_at": read_at,
        "schema_version": SCHEMA_VERSION,
    } | run.told
    points = [(1, inf)] if run.evaluations and (not last[0] or run.improvements[0][0] > 1) else []
    points += run.improvements
    if points and points[-1][0] < run.evaluations:
        points.append((run.evaluations, points[-1][1]))
    trace = [(number, n, n, minimum + gap, 0) for n, gap in points]
    return {column.name: known.get(column.name) for column in COLUMNS}, trace


def _hits(improvements: Sequence[tuple[int, float]], gaps: Sequence[float]) -> list[int | None]:
    """Return the first evaluation at which each gap, largest first, was reached."""
    hits: list[int | None] = []
    i = 0
    for gap in gaps:
        while i < len(improvements) and improvements[i][1] > gap:
            i += 1
        hits.append(improvements[i][0] if i < len(improvements) else None)
    return hits
