"""How the methods of the compact table stand: share of blocks reached, expected charge, ranks and their test.

A block is a family with its instance. Repetitions are no blocks: of several a block has the median.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.answer.compact import BLOCK, KNOWS
from calibench.bench.statistics.fixed_target import ert_interval
from calibench.bench.statistics.ranking import Blocks, Ranked, friedman
from calibench.bench.statistics.summary import success_interval
from calibench.core.seeds import digest

METHOD = ["method", "ends"]
_OUTCOME = [*BLOCK, "repetition", "reached_at", "excess"]
_NEVER = 1e12  # a score worse than any charge


def named(method: str, ends: str) -> str:
    """Return what a method is called: of a local one also whether it stops or restarts.

    >>> named("lm", "stops"), named("de", "")
    ('lm, stops', 'de')
    """
    return f"{method}, {ends}" if ends else method


def standing(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row a method, best first: most blocks reached, then least expected charge, then who simply stops.

    name, method, knows; outcome: a digest of what came of every run; blocks: all of the table; ran: those where the
    method could run; reached: blocks, each by the share of its runs that did (one that could not run counts as not
    reached); share of all blocks with its 95 % interval (low, high); ert: all charges of these runs until they reached,
    over how many did (infinite where none); inside: share of answers in the box; and the medians of position_error_mm
    and parameter_error_mm.
    """
    rows, blocks = [], len(table[BLOCK].drop_duplicates())
    for (method, ends), mine in table.groupby(METHOD, sort=False):
        hit = mine["reached_at"].notna()
        spent = mine["reached_at"].fillna(mine["charged"]).sum()
        shares = hit.groupby([mine[column] for column in BLOCK]).mean()
        low, high = success_interval(round(shares.sum()), blocks)
        rows.append(
            {
                "name": named(str(method), str(ends)),
                "method": str(method),
                "outcome": digest(mine[_OUTCOME].fillna(-1.0).to_numpy().tolist()),
                "knows": mine["knows"].iloc[0],
                "blocks": blocks,
                "ran": len(shares),
                "reached": float(shares.sum()),
                "share": float(shares.sum() / blocks),
                "low": low,
                "high": high,
                "ert": float(spent / hit.sum()) if hit.any() else float("inf"),
                "inside": float(mine["inside_box"].mean()),
                "position_error_mm": float(mine["position_error_mm"].median()),
                "parameter_error_mm": float(mine["parameter_error_mm"].median()),
            }
        )
    found = pd.DataFrame(rows).assign(again=[row["name"].endswith(", restarts") for row in rows])
    order = ["share", "ert", "again", "name"]
    return found.sort_values(order, ascending=[False, True, True, True], ignore_index=True).drop(columns="again")


def leading(table: pd.DataFrame, many: int) -> pd.DataFrame:
    """Return the rows of `standing` of the first methods of each kind, of a local one its better way to end.

    Methods with the same outcome in every run are one line, such as a wrapper that has nothing to add to what it calls;
    `alike` names the others, '' where there are none.
    """
    found = standing(table).drop_duplicates("method")
    same = found.groupby("outcome", sort=False)["name"].agg(list)
    found = found.drop_duplicates("outcome")
    found = found.assign(alike=[", ".join(same[outcome][1:]) for outcome in found["outcome"]])
    return pd.concat([found[found["knows"] == kind].head(many) for kind in KNOWS], ignore_index=True)


def ert_bounds(table: pd.DataFrame, name: str) -> tuple[float, float]:
    """Return the 95 % interval of a method's ert: other instances might have been drawn, each with all its runs."""
    mine = _of(table, name)
    paid, won = mine["reached_at"].fillna(mine["charged"]), mine["reached_at"].notna()
    block = [mine[column] for column in BLOCK]
    units = (each.groupby(block).sum().to_numpy(dtype=float)[:, None] for each in (paid, won))
    low, high = ert_interval(*units)
    return float(low[0]), float(high[0])


def winners(table: pd.DataFrame) -> dict[str, str]:
    """Return knows -> the name of the method that stands first among those that are told so much."""
    found = standing(table)
    return {kind: str(mine["name"].iloc[0]) for kind in KNOWS if len(mine := found[found["knows"] == kind])}


def ranked(table: pd.DataFrame) -> tuple[Ranked, list[str]]:
    """Return Friedman's test over the blocks of one budget, and the methods left out as they lack some blocks.

    Within a block who reached the level earlier is better, and of those that did not, who came nearer to it.
    """
    score = _scores(table)
    matrix = score.groupby([*BLOCK, "name"])["score"].median().unstack("name")
    lacking = sorted(matrix.columns[matrix.isna().any()])
    whole = matrix.drop(columns=lacking)
    return friedman(Blocks(tuple(whole.columns), whole.to_numpy())), lacking


def curves(table: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Return the share of runs that have reached the level at each charge: columns name, charged, share."""
    found = []
    for name in names:
        mine = _of(table, name)
        at = np.sort(mine["reached_at"].dropna().to_numpy())
        share = np.arange(1, len(at) + 1) / len(mine)
        found.append(pd.DataFrame({"name": name, "charged": at, "share": share}))
    return pd.concat(found, ignore_index=True)


def _of(table: pd.DataFrame, name: str) -> pd.DataFrame:
    return table[[named(*key) == name for key in zip(table["method"], table["ends"], strict=True)]]


def _scores(table: pd.DataFrame) -> pd.DataFrame:
    beyond = np.log10(table["excess"].clip(1e-300, 1e300)).fillna(300) + 400  # keeps the order, above 0
    never = _NEVER * beyond.where(np.isfinite(table["excess"]), 1000)
    names = [named(*key) for key in zip(table["method"], table["ends"], strict=True)]
    return table.assign(score=table["reached_at"].fillna(never), name=names)
