"""What problems, methods and cells are called beside each other, and the order of names.

Different ones have different names, and none is longer than needed.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from calibench import optimizers, problems
from calibench.bench.statistics.cells import METHOD, PROBLEM, SETTING
from calibench.bench.statistics.summary import MOST_OPTIONS, method_name, method_names, option_text, problem_name
from calibench.bench.store.columns import Columns, parts, plain

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = re.compile(r"((?:(?<=[=:,(\[ ])-)?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)")


def problem_titles(table: pd.DataFrame, but: Sequence[str] = ()) -> pd.Series:
    """Return for each row what its problem is called beside the others here (`titles_of_problems`)."""
    import pandas as pd

    titles = titles_of_problems(zip(*(table[column] for column in PROBLEM), strict=True), but)
    return pd.Series(titles, index=table.index, dtype=str)


def titles_of_problems(named: Iterable[tuple[str, str, str]], but: Sequence[str] = ()) -> list[str]:
    """Return what each problem (name, options, data) is called beside the others, the options in `but` left unsaid.

    That is its name, the options chosen, and those in which the problems of its name differ here, also where its own is
    the default. Of a class of one's own nobody here knows the defaults: of up to `MOST_OPTIONS` options all are said,
    of more those that differ. Where two problems would share that, also what is not said of an option else, and where
    only their data differ, the start of the data's digest.
    """
    sharing: dict[str, list[tuple[str, str, str]]] = {}
    asked = list(named)
    every = list(dict.fromkeys(asked))
    varied = _varied(every)
    ours = problems.registry
    for name, options, data in every:
        keys = {*parts(json.loads(options))}
        same = keys - varied[name] if name not in ours and len(keys) > MOST_OPTIONS else set()
        title = problem_name(name, options, (*but, *same), varied[name])
        sharing.setdefault(title, []).append((name, options, data))
    titles: dict[tuple[str, str, str], str] = {}
    for title, alike in sharing.items():
        have = [{k: v for k, v in parts(json.loads(options)).items() if k not in but} for _, options, _ in alike]
        apart = [k for k in sorted({k for h in have for k in h}) if any(h.get(k) != have[0].get(k) for h in have)]
        for key, chosen in zip(alike, have, strict=True):
            titles[key] = " ".join([title, *(option_text(option, chosen.get(option), short=False) for option in apart)])
    count = Counter((name, options) for name, options, _ in every)
    for key in titles:
        if count[key[:2]] > 1:
            titles[key] += f" data={key[2][:6]}"
    return [titles[key] for key in asked]


def _varied(keys: Iterable[tuple[str, str, str]]) -> dict[str, set[str]]:
    """Return of each name of a problem the options that differ between the problems of that name."""
    seen: dict[str, dict[str, set[str]]] = {}
    texts = {(name, options) for name, options, _ in keys}
    for name, options in texts:
        of_name = seen.setdefault(name, {})
        for key, value in parts(json.loads(options)).items():
            of_name.setdefault(key, set()).add(json.dumps(value))
    count = Counter(name for name, _ in texts)
    every = Counter((name, key) for name, options in texts for key in parts(json.loads(options)))
    return {
        name: {key for key, values in of_name.items() if len(values) > 1 or every[name, key] < count[name]}
        for name, of_name in seen.items()
    }


def in_order(text: str) -> list[tuple[float, str]]:
    """Return the key by which names and options are sorted: numbers in them as numbers.

    >>> sorted(["d=10", "d=2", "d=-1", "d=0.5"], key=in_order)
    ['d=-1', 'd=0.5', 'd=2', 'd=10']
    """
    parts = _NUMBER.split(text)
    return [(float(part), part) if i % 2 else (0.0, part) for i, part in enumerate(parts)]


def options_seen(runs: pd.DataFrame, problem: str, option: str) -> set[Any]:
    """Return the values that `option` of `problem` has in these runs; None where it is not set."""
    texts = runs.loc[runs["problem"] == problem, "problem_options"].unique()
    return {json.loads(text).get(option) for text in texts}


def method_titles(table: pd.DataFrame) -> pd.Series:
    """Return for each row its method, named so that it can be run again: with the options that are not the default.

    Of a class of one's own nobody here knows the defaults: it is named as beside the others here (`method_names`).
    """
    import pandas as pd

    ours = optimizers.registry
    rows = zip(table["optimizer"], table["optimizer_options"], method_names(table), strict=True)
    titles = [method_name(name, options) if name in ours else beside for name, options, beside in rows]
    return pd.Series(titles, index=table.index, dtype=str)


def several(table: Columns) -> list[str]:
    """Return which of start, budget and target differ in these rows."""
    return [column for column in SETTING if len(set(plain(table[column]))) > 1]


def settings_that_vary(mine: pd.DataFrame) -> list[str]:
    """Return which of start, budget and target differ on one problem: what a problem itself decides is no choice."""
    named = [column for column in PROBLEM if column in mine]  # a table that names none is of one
    problems_here = len(mine[named].drop_duplicates()) if named else 1
    return [column for column in SETTING if len(mine[[*named, column]].drop_duplicates()) > problems_here]


def method_labels(table: pd.DataFrame) -> pd.Series:
    """Return what each row's method is called, with the start, budget and target of which it has several here.

    What differs only from problem to problem, such as the start that each prefers, makes no second method.
    """
    labels = method_names(table)
    for _, mine in table.groupby(METHOD, sort=False):
        columns = settings_that_vary(mine)
        for key, same in mine.groupby(columns, dropna=False) if columns else [((), mine)]:
            texts = [setting_text(column, value) for column, value in zip(columns, key, strict=True)]
            labels.loc[same.index] = [", ".join([name, *texts]) for name in labels.loc[same.index]]
    return labels


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
