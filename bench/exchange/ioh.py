"""IOHprofiler's folders, as IOHexperimenter 0.3.22 logs them and iohinspector reads them: a folder an algorithm.

``IOHprofiler_f1_Sphere.json`` lists a function's dimensions and runs, ``data_f1_Sphere/*.dat`` has a line an
improvement; ``raw_y`` is above the minimum where one is declared. A run begins where the evaluation is 1.
"""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from calibench.bench.exchange import studies
from calibench.bench.exchange.studies import BBOB, Named, PublishedRun, RunRecord, Study
from calibench.bench.provenance.environment import library_version
from calibench.bench.provenance.run_id import canonical
from calibench.bench.statistics.names import problem_titles
from calibench.core.plain import json_of
from calibench.core.words import counted

KEY = "calibench"  # of a description: what IOHprofiler has no place for
_OF_A_PROBLEM = ("dimension", "instance")  # IOHprofiler has places of its own for them
_FORMAT = "0.3.22"
_CEC, _CEC_BEFORE = "CEC2022", 1000
_KEPT = ("start", "budget", "library", "library_version", "unit")  # of what a description of ours says


def write_ioh(study: Study, folder: Path) -> list[str]:
    """Write the runs of `study` into `folder`, a function a title of a problem; return remarks, a line each."""
    runs = studies.run_records(study)
    algorithms = studies.file_names(sorted({run.algorithm for run in runs}))
    first: dict[str, RunRecord] = {}
    names: dict[str, str] = {}
    groups: dict[tuple[str, str], list[RunRecord]] = defaultdict(list)
    for run, title in zip(runs, problem_titles(study.runs, but=_OF_A_PROBLEM), strict=True):
        options = {key: value for key, value in run.options.items() if key not in _OF_A_PROBLEM}
        key = canonical({"problem": run.row["problem"], "options": options})
        first.setdefault(key, run)
        names.setdefault(key, studies.file_name(title))
        groups[run.algorithm, key].append(run)
    numbers: dict[str, int] = {}
    for key, run in first.items():
        wish = run.options.get("function")
        if isinstance(wish, int) and wish > 0 and wish not in numbers.values():
            numbers[key] = wish
    free = (n for n in range(1, len(first) + 1 + max(numbers.values(), default=0)) if n not in set(numbers.values()))
    for key in sorted(first.keys() - numbers.keys()):
        numbers[key] = next(free)
    for (algorithm, key), mine in groups.items():
        _write_function(folder / algorithms[algorithm], algorithm, numbers[key], names[key], mine)
    what = f"{counted(len(algorithms), 'algorithm')} on {counted(len(first), 'function')}"
    return [f"{counted(len(runs), 'run')} of {what}"]


def _write_function(home: Path, algorithm: str, number: int, name: str, runs: Sequence[RunRecord]) -> None:
    by_dimension: dict[int, list[RunRecord]] = defaultdict(list)
    for run in sorted(runs, key=lambda run: (not run.row["charged"], _instance(run), run.row["repetition"])):
        by_dimension[int(run.row["dimension"])].append(run)
    (home / f"data_f{number}_{name}").mkdir(parents=True, exist_ok=True)
    scenarios = []
    for dimension, mine in sorted(by_dimension.items()):
        path, lines, listed = f"data_f{number}_{name}/IOHprofiler_f{number}_DIM{dimension}.dat", [], []
        for run in mine:
            # an infinite value comes first where a run failed or its first values were not finite
            rows = [(one.charged, studies.gap_of_value(one.value, run.minimum, one.reached)) for one in run.course]
            late = run.row["charged"] and (not rows or rows[0][0] > 1)
            lines += [f"{n} {value!r}\n" for n, value in [*([(1, inf)] if late else []), *rows]]
            best, x = float(run.row["best_value"]), run.row["best_x"]
            last = run.course[-1] if run.course else None
            reached = last.reached if last is not None and last.value == best else None
            y = studies.gap_of_value(best, run.minimum, reached)
            best_of: dict[str, Any] = {"evals": last.charged if last else 0}
            best_of["y"] = y if isfinite(y) else None  # JSON has no infinity
            best_of["x"] = [] if x is None else [float(value) for value in x]
            counts = {"instance": _instance(run), "evals": int(run.row["charged"])}
            listed.append(counts | {"best": best_of, "repetition": int(run.row["repetition"])})
            if pd.notna(run.row["judged_evaluations"]):
                value = float(run.row["judged_value"])
                judged = {"judged_value": value if isfinite(value) else None}  # JSON has no infinity
                listed[-1] |= judged | {"judged_evaluations": int(run.row["judged_evaluations"])}
        (home / path).write_text("evaluations raw_y\n" + "".join(lines), encoding="ascii")
        scenarios.append({"dimension": dimension, "path": path, "runs": listed})
    row = runs[0].row
    library = " ".join(part for part in (row["library"], row["library_version"]) if isinstance(part, str))
    # the facts that all runs of a function share, and those that runs of a dimension and instance share
    shared = ("problem", "optimizer", "optimizer_options", "library", "library_version", "start", "budget", "unit")
    instances: dict[str, Mapping[str, Any]] = {}
    for run in runs:
        instances[f"{run.row['dimension']}.{_instance(run)}"] = {
            "problem_options": run.row["problem_options"], "data_id": run.row["data_id"], "minimum": run.minimum,
            "targets": [float(level) for level in run.row["targets"]],
            "budget": None if pd.isna(run.row["budget"]) else int(run.row["budget"]),
        }  # fmt: skip
    # published runs tell no start and no budget: JSON has no word for what is not a number
    values = {name: {None if pd.isna(run.row[name]) else run.row[name] for run in runs} for name in shared}
    common = {name: next(iter(value)) for name, value in values.items() if len(value) == 1}
    origin = {"version": library_version("calibench"), **common, "instances": instances}
    description = {
        "version": _FORMAT, "suite": row["problem"], "function_id": number, "function_name": name,
        "maximization": False, "algorithm": {"name": algorithm, "info": library or "unknown"},
        "attributes": ["evaluations", "raw_y"], "scenarios": scenarios, KEY: origin,
    }  # fmt: skip
    text = json.dumps(description, indent=1, allow_nan=False)
    (home / f"IOHprofiler_f{number}_{name}.json").write_text(text + "\n", encoding="utf-8")


def _instance(run: RunRecord) -> int:
    instance = run.options.get("instance")
    return instance if isinstance(instance, int) else 1


def read_ioh(folder: Path) -> list[PublishedRun]:
    """Return the runs in `folder` and the folders below it."""
    runs: list[PublishedRun] = []
    for path in sorted(folder.rglob("*.json")):
        text = studies.text_of_file("ioh", path)
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
            if "problem" in ours and known:  # as this package wrote it
                named = Named(ours["problem"], known["problem_options"], known["data_id"], known["minimum"])
            else:  # data of others: where the minimum is not known, values above it are data of their own
                function, name = int(description["function_id"]), str(description["function_name"])
                suite = str(description["suite"])
                # a suite that is not told is known by the function's name; CEC 2022 is numbered there from 1001
                if suite == "unknown_suite" and 1 <= function <= len(BBOB) and BBOB[function - 1] == name:
                    suite = "BBOB"
                if suite in (_CEC, "unknown_suite") and name.startswith(_CEC) and function > _CEC_BEFORE:
                    suite, function = _CEC, function - _CEC_BEFORE
                options = {"suite": suite, "function": function, "dimension": dimension, "instance": instance}
                named = studies.named_problem("ioh", options, f"{suite}_f{function}_i{instance}_d{dimension}")
                if named.minimum is None:
                    named = replace(named, minimum=0.0, data_id=f"{named.data_id}_gap")
            columns = {key: value for key, value in {**ours, **known}.items() if key in _KEPT}
            if "judged_evaluations" in run:
                value = run["judged_value"]
                columns["judged_value"] = inf if value is None else float(value)
                columns["judged_evaluations"] = int(run["judged_evaluations"])
            yield PublishedRun(
                algorithm=str(description["algorithm"]["name"]), problem=named.problem, data_id=named.data_id,
                problem_options=named.problem_options, dimension=dimension, minimum=named.minimum,
                evaluations=int(run["evals"]), improvements=points, targets=known.get("targets"),
                best=run["best"]["y"], best_x=[float(value) for value in run["best"].get("x") or []] or None,
                columns=columns,
            )  # fmt: skip


def _curves(path: Path) -> list[list[tuple[int, float]]]:
    """Return the improvements of each run; a run begins where the evaluation is 1, or where a header stands."""
    if not path.is_file():
        raise ValueError(f"import ioh: {path}: is named in a description and is not there")
    curves: list[list[tuple[int, float]]] = []
    best, at, before = inf, 1, 0
    for number, line in enumerate(studies.text_of_file("ioh", path).splitlines(), 1):
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
