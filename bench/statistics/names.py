"""What problems, methods and cells are called beside each other, and the order of names.

Different ones have different names, and none is longer than needed.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibench import optimizers, problems
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, by_cell
from calibench.bench.statistics.summary import method_name, method_names, names_of_methods, option_text, problem_name
from calibench.bench.store.columns import Columns, name_rows, numbered, parts, plain

if TYPE_CHECKING:
    import pandas as pd

_MOST_OPTIONS = 3  # of a user's problem, up to which all of them are in its name
_NUMBER = re.compile(r"((?:(?<=[=:,(\[ ])-)?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)")


def problem_titles(table: pd.DataFrame, but: Sequence[str] = ()) -> pd.Series:
    """Return for each row what its problem is called beside the others here (`titles_of_problems`)."""
    return name_rows(table, PROBLEM, lambda problems: titles_of_problems(problems, but))


def titles_of_problems(named: Iterable[tuple[str, str, str]], but: Sequence[str] = ()) -> list[str]:
    """Return what each problem (name, options, data) is called beside the others, the options in `but` left unsaid.

    That is its name, the options chosen, and those in which the problems of its name differ here. Of a class of one's
    own nobody knows the defaults: up to `_MOST_OPTIONS` options are said, else those that differ. Where two would share
    that, also what is left unsaid of an option, and where only their data differ, the start of the data's digest.
    """
    asked = list(named)
    every = list(dict.fromkeys(asked))
    texts = list(dict.fromkeys((name, options) for name, options, _ in every))
    held = {options: parts(json.loads(options)) for _, options in texts}
    values: dict[tuple[str, str], list[str]] = {}  # of an option of a name
    for name, options in texts:
        for key, value in held[options].items():
            values.setdefault((name, key), []).append(json.dumps(value))
    count = Counter(name for name, _ in texts)
    varied = {pair for pair, have in values.items() if len(set(have)) > 1 or len(have) < count[pair[0]]}

    sharing: dict[str, list[tuple[str, str, str]]] = {}
    for name, options, data in every:
        differ = {key for one, key in varied if one == name}
        unknown = name not in problems.registry and len(held[options]) > _MOST_OPTIONS
        same = held[options].keys() - differ if unknown else set()
        sharing.setdefault(problem_name(name, options, (*but, *same), differ), []).append((name, options, data))

    titles: dict[tuple[str, str, str], str] = {}
    copies = Counter((name, options) for name, options, _ in every)
    for title, together in sharing.items():
        have = [{key: value for key, value in held[options].items() if key not in but} for _, options, _ in together]
        keys = sorted({key for each in have for key in each})
        apart = [key for key in keys if any(each.get(key) != have[0].get(key) for each in have)]
        for problem, chosen in zip(together, have, strict=True):
            more = [option_text(option, chosen.get(option), short=False) for option in apart]
            more += [f"data={problem[2][:6]}"] if copies[problem[:2]] > 1 else []
            titles[problem] = " ".join([title, *more])
    return [titles[problem] for problem in asked]


def in_order(text: str) -> list[tuple[float, str]]:
    """Return the key by which names and options are sorted: numbers in them as numbers.

    >>> sorted(["d=10", "d=2", "d=-1", "d=0.5"], key=in_order)
    ['d=-1', 'd=0.5', 'd=2', 'd=10']
    """
    return [(float(part), part) if i % 2 else (0.0, part) for i, part in enumerate(_NUMBER.split(text))]


def options_seen(runs: pd.DataFrame, problem: str, option: str) -> set[Any]:
    """Return the values that `option` of `problem` has in these runs; None where it is not set."""
    texts = runs.loc[runs["problem"] == problem, "problem_options"].unique()
    return {json.loads(text).get(option) for text in texts}


def method_titles(table: pd.DataFrame) -> pd.Series:
    """Return for each row its method, with the options that are not the default; one's own as beside the others."""
    return name_rows(table, METHOD, lambda methods: [
        method_name(*method) if method[0] in optimizers.registry else name
        for method, name in zip(methods, names_of_methods(methods), strict=True)
    ])  # fmt: skip


def name_of_each(runs: pd.DataFrame, names: pd.Series) -> dict[tuple[str, str], str]:
    """Return method -> its name, from the `names` of runs by their index."""
    first = runs[METHOD].drop_duplicates()
    return dict(zip(first.itertuples(index=False, name=None), names[first.index], strict=True))


def several(table: Columns) -> list[str]:
    """Return which of start, budget and target differ in these rows."""
    return [column for column in SETTING if len(set(plain(table[column]))) > 1]


def settings_that_vary(mine: Columns) -> list[str]:
    """Return which of start, budget and target differ on one problem: what a problem itself decides is no choice."""
    differ = several(mine)
    if not differ:
        return []
    named = [plain(mine[column]) for column in PROBLEM if column in mine]  # a table that names none is of one
    problems_here = [*zip(*named, strict=True)] or [()] * len(plain(mine[differ[0]]))
    count = len(set(problems_here))
    return [name for name in differ if len({*zip(problems_here, plain(mine[name]), strict=True)}) > count]


def method_labels(table: pd.DataFrame) -> pd.Series:
    """Return what each row's method is called, with start, budget and target where it has several on one problem."""
    import pandas as pd

    columns = [name for name in CELL if name in table]
    cells = by_cell(table, columns)
    first = table[columns].iloc[cells.first]  # all that names hang on
    names, methods = method_names(first), numbered(first[name] for name in METHOD)
    labels = names.tolist()
    values = {name: first[name].tolist() for name in columns}
    for method in range(methods.max(initial=-1) + 1):
        rows = np.flatnonzero(methods == method).tolist()
        for column in settings_that_vary({name: [values[name][row] for row in rows] for name in columns}):
            for row in rows:
                labels[row] += f", {setting_text(column, values[column][row])}"
    return pd.Series(np.array(labels, dtype=object)[cells.number], index=table.index, dtype=names.dtype)


def setting_text(column: str, value: Any) -> str:
    """Return a start, budget or target in words.

    >>> setting_text("budget", 20000), setting_text("start", "random"), setting_text("target", float("nan"))
    ('budget 20000', 'random start', 'no target')
    """
    if column == "start":
        return f"{value} start"
    if column == "target":
        return f"target {value:g}" if value is not None and value == value else "no target"
    return f"{column} {value:.0f}"
