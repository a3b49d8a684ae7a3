"""What the page knows of targets: of each cell how many runs reached each, what that cost, and how that adds up.

Expected running times are those of `bench.statistics.runtime.ert`, the shares those of `runtime.ecdf`, cell by cell, so
that the page can put any methods and problems together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.statistics.cells import CELL, PROBLEM
from calibench.bench.statistics.fixed_target.runtimes import runtimes
from calibench.bench.statistics.runtime import ert

Array = NDArray[np.float64]
GOAL = "goal"  # the quantity of the one target that counts as success on a problem


@final
@dataclass(frozen=True)
class Reached:
    """The cells against the targets of one quantity: arrays of shape (cells, targets), NaN where a problem has none.

    `reached` runs of the cell, `ert` [charged evaluations, infinite where none reached it] with `low` and `high`, its
    95 % interval. `share`, shape (cells, costs), are the shares of (run, target)
    pairs reached within each cost; None of a quantity with one target.
    """

    quantity: str
    targets: Array
    reached: Array
    ert: Array
    low: Array
    high: Array
    share: Array | None


def reached_targets(runs: pd.DataFrame, hits: pd.DataFrame, goals: Mapping[int, float], costs: Array) -> list[Reached]:
    """Return what is known of each quantity in `hits`, the goal first.

    `runs` have the column `cell`, numbers from 0; `goals` are the levels that count as success by cell; `costs` are
    charged evaluations, shape (costs,).
    """
    cells = int(runs["cell"].max()) + 1
    table = ert(hits, runs)
    if table.empty:
        return []
    table["cell"] = _numbers(table, runs)
    shares = _shares(hits, runs, cells, costs)
    found = []
    value = table[table["quantity"] == "value"]
    goal = value["cell"].map(goals).to_numpy(dtype=float)
    at_goal = value[value["target"].to_numpy(dtype=float) == goal]
    if len(at_goal):
        found.append(_table(GOAL, at_goal.assign(target=0.0), cells, np.zeros(1), None))
    for quantity, rows in table[table["quantity"] != "value"].groupby("quantity", sort=False):
        name = str(quantity)
        if name == "noise":  # one target a problem, each of its own level
            found.append(_table(name, rows.assign(target=0.0), cells, np.zeros(1), None))
            continue
        targets = np.sort(rows["target"].unique())[::-1].astype(float)
        found.append(_table(name, rows, cells, targets, shares.get(name)))
    return found


def _numbers(table: pd.DataFrame, runs: pd.DataFrame) -> Array:
    """Return the number of the cell of each row of `table`, in which the run's own target is ``target_value``."""
    keys = [column for column in CELL if column != "target"]
    known = runs.drop_duplicates("cell")
    cells = known[[*keys, "cell"]].assign(own=known["target"].astype(float).fillna(-np.inf))
    rows = table[keys].assign(own=table["target_value"].astype(float).fillna(-np.inf))
    found: Array = rows.merge(cells, on=[*keys, "own"], how="left")["cell"].to_numpy()
    return found


def _table(quantity: str, rows: pd.DataFrame, cells: int, targets: Array, share: Array | None) -> Reached:
    column = np.searchsorted(-targets, -rows["target"].to_numpy(dtype=float))
    place = rows["cell"].to_numpy(dtype=np.int64), column

    def filled(name: str) -> Array:
        whole = np.full((cells, len(targets)), np.nan)
        whole[place] = rows[name].to_numpy(dtype=float)
        return whole

    return Reached(quantity, targets, filled("reached"), filled("ert"), filled("ert_low"), filled("ert_high"), share)


def _shares(hits: pd.DataFrame, runs: pd.DataFrame, cells: int, costs: Array) -> dict[str, Array]:
    """Return quantity -> the shares of (run, target) pairs reached within `costs`, shape (cells, costs)."""
    found: dict[str, Array] = {}
    for one in runtimes(hits, runs[["run_id", *PROBLEM, "cell", "charged", "evaluations"]]):
        numbers, names = one.all_runs["cell"].to_numpy()[one.at], one.all_targets["quantity"].to_numpy()[one.level]
        for quantity in dict.fromkeys(names.tolist()):
            whole = found.setdefault(str(quantity), np.full((cells, len(costs)), np.nan))
            times = one.time[:, names == quantity]
            for cell in dict.fromkeys(numbers.tolist()):
                mine = np.sort(times[numbers == cell].ravel())
                whole[cell] = np.searchsorted(mine, costs, side="right") / len(mine)
    return found
