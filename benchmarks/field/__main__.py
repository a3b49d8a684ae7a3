"""``python -m benchmarks.field BEFORE AFTER``: write docs/field.md from two result folders of the study `field`.

A method is its name and whether it restarts: what its other options are may have changed in between, which is what the
page is to show.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from calibench.bench import ResultStore
from calibench.bench.report.shared.page import table, text
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.summary import endings

_NOT_RUN = "–"
_CUT = "†"
_HEAD = ("method", "ends")


def main() -> None:
    """Compare the two folders that the command line names and write the page."""
    parser = argparse.ArgumentParser(prog="benchmarks.field", description="Compare two runs of the field.")
    parser.add_argument("before", type=Path, help="folder of the earlier runs, such as results/field")
    parser.add_argument("after", type=Path, help="folder of the later runs")
    parser.add_argument("--page", type=Path, default=Path("docs/field.md"), help="page to write")
    chosen = parser.parse_args()
    before, after = (ResultStore(folder).runs() for folder in (chosen.before, chosen.after))
    chosen.page.write_text(page(before, after))


def page(before: pd.DataFrame, after: pd.DataFrame) -> str:
    """Return the page: how each table was made, what moved, and both fields method by method."""
    cells = compared(before, after)
    problems = list(dict.fromkeys(cells["problem"]))
    budget = int(after["budget"].max())
    rows = []
    for (method, ends), mine in cells.groupby(["method", "ends"], sort=False):
        by = mine.set_index("problem")
        told = [_both(by.loc[name]) if name in by.index else _NOT_RUN for name in problems]
        rows.append([f"`{method}`", ends or "spends it", *told])
    blocks = [
        "# The field, before and after",
        text(
            f"Every method of the registry on {len(problems)} problems at {budget} evaluations from random starts: how"
            " many runs reached the goal (the last target), and the median of the best value; before → after. A local"
            " method is shown in two kinds: as it *stops* by its own test, with budget left, and as it *restarts* at"
            " random points, the same for all, until the budget is spent. A method that draws nothing and ignores its"
            f" start runs once. {_NOT_RUN}: was not run, or cannot run there. {_CUT}: the time limit ended some of the"
            " runs, and how far they came depends on the machine."
        ),
        "```text\nbench run study=field execution=processes results=BEFORE   # on the code before, then after\n"
        "python -m benchmarks.field BEFORE/field AFTER/field\n```",
        text(f"Before: {_made(before)}. After: {_made(after)}."),
        text(_moved(cells)),
        table([*_HEAD, *problems], rows),
    ]
    return "\n\n".join(blocks) + "\n"


def compared(before: pd.DataFrame, after: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each method, kind and problem: runs, those at the goal, those cut off, and the best value.

    Columns: method, ends ("stops", "restarts" or ""), problem, and runs, reached, cut (by the time limit) and best (the
    median) with the endings _before and _after, NaN where there were none. Methods by name, problems by dimension.
    """
    keys = ["method", "restarts", "problem"]
    old, new = (_cells(runs) for runs in (before, after))
    both = old.merge(new, on=keys, how="outer", suffixes=("_before", "_after"))
    both["ends"] = both["ends_after"].fillna(both["ends_before"])
    both["dimension"] = both["dimension_after"].fillna(both["dimension_before"])
    both = both.sort_values(["method", "restarts", "dimension", "problem"], kind="stable", ignore_index=True)
    order = {name: place for place, name in enumerate(both.sort_values("dimension", kind="stable")["problem"].unique())}
    both = both.sort_values("problem", key=lambda names: names.map(order), kind="stable")
    both = both.sort_values(["method", "restarts"], kind="stable", ignore_index=True)
    sides = [f"{what}_{when}" for when in ("before", "after") for what in ("runs", "reached", "cut", "best")]
    return both[["method", "ends", "problem", *sides]]


def _cells(runs: pd.DataFrame) -> pd.DataFrame:
    ends = endings(runs)
    named = runs.assign(
        method=runs["optimizer"],
        ends=ends,
        restarts=ends == "restarts",
        hit=np.isfinite(stats.goal_hits(runs)),
        late=runs["status"] == "timeout",
    )
    return named.groupby(["method", "restarts", "problem"], as_index=False).agg(
        ends=("ends", "first"), dimension=("dimension", "first"), runs=("run_id", "size"), reached=("hit", "sum"),
        best=("best_value", "median"), cut=("late", "sum"),
    )  # fmt: skip


def _both(cell: pd.Series) -> str:
    old, new = (_side(cell, when) for when in ("before", "after"))
    return f"{old} → {new}" if old != new else f"{old} ="


def _side(cell: pd.Series, when: str) -> str:
    runs, reached, cut, best = (cell[f"{what}_{when}"] for what in ("runs", "reached", "cut", "best"))
    return f"{reached:.0f}/{runs:.0f} {best:.0e}{_CUT if cut else ''}" if pd.notna(runs) else _NOT_RUN


def _moved(cells: pd.DataFrame) -> str:
    """Return how many methods as they are, restarts aside, reach the goal more or less often than before."""
    known = cells[cells["runs_before"].notna() & cells["runs_after"].notna()]
    totals = known.groupby(["method", "ends"])[["reached_before", "runs_before", "reached_after", "runs_after"]].sum()
    change = totals["reached_after"] / totals["runs_after"] - totals["reached_before"] / totals["runs_before"]
    more, less = (sorted({name for name, _ in change[chosen].index}) for chosen in (change > 0, change < 0))
    said = f"Of {len(totals)} methods run both times {len(more)} reach the goal more often, {len(less)} less often"
    named = "; ".join(
        f"{word}: {', '.join(f'`{name}`' for name in names)}"
        for word, names in (("more", more), ("less", less))
        if names
    )
    return f"{said} ({named})." if named else f"{said}."


def _made(runs: pd.DataFrame) -> str:
    """Return which code made the runs, and when."""
    commits = ", ".join(sorted({str(commit)[:7] for commit in runs["git_commit"].dropna()})) or "unknown"
    day = str(runs["started_at"].min())[:10]
    methods = runs["optimizer"].nunique()
    return f"commit {commits}, {day}, {len(runs)} runs of {methods} methods"


if __name__ == "__main__":
    main()
