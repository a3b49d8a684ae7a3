"""Which problems stand together on a page: the group that a problem declares, else the problems of one name."""

from __future__ import annotations

import pandas as pd


def groups_of(runs: pd.DataFrame) -> pd.Series:
    """Return the group of each run's problem: its `problem_group`, where it declares one, else its name."""
    if "problem_group" not in runs:
        return runs["problem"].astype(str)
    declared = runs["problem_group"].fillna("").astype(str)
    return declared.where(declared != "", runs["problem"].astype(str))
