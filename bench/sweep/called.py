"""What cells of a sweep are called on the terminal: by the names that tables have for their problems and methods."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import pandas as pd

from calibench.bench.provenance.run_id import canonical
from calibench.bench.statistics.cells import METHOD, PROBLEM, SETTING
from calibench.bench.statistics.names.labels import problem_titles, setting_text
from calibench.bench.statistics.summary import method_name, method_names, problem_name

_BESIDE = 200  # problems or methods up to which each is named by what sets it apart from the others


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
    table = pd.DataFrame(
        [
            (*_problem(cell), cell.optimizer[0], canonical(cell.optimizer[1]), cell.start, cell.budget, cell.target)
            for cell in cells.values()
        ],
        columns=[*PROBLEM, *METHOD, *SETTING],
        index=list(cells),
    )  # fmt: skip
    told = [column for column in ("start", "budget", "target") if table[column].nunique(dropna=False) > 1]
    names = {}
    for (label, row), problem, method in zip(table.iterrows(), _problems(table), _methods(table), strict=True):
        settings = [setting_text(column, row[column]) for column in told]
        names[str(label)] = ", ".join([f"{method} on {problem}", *settings])
    count = Counter(names.values())
    return {label: name if count[name] == 1 else label for label, name in names.items()}


def _problem(cell: Cell) -> tuple[str, str, str]:
    name, options, *data = cell.problem
    return name, canonical(options), str(data[0]) if data else ""


def _problems(table: pd.DataFrame) -> list[str]:
    pairs = table[["problem", "problem_options"]]
    if len(pairs.drop_duplicates()) <= _BESIDE:
        return list(problem_titles(table))
    return [problem_name(*pair) for pair in pairs.itertuples(index=False, name=None)]


def _methods(table: pd.DataFrame) -> list[str]:
    pairs = table[["optimizer", "optimizer_options"]]
    if len(pairs.drop_duplicates()) <= _BESIDE:
        return list(method_names(table))
    return [method_name(*pair) for pair in pairs.itertuples(index=False, name=None)]
