"""The study that is to be written elsewhere, and one that is made of what others publish.

Elsewhere an algorithm is a name: start, budget and target go into it. A course is each improvement that is known of a
run. A level has lost digits of its gap where the minimum is large; `gap_of_level` gives the one that was meant.

An imported study has rows of what is known of the runs, null for the rest, and is read, reported, compared and merged
as any other. A function of another suite is our own problem where we have it: COCO's `bbob` is our `bbob`,
IOHexperimenter's suites are our `ioh`; ids of data are those they give.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from math import inf, isfinite, log10, ulp as spacing
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench import problems
from calibench.bench.execution.run_row import COLUMNS, SCHEMA_VERSION
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical, options_as_asked
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.names import method_labels
from calibench.bench.store.atomic_file import temporary_name
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.core.seeds import digest
from calibench.core.tables.data_file import LARGEST_TEXT, read_whole, text_of
from calibench.problems.suites.black_box import COCO_GAPS

_COLUMNS = [
    "run_id", "dimension", "repetition", "start", "budget", "target", "evaluations", "charged", "restarts", "status",
    "best_value", "best_evaluation", "best_x", "targets", "hits_charged", "unit", "minimum", "judged_value",
    "judged_evaluations", "library", "library_version", "jacobian_evaluations",
]  # fmt: skip
_PER_DECADE = 5  # gaps of COCO's grid
_NOT_PLAIN = re.compile(r"[^A-Za-z0-9_.=+-]+")
_LONGEST = 120  # characters of a name; a file system takes 255 bytes, of which the formats add some


@final
@dataclass(frozen=True)
class Study:
    """The finished runs of a study as they are stored: `runs` and `traces` as `ResultStore` returns them."""

    store: ResultStore
    runs: pd.DataFrame
    traces: pd.DataFrame


@final
@dataclass(frozen=True)
class RunRecord:
    """A run as other formats have it: row, algorithm's name, problem's options, improvements (none of a failed run)."""

    row: Mapping[str, Any]
    algorithm: str
    options: Mapping[str, Any]
    course: list[Improvement]

    @property
    def minimum(self) -> float | None:
        """Return the least value that the problem declares; None where it declares none."""
        minimum = self.row["minimum"]
        return None if minimum is None or minimum != minimum else float(minimum)


def read_study(folder: str | Path) -> Study:
    """Return the study in `folder`. Raises `StoreError` where it is none of ours, or has no finished run."""
    store = ResultStore(folder)
    store.manifest()
    runs = store.runs()
    if runs.empty:
        raise StoreError(f"{folder}: no run is finished; there is nothing to write")
    return Study(store, runs, store.traces())


def run_records(study: Study) -> list[RunRecord]:
    """Return the runs of a study as other formats have them, in the order of its table."""
    traces = traces_by_run(study.traces)
    rows = records(study.runs[[*METHOD, *PROBLEM, *_COLUMNS]])
    options: dict[str, Mapping[str, Any]] = {text: json.loads(text) for text in study.runs["problem_options"].unique()}
    return [
        RunRecord(
            row, name, options[row["problem_options"]],
            course_of(row, traces.get(row["run_id"])) if row["status"] != "failed" else [],
        )
        for row, name in zip(rows, method_labels(study.runs), strict=True)
    ]  # fmt: skip


def records(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Return rows as mappings from the names of their columns."""
    return [{str(name): value for name, value in row.items()} for row in runs.to_dict("records")]


class Improvement(NamedTuple):
    """A better value, the charged evaluations at which it is known, and the lowest target reached just then."""

    charged: int
    value: float
    reached: float | None


def traces_by_run(traces: pd.DataFrame) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Return for each run the charged evaluations and best values of its trace, in their order."""
    ids = traces["run_id"].to_numpy()
    charged, values = traces["charged"].to_numpy(np.int64), traces["best_value"].to_numpy(float)
    begins = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]]) if len(ids) else np.empty(0, int)
    ends = np.r_[begins[1:], len(ids)]
    return {str(ids[b]): (charged[b:e], values[b:e]) for b, e in zip(begins, ends, strict=True)}


def course_of(run: Mapping[str, Any], trace: tuple[NDArray[np.int64], NDArray[np.float64]] | None) -> list[Improvement]:
    """Return the improvements of `run`, a row of ``runs.parquet``, ever later; noisy targets have no hits here."""
    known: dict[int, float] = {}
    for charged, value in zip(*(column.tolist() for column in trace), strict=True) if trace is not None else ():
        known[charged] = min(value, known.get(charged, inf))
    if run["best_evaluation"] and run["charged"] == run["evaluations"]:  # without Jacobians its cost is known too
        at = int(run["best_evaluation"])
        known[at] = min(float(run["best_value"]), known.get(at, inf))
    hits: dict[int, float] = {}  # the lowest target that was reached at each charged evaluation which reached one
    judged = run["judged_evaluations"]
    noisy = judged is not None and judged == judged
    for level, hit in () if noisy else zip(run["targets"], run["hits_charged"], strict=True):
        if hit is not None and hit == hit:
            hits[int(hit)] = min(float(level), hits.get(int(hit), inf))
    course: list[Improvement] = []
    best = inf
    for charged in sorted(known.keys() | hits.keys()):
        level = hits.get(charged)
        value = min(known.get(charged, inf), inf if level is None else level)
        if value < best and isfinite(value):
            course.append(Improvement(charged, value, level))
            best = value
    return course


def gap_of_level(level: float, minimum: float) -> float:
    """Return how far `level` stands above `minimum`: the gap of COCO's grid that gives this level, if there is one.

    >>> gap_of_level(394.48 + 1e-8, 394.48), 394.48 + 1e-8 - 394.48 == 1e-8
    (1e-08, False)
    """
    gap = level - minimum
    if gap > 0 and isfinite(gap):
        k = round(_PER_DECADE * log10(gap))
        for exponent in (k - 1, k, k + 1):  # below the rounding of the minimum several gaps give one level: the least
            meant: float = 10 ** (exponent / _PER_DECADE)
            if abs(minimum + meant - level) <= spacing(max(abs(minimum), abs(level))):  # who summed may round powers
                return meant
    return gap


def gap_of_value(value: float, minimum: float | None, reached: float | None) -> float:
    """Return how far `value` stands above `minimum`, if known; at most the gap of the level that it has `reached`."""
    if minimum is None:
        return value
    gap = value - minimum
    return gap if reached is None else min(gap, gap_of_level(reached, minimum))


def require_free(target: Path) -> None:
    """Raise `ValueError` where `target` is there already: a file, or a folder with something in it."""
    if target.is_dir() and not any(target.iterdir()):
        return
    if target.exists() or target.is_symlink():
        what = "is there and is not empty" if target.is_dir() else "is a file"
        raise ValueError(f"--to {target}: {what}; name a new folder")


def write_folder(target: Path, fill: Callable[[Path], object]) -> None:
    """Let `fill` write into a folder that is then called `target`; what goes wrong leaves nothing behind."""
    require_free(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(target.absolute())
    temporary.mkdir()
    try:
        fill(temporary)
        os.replace(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def file_name(text: str) -> str:
    """Return `text` as the name of a file or folder that any system and reader takes; a long one ends in a digest."""
    plain = _NOT_PLAIN.sub("_", text).strip("_.") or "unnamed"
    return plain if len(plain) <= _LONGEST else f"{plain[:_LONGEST]}-{digest(text)[:6]}"


def file_names(texts: list[str]) -> dict[str, str]:
    """Return such a name for each of `texts`: no two are the same, nor the same but for capitals."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    for text in texts:
        plain = name = file_name(text)
        count = 1
        while name.lower() in taken:
            count += 1
            name = f"{plain}_{count}"
        taken.add(name.lower())
        names[text] = name
    return names


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
        minimum = 0.0 if run.minimum is None else run.minimum
        levels = [minimum + gap for gap in COCO_GAPS] if run.targets is None else sorted(run.targets, reverse=True)
        gaps = [level if run.minimum is None else gap_of_level(level, minimum) for level in levels]
        hits: list[int | None] = []  # the first evaluation at which each gap, largest first, was reached
        i = 0
        for gap in gaps:
            while i < len(run.improvements) and run.improvements[i][1] > gap:
                i += 1
            hits.append(run.improvements[i][0] if i < len(run.improvements) else None)
        last = run.improvements[-1] if run.improvements else (0, inf)
        if "judged_value" in run.columns:  # the lowest value seen may be luck: the answer counts, where it was proposed
            hits = [last[0] if run.columns["judged_value"] <= level else None for level in levels]
        repetition = repetitions[key]
        repetitions[key] += 1
        number = digest(
            "published", format_name, run.algorithm, run.columns, run.problem, run.problem_options, repetition
        )
        empty = not run.improvements  # as the data of a failed run are written
        rows.append({
            "run_id": number, "problem": run.problem, "problem_options": run.problem_options, "data_id": run.data_id,
            "dimension": run.dimension, "optimizer": run.algorithm, "library": run.algorithm, "library_version": "",
            "optimizer_options": canonical({"published": format_name}), "repetition": repetition,
            "evaluations": run.evaluations, "charged": run.evaluations, "status": "failed" if empty else "ok",
            "error_type": "NoFiniteValue" if empty else None,
            "error": "its data hold no finite value: it failed" if empty else None,
            "best_value": minimum + (last[1] if run.best is None else run.best), "best_evaluation": last[0],
            "best_x": run.best_x, "targets": levels, "hits": hits, "hits_charged": hits, "minimum": run.minimum,
            **provenance(), "started_at": read_at, "schema_version": SCHEMA_VERSION,
        } | run.columns)  # fmt: skip
        points = [(1, inf)] if run.evaluations and (not last[0] or run.improvements[0][0] > 1) else []
        points += run.improvements
        if points and points[-1][0] < run.evaluations:
            points.append((run.evaluations, points[-1][1]))
        traces += [(number, n, n, minimum + gap, 0) for n, gap in points]
    names = [column.name for column in COLUMNS]
    table = pd.DataFrame([{name: row.get(name) for name in names} for row in rows], columns=names).astype(object)
    course = pd.DataFrame(traces, columns=["run_id", "evaluations", "charged", "best_value", "restart"])

    origin = {"format": format_name, "from": source.resolve().name, "runs": len(rows)}
    study = target.resolve().name
    write_folder(target, lambda folder: ResultStore(folder).fill(table, course, study=study, source=origin))
    return target


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
    text, minimum = canonical(options), None
    if problem in problems.registry:
        with suppress(ValueError):  # of that name here, and of other options; or its package is not installed
            text = canonical(options_as_asked(problems.registry, problem, options))
            minimum = getattr(problems.make(problem, **options), "minimum", None)
    return Named(problem, text, data_id, None if minimum is None else float(minimum))
