"""How a method ends: it stops by its own test, begins again where it would have stopped, or spends the whole budget.

A method that stops with budget left cannot be compared with one that spends all of it. So a field of methods has each
local method in both kinds, and marks the kind.
"""

from __future__ import annotations

import json
from functools import cache

import pandas as pd

from calibench import optimizers
from calibench.bench.provenance.run_id import given_options
from calibench.bench.statistics.cells import METHOD


def endings(table: pd.DataFrame) -> pd.Series:
    """Return of each row's method "restarts", "stops", or "" where it spends the budget or is not known here."""
    kinds = [_ending(*key) for key in zip(*(table[column] for column in METHOD), strict=True)]
    return pd.Series(kinds, index=table.index, dtype=str)


@cache
def _ending(optimizer: str, options: str) -> str:
    said = json.loads(options)
    if said.get("restarts"):
        return "restarts"
    if optimizer not in optimizers.registry:
        return ""
    chosen = given_options(optimizers.registry, optimizer, said)
    try:
        return "stops" if optimizers.make(optimizer, **chosen).traits.self_terminating else ""
    except (ValueError, AttributeError):  # options of another version, or a class without traits
        return ""
