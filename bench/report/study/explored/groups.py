"""Which problems stand together on a page: the group that a problem declares, else the problems of one name."""

from __future__ import annotations

import pandas as pd

from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.tables import problem_of


def groups_of(runs: pd.DataFrame) -> pd.Series:
    """Return the group of each run's problem: its `group`, where it declares one, else its name."""
    columns = PROBLEM[:2]
    pairs = list(zip(*(runs[column].tolist() for column in columns), strict=True))
    told = {pair: _group(*pair) for pair in dict.fromkeys(pairs)}
    return pd.Series([told[pair] for pair in pairs], index=runs.index, dtype=str)


def _group(name: str, options: str) -> str:
    try:
        declared = getattr(problem_of({"problem": name, "problem_options": options}), "group", "")
    except Exception:  # a user's own, which is not here any more: its name must do
        declared = ""
    return str(declared or name)
