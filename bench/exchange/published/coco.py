"""Published COCO folders, read: the ``.info`` files and the ``.dat`` and ``.tdat`` files that they name.

All generations of the format are read: old headers without a suite, data with or without the column of constraint
evaluations, minima told in the header of the entry or of each run's data. Archives are to be unpacked before. Suites of
two objectives have no value to compare and are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import inf, isfinite
from pathlib import Path
from typing import Any

from calibench.bench.exchange.coco import NOT_FINITE, TOLD
from calibench.bench.exchange.published.problem_names import of_coco
from calibench.bench.exchange.published.study import PublishedRun, text_of_file
from calibench.core.nested_text import json_of

_PAIR = re.compile(r"\s*([^,=]+?)\s*=\s*(\".*?\"|'.*?'|[^,]+)\s*(?=,|$)")
_RUN = re.compile(r"(\d+):(\d+)\|(\S+)")
_MINIMUM = re.compile(r"Fopt \(([^)]+)\)")
_NOISY_FROM = 101  # function numbers of the noisy suite, where no suite is named


def read_coco(folder: Path) -> list[PublishedRun]:
    """Return the runs in `folder` and the folders below it.

    Raises `ValueError` where there is no ``.info`` file, one cannot be read, or a suite has several objectives.
    """
    found = sorted(folder.rglob("*.info"))
    if not found:
        raise ValueError(f"import coco: {folder} has no .info file; name the folder of unpacked COCO data")
    runs: list[PublishedRun] = []
    for path in found:
        lines = [line for line in text_of_file("coco", path).splitlines() if line.strip()]
        header: dict[str, str] = {}
        told: dict[str, Any] = {}
        for line in lines:
            if line.startswith(TOLD):
                told = _told(line, path)
            elif line.startswith("%"):
                continue
            elif ".dat" in line and "funcId" not in line and "function =" not in line:
                runs += _entry(path, header, told, line)
            else:
                header, told = {key: value.strip("'\" ") for key, value in _PAIR.findall(line)}, {}
    if not runs:
        raise ValueError(f"import coco: no run is listed in the .info files of {folder}")
    return runs


def _told(line: str, path: Path) -> dict[str, Any]:
    try:
        told = json_of(line.removeprefix(TOLD))
    except ValueError:
        raise ValueError(f"import coco: {path}: its comment {line[:40]!r} is damaged") from None
    return told if isinstance(told, dict) else {}


def _entry(path: Path, header: dict[str, str], told: dict[str, Any], line: str) -> Iterator[PublishedRun]:
    """Yield the runs of one function in one dimension."""
    if "indicator" in header:
        raise ValueError(f"import coco: {path}: has several objectives ({header['indicator']}); there is no one value")
    try:
        function, dimension = (
            int(header.get("funcId", header.get("function", ""))),
            int(header.get("DIM", header.get("dim", ""))),
        )
    except ValueError:
        raise ValueError(f"import coco: {path}: an entry names no function and dimension") from None
    suite = header.get("suite") or ("bbob" if function < _NOISY_FROM else "bbob-noisy")
    algorithm = header.get("algId") or header.get("algorithm") or path.parent.name
    name, _, rest = line.partition(",")
    data = path.parent / name.strip().replace("\\", "/")
    listed = [(int(instance), int(count)) for instance, count, _ in _RUN.findall(rest)]
    curves = _curves(data, header)
    if len(curves) != len(listed):
        raise ValueError(f"import coco: {data}: has {len(curves)} runs, {path.name} lists {len(listed)}")
    for (instance, count), (minimum, points) in zip(listed, curves, strict=True):
        named = of_coco(suite, function, dimension, instance)
        ours = named.minimum  # has all digits; data tell thirteen
        if ours is not None and abs(ours - minimum) > 1e-9 * max(1.0, abs(ours)):
            said = f"the minimum of f{function} in dimension {dimension}, instance {instance}"
            raise ValueError(f"import coco: {data}: {said}, is {minimum:g}; that of our problem is {ours:g}")
        yield PublishedRun(
            algorithm=algorithm,
            problem=named.problem,
            problem_options=named.problem_options,
            data_id=named.data_id,
            dimension=dimension,
            minimum=minimum if ours is None else ours,
            evaluations=max(count, points[-1][0] if points else 0),
            improvements=_improvements(points),
            targets=None,
            best=None,  # the index rounds it to two digits
            best_x=None,
            told={
                key: value for key, value in told.items() if key in ("start", "budget", "library", "library_version")
            },
        )


def _curves(path: Path, header: dict[str, str]) -> list[tuple[float, list[tuple[int, float]]]]:
    """Return minimum and (evaluation, gap) points of each run, from both files, which complement each other."""
    if not path.is_file():
        raise ValueError(f"import coco: {path}: is named in an .info file and is not there")
    curves = _read(path, header)
    also = path.with_suffix(".tdat")
    more = _read(also, header) if also.is_file() else []
    if len(more) == len(curves):
        curves = [(minimum, points + extra) for (minimum, points), (_, extra) in zip(curves, more, strict=True)]
    return [(minimum, sorted(set(points))) for minimum, points in curves]


def _read(path: Path, header: dict[str, str]) -> list[tuple[float, list[tuple[int, float]]]]:
    curves: list[tuple[float, list[tuple[int, float]]]] = []
    begun = False
    for number, line in enumerate(text_of_file("coco", path).splitlines(), 1):
        if line.startswith("%"):
            if not begun:
                said = _MINIMUM.search(line)
                curves.append((float(said[1] if said else header.get("Fopt", "0")), []))
            begun = True
            continue
        begun = False
        columns = line.split()
        if not columns or not curves:
            continue
        try:
            curves[-1][1].append((int(float(columns[0])), float(columns[2])))
        except (ValueError, IndexError):
            raise ValueError(f"import coco: {path}, line {number}: is no line of COCO data") from None
    return curves


def _improvements(points: list[tuple[int, float]]) -> list[tuple[int, float]]:
    found: list[tuple[int, float]] = []
    best = inf
    for evaluation, gap in points:
        if gap < best and isfinite(gap) and gap < NOT_FINITE:
            found.append((evaluation, gap))
            best = gap
    return found
