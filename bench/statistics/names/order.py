"""The order of a study's methods, the best over all problems first; lists of the page and colours follow it.

A method has one colour and one line style in a report, whatever it is compared with in a drawing.
"""

from __future__ import annotations

import pandas as pd

from calibench.bench.statistics.cells import CELL, METHOD
from calibench.bench.statistics.comparison.ranking import methods as ranked_methods
from calibench.bench.statistics.names.labels import in_order, method_labels

LOOK = "look"  # the column of runs that holds the number of a method's colour and line style


def methods_in_order(runs: pd.DataFrame, summary: pd.DataFrame) -> list[str]:
    """Return the names (`method_labels`) of the methods of `runs`, the best over all problems of `summary` first."""
    first = runs.assign(method=method_labels(runs)).drop_duplicates(CELL)[[*CELL, "method"]]
    numbers = first.merge(summary, on=CELL, how="left")
    by_name = sorted(range(len(numbers)), key=lambda k: in_order(numbers["method"].iloc[k]))
    numbers = numbers.iloc[by_name].reset_index(drop=True)  # so that ties do not hang on the order of the rows
    place = {tuple(pair): i for i, pair in enumerate(ranked_methods(numbers)[METHOD].itertuples(index=False))}
    pairs = [place[pair] for pair in zip(numbers["optimizer"], numbers["optimizer_options"], strict=True)]
    return list(dict.fromkeys(numbers.assign(place=pairs).sort_values("place", kind="stable")["method"]))


def with_looks(runs: pd.DataFrame, summary: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with the number of each method's colour in the column `LOOK`, for drawings of any part of them."""
    place = {name: i for i, name in enumerate(methods_in_order(runs, summary))}
    return runs.assign(**{LOOK: method_labels(runs).map(place)})


def looks_of(named: pd.DataFrame, methods: list[str]) -> dict[str, int]:
    """Return method -> the number of its look, of runs with a column `method`; their order where none is given."""
    if LOOK not in named:
        return {method: i for i, method in enumerate(methods)}
    return dict(zip(named["method"], named[LOOK].astype(int), strict=True))
