"""What others publish, as a study of ours: rows of what is known of the runs, null for the rest.

An imported study is read, reported, compared and merged as any other. A function of another suite is our own problem
where we have it: COCO's `bbob` is our `bbob`, IOHexperimenter's suites are our `ioh`; ids of data are those they give.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench import problems
from calibench.bench.exchange.studies import gap_of_level, write_folder
from calibench.bench.execution.run_row import COLUMNS, SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical, options_as_asked
from calibench.bench.store.runs import ResultStore
from calibench.core.seeds import digest
from calibench.core.tables.data_file import LARGEST_TEXT, read_whole, text_of
from calibench.problems.suites.black_box import COCO_GAPS

BBOB = (
    "Sphere", "Ellipsoid", "Rastrigin", "BuecheRastrigin", "LinearSlope", "AttractiveSector", "StepEllipsoid",
    "Rosenbrock", "RosenbrockRotated", "EllipsoidRotated", "Discus", "BentCigar", "SharpRidge", "DifferentPowers",
    "RastriginRotated", "Weierstrass", "Schaffers10", "Schaffers1000", "GriewankRosenbrock", "Schwefel", "Gallagher101",
    "Gallagher21", "Katsuura", "LunacekBiRastrigin",
)  # fmt: skip


def text_of_file(of: str, path: Path) -> str:
    """Return the text of one file of a published folder. Raises `ValueError` for what is no such file."""
    try:
        return text_of(read_whole(path, LARGEST_TEXT))
    except (OSError, ValueError) as error:
        raise ValueError(f"import {of}: {path}: {error}") from None


@final
@dataclass(frozen=True, kw_only=True)
class PublishedRun:
    """A run as it was published: evaluations made, and its improvements, (evaluation, value above `minimum`) each, the
    values where it is None. `targets` are levels, None: COCO's 51 gaps; `best` is the last gap in all its digits."""

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
    columns: dict[str, Any]


def write_study(runs: Sequence[PublishedRun], format_name: str, source: Path, target: Path) -> Path:
    """Make the folder `target` a study of `runs`, read from `source`; return it."""
    repetitions: Counter[tuple[str, str, str, str]] = Counter()
    rows, traces = [], []
    read_at = datetime.now(UTC)
    for run in runs:
        key = (run.algorithm, str(run.columns.get("optimizer_options")), run.problem, run.problem_options)
        row, trace = _row(run, format_name, repetitions[key], read_at)
        repetitions[key] += 1
        rows.append(row)
        traces += trace
    table = pd.DataFrame(rows, columns=[column.name for column in COLUMNS]).astype(object)
    points = pd.DataFrame(traces, columns=["run_id", "evaluations", "charged", "best_value", "restart"])

    origin = {"format": format_name, "from": source.resolve().name, "runs": len(rows)}
    study = target.resolve().name
    write_folder(target, lambda folder: ResultStore(folder).fill(table, points, study=study, source=origin))
    return target


def _row(
    run: PublishedRun, format_name: str, repetition: int, read_at: datetime
) -> tuple[dict[str, Any], list[tuple[Any, ...]]]:
    minimum = 0.0 if run.minimum is None else run.minimum
    levels = [minimum + gap for gap in COCO_GAPS] if run.targets is None else sorted(run.targets, reverse=True)
    gaps = [level if run.minimum is None else gap_of_level(level, minimum) for level in levels]
    hits: list[int | None] = []  # the first evaluation at which each gap, largest first, was reached
    i = 0
    for gap in gaps:
        while i < len(run.improvements) and run.improvements[i][1] > gap:
            i += 1
        hits.append(run.improvements[i][0] if i < len(run.improvements) else None)
    number = digest("published", format_name, run.algorithm, run.columns, run.problem, run.problem_options, repetition)
    last = run.improvements[-1] if run.improvements else (0, inf)
    empty = not run.improvements  # as the data of a failed run are written
    known = {
        "run_id": number, "problem": run.problem, "problem_options": run.problem_options, "data_id": run.data_id,
        "dimension": run.dimension, "optimizer": run.algorithm, "library": run.algorithm, "library_version": "",
        "optimizer_options": canonical({"published": format_name}), "repetition": repetition,
        "evaluations": run.evaluations, "charged": run.evaluations, "status": "failed" if empty else "ok",
        "error_type": "NoFiniteValue" if empty else None,
        "error": "its data hold no finite value: it failed" if empty else None,
        "best_value": minimum + (last[1] if run.best is None else run.best), "best_evaluation": last[0],
        "best_x": run.best_x, "targets": levels, "hits": hits, "hits_charged": hits, "minimum": run.minimum,
        **provenance(), "started_at": read_at, "schema_version": SCHEMA_VERSION,
    } | run.columns  # fmt: skip
    points = [(1, inf)] if run.evaluations and (not last[0] or run.improvements[0][0] > 1) else []
    points += run.improvements
    if points and points[-1][0] < run.evaluations:
        points.append((run.evaluations, points[-1][1]))
    trace = [(number, n, n, minimum + gap, 0) for n, gap in points]
    return {column.name: known.get(column.name) for column in COLUMNS}, trace


@final
@dataclass(frozen=True)
class Named:
    """A problem as rows name it; `minimum` is that of our own problem, None where it cannot be made here."""

    problem: str
    problem_options: str
    data_id: str
    minimum: float | None


def named_problem(problem: str, options: dict[str, Any], data_id: str) -> Named:
    """Return a problem of a suite as rows name it, with the minimum of ours where it can be made here."""
    if problem not in problems.registry:
        return Named(problem, canonical(options), data_id, None)
    try:
        text = canonical(options_as_asked(problems.registry, problem, options))
    except ValueError:  # of that name here, and of other options: it is another problem
        return Named(problem, canonical(options), data_id, None)
    try:
        minimum = getattr(problems.make(problem, **options), "minimum", None)
    except ValueError:  # its package is not installed
        minimum = None
    return Named(problem, text, data_id, None if minimum is None else float(minimum))
