"""Published IOHprofiler folders, read: the JSON descriptions and the data files that they name.

``raw_y`` is a value above the minimum where the suite is BBOB, as IOHexperimenter logs it. What this package wrote says
so itself, and which problem of ours it is.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Any

from calibench.bench.exchange.ioh import KEY
from calibench.bench.exchange.problem_names import our_options
from calibench.bench.exchange.published import PublishedRun

_KEPT = ("start", "budget", "library", "library_version", "data_id", "unit")  # of what a description of ours says
_NAMES = {"bbob": "bbob", "unknown_suite": "ioh"}


def read_ioh(folder: Path) -> list[PublishedRun]:
    """Return the runs in `folder` and the folders below it.

    Raises `ValueError` where there is no description of IOHprofiler, or one or its data cannot be read.
    """
    runs: list[PublishedRun] = []
    for path in sorted(folder.rglob("*.json")):
        try:
            description = json.loads(path.read_text(encoding="utf-8"))
        except (ValueError, RecursionError):
            raise ValueError(f"import ioh: {path}: is not JSON") from None
        if isinstance(description, dict) and {"scenarios", "function_id", "algorithm"} <= description.keys():
            try:
                runs += list(_runs(path, description))
            except (KeyError, TypeError, IndexError) as error:
                raise ValueError(
                    f"import ioh: {path}: is no whole description ({type(error).__name__}: {error})"
                ) from None
    if not runs:
        raise ValueError(f"import ioh: {folder} has no IOHprofiler description (*.json with scenarios)")
    return runs


def _runs(path: Path, description: Mapping[str, Any]) -> Iterator[PublishedRun]:
    if description.get("maximization"):
        raise ValueError(f"import ioh: {path}: its values are to be made large; ours are to be made small")
    ours: Mapping[str, Any] = description.get(KEY, {})
    suite = str(description["suite"])
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
            problem = ours.get("problem") or _NAMES.get(suite.lower(), suite)
            minimum = known.get("minimum") if ours else 0.0
            options = {"function": int(description["function_id"]), "dimension": dimension, "instance": instance}
            yield PublishedRun(
                algorithm=str(description["algorithm"]["name"]),
                problem=problem,
                problem_options=known.get("problem_options") or our_options(problem, **options),
                dimension=dimension,
                minimum=minimum,
                evaluations=int(run["evals"]),
                improvements=points,
                targets=known.get("targets"),
                best=run["best"]["y"],
                best_x=[float(value) for value in run["best"].get("x") or []] or None,
                told=_told(ours, known),
            )


def _told(ours: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    said = {**ours, **known}
    return {key: said[key] for key in _KEPT if key in said}


def _curves(path: Path) -> list[list[tuple[int, float]]]:
    """Return the improvements of each run; a run begins where the evaluation is 1, or where a header stands."""
    if not path.is_file():
        raise ValueError(f"import ioh: {path}: is named in a description and is not there")
    curves: list[list[tuple[int, float]]] = []
    best, at, before = inf, 1, 0
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
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
