"""Names of a sweep's cells on the terminal: those that tables have for their problems and methods."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

from calibench import problems
from calibench.bench.provenance.run_id import canonical
from calibench.bench.statistics.cells import SETTING
from calibench.bench.statistics.names.labels import setting_text, several, titles_of_problems
from calibench.bench.statistics.summary import method_name, names_of_methods, problem_name

_BESIDE = 200  # problems or methods: up to so many, each is named by the options in which it differs from the others


@final
@dataclass(frozen=True, eq=False)
class Cell:
    """One cell as it is asked for: the keys of its problem and its method (name, options, ...), and its setting."""

    problem: Sequence[Any]
    optimizer: Sequence[Any]
    budget: int
    start: Any
    target: float | None


def called(cells: Mapping[str, Cell]) -> dict[str, str]:
    """Return label -> what its cell is called beside the others of the sweep; the label where two would be the same.

    A start, a budget and a target are told where the sweep has several.
    """
    settings = {name: [getattr(cell, name) for cell in cells.values()] for name in SETTING}
    told = several(settings)
    problems_of, methods_of = _problems(cells.values()), _methods(cells.values())
    names = {}
    for label, problem, method, *values in zip(cells, problems_of, methods_of, *settings.values(), strict=True):
        of_cell = dict(zip(SETTING, values, strict=True))
        names[label] = ", ".join([f"{method} on {problem}", *(setting_text(name, of_cell[name]) for name in told)])
    count = Counter(names.values())
    return {label: name if count[name] == 1 else label for label, name in names.items()}


def _problem(cell: Cell) -> tuple[str, str, str]:
    name, options, *data = cell.problem
    return name, canonical(options), str(data[0]) if data else ""


def _problems(cells: Iterable[Cell]) -> list[str]:
    named = [_problem(cell) for cell in cells]
    if len({(name, options) for name, options, _ in named}) <= _BESIDE:
        return titles_of_problems(named)
    return [problem_name(name, options) for name, options, _ in named]


def _methods(cells: Iterable[Cell]) -> list[str]:
    named = [(str(cell.optimizer[0]), canonical(cell.optimizer[1])) for cell in cells]
    if len(set(named)) <= _BESIDE:
        return names_of_methods(named)
    return [method_name(*pair) for pair in named]


def copies(cells: Iterable[Cell]) -> list[str]:
    """Return a line for each problem that a sweep asks for with several seeds of its data, which are the same with all.

    Without noise, and on a plan that is not random, a seed changes nothing. A test would count such problems as several
    blocks, and they are one.
    """
    found: dict[str, set[str]] = {}
    for cell in cells:
        name, options, data = _problem(cell)
        chosen = json.loads(options)
        seed = {key: chosen.pop(key) for key in ("data_seed", "seed") if key in chosen}
        if data and name in problems.registry:
            found.setdefault(canonical({"problem": name, "data": data, **chosen}), set()).add(canonical(seed))
    lines = {
        f"{json.loads(key)['problem']}: its {len(seeds)} data seeds draw nothing (no noise, a fixed plan): they are "
        "one problem, not several": None
        for key, seeds in found.items()
        if len(seeds) > 1
    }
    return list(lines)
