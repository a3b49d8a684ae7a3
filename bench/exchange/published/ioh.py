"""Published IOHprofiler folders, read: the JSON descriptions and the data files that they name.

``raw_y`` is the value above the minimum, as IOHexperimenter logs it. What this package wrote says itself which problem
it is, and whether its minimum is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import inf, isfinite
from pathlib import Path
from typing import Any

from calibench.bench.exchange.ioh import KEY
from calibench.bench.exchange.published.problem_names import Named, of_ioh
from calibench.bench.exchange.published.study import PublishedRun, text_of_file
from calibench.core.nested_text import json_of

_KEPT = ("start", "budget", "library", "library_version", "unit")  # of what a description of ours says


def read_ioh(folder: Path) -> list[PublishedRun]:
    """Return the runs in `folder` and the folders below it.

    Raises `ValueError` where there is no description of IOHprofiler, or one or its data cannot be read.
    """
    runs: list[PublishedRun] = []
    for path in sorted(folder.rglob("*.json")):
        text = text_of_file("ioh", path)
        try:
            description = json_of(text)
        except ValueError:
            raise ValueError(f"import ioh: {path}: is not JSON") from None
        if isinstance(description, dict) and {"scenarios", "function_id", "algorithm"} <= description.keys():
            try:
                runs += list(_runs(path, description))
            except (KeyError, TypeError, IndexError) as error:
                raise ValueError(
                    f"import ioh: {path}: is no whole description ({type(error).__name__}: {error})"
                ) from None
    if not runs and (older := next(folder.rglob("IOHprofiler_*.info"), None)):
        raise ValueError(f"import ioh: {older}: is of an earlier IOHprofiler, whose .info files are not read; JSON is")
    if not runs:
        raise ValueError(f"import ioh: {folder} has no IOHprofiler description (*.json with scenarios)")
    return runs


def _runs(path: Path, description: Mapping[str, Any]) -> Iterator[PublishedRun]:
    if description.get("maximization"):
        raise ValueError(f"import ioh: {path}: its values are to be made large; ours are to be made small")
    ours: Mapping[str, Any] = description.get(KEY, {})
    for scenario in description["scenarios"]:
        dimension = int(scenario["dimension"])
        curves = _curves(path.parent / scenario["path"])
        begun = [run for run in scenario["runs"] if run["evals"]]
        empty = [run for run in scenario["runs"] if not run["evals"]]  # nothing of them stands in the data
        if len(begun) != len(curves):
            listed = f"lists {len(begun)} runs in {scenario['path']}"
            raise ValueError(f"import ioh: {path}: {listed}, which has {len(curves)}")
        for run, points in zip([*begun, *empty], [*curves, *([] for _ in empty)], strict=True):
            instance = int(run["instance"])
            known: Mapping[str, Any] = ours.get("instances", {}).get(f"{dimension}.{instance}", {})
            named = _named(ours, known) or _published(description, dimension, instance)
            yield PublishedRun(
                algorithm=str(description["algorithm"]["name"]),
                problem=named.problem,
                problem_options=named.problem_options,
                data_id=named.data_id,
                dimension=dimension,
                minimum=named.minimum,
                evaluations=int(run["evals"]),
                improvements=points,
                targets=known.get("targets"),
                best=run["best"]["y"],
                best_x=[float(value) for value in run["best"].get("x") or []] or None,
                told=_told(ours, known),
            )


def _named(ours: Mapping[str, Any], known: Mapping[str, Any]) -> Named | None:
    """Return the problem as this package wrote it; None where it did not."""
    if "problem" not in ours or not known:
        return None
    return Named(ours["problem"], known["problem_options"], known["data_id"], known["minimum"])


def _published(description: Mapping[str, Any], dimension: int, instance: int) -> Named:
    """Return the problem of others' data: where its minimum is not known, values above it are data of their own."""
    function, name = int(description["function_id"]), str(description["function_name"])
    found = of_ioh(str(description["suite"]), function, name, dimension, instance)
    return replace(found, minimum=0.0, data_id=f"{found.data_id}_gap") if found.minimum is None else found


def _told(ours: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    said = {**ours, **known}
    return {key: said[key] for key in _KEPT if key in said}


def _curves(path: Path) -> list[list[tuple[int, float]]]:
    """Return the improvements of each run; a run begins where the evaluation is 1, or where a header stands."""
    if not path.is_file():
        raise ValueError(f"import ioh: {path}: is named in a description and is not there")
    curves: list[list[tuple[int, float]]] = []
    best, at, before = inf, 1, 0
    for number, line in enumerate(text_of_file("ioh", path).splitlines(), 1):
        columns = line.split()
        if not columns:
            continue
        if columns[0].strip('"').startswith("eval"):
            at, before = [name.strip('"') for name in columns].index("raw_y"), 0
            continue
        try:
            evaluation, value = int(float(columns[0])), float(columns[at])
        except (ValueError, IndexError):
            raise ValueError(f"import ioh: {path}, line {number}: is no line of IOHprofiler data") from None
        if evaluation == 1 or before == 0:
            curves.append([])
            best = inf
        before = evaluation
        if value < best and isfinite(value):
            curves[-1].append((evaluation, value))
            best = value
    return curves
