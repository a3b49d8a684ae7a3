"""A cell: runs that differ only in their repetition. Every statistic is of one cell, never of a mixture.

A problem is its name with its options and data, a method an optimiser with its options; a cell is both under one start,
budget and target. A task is what methods are compared on: a problem under one start, budget and goal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

PROBLEM = ["problem", "problem_options", "data_id"]
METHOD = ["optimizer", "optimizer_options"]
SETTING = ["start", "budget", "target"]
CELL = [*PROBLEM, *METHOD, *SETTING]
TASK = [
    *PROBLEM,
    "start",
    "budget",
    "goal",
]  # the goal, not the target: who stops there is compared too


def mixed_code(runs: pd.DataFrame) -> str:
    """Return a sentence on cells whose runs were made by more than one version of the code; '' where none were."""
    versions = runs.groupby(CELL, dropna=False)["code_digest"].nunique()
    mixed = int((versions > 1).sum())
    if not mixed:
        return ""
    return (
        f"{mixed} of {len(versions)} cells hold runs of more than one version of the code (column code_digest), kept "
        "with --keep or merged: their medians mix them; the same command with --rerun does them again."
    )
