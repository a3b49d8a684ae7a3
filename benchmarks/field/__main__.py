"""``python -m benchmarks.field RESULTS``: write docs/field.md from a result folder of the study `field`."""

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
    """Write the page of the folder that the command line names."""
    parser = argparse.ArgumentParser(prog="benchmarks.field", description="Write the page of the field.")
    parser.add_argument("results", type=Path, help="folder of the runs, such as results/field")
    parser.add_argument("--page", type=Path, default=Path("docs/field.md"), help="page to write")
    chosen = parser.parse_args()
    chosen.page.write_text(page(ResultStore(chosen.results).runs()))


def page(runs: pd.DataFrame) -> str:
    """Return the page: how the table was made, and the field method by method."""
    cells = counted(runs)
    problems = list(dict.fromkeys(cells.sort_values("dimension", kind="stable")["problem"]))
    kinds: dict[tuple[str, ...], list[str]] = {}  # method and cells -> how it ends
    for (method, ends), mine in cells.groupby(["method", "ends"], sort=False):
        by = mine.set_index("problem")
        shown = (_cell(by.loc[name]) if name in by.index else _NOT_RUN for name in problems)
        kinds.setdefault((str(method), *shown), []).append(str(ends) or "spends it")
    alike: dict[tuple[str, ...], list[str]] = {}  # how they end and cells -> methods
    for (method, *line), ends in kinds.items():
        alike.setdefault((", ".join(ends), *line), []).append(f"`{method}`")
    rows = [[", ".join(methods), *line] for line, methods in alike.items()]
    blocks = [
        "# The field",
        text(
            f"Every method of the registry on {len(problems)} problems at {int(runs['budget'].max())} evaluations from"
            " random starts: how many runs reached the goal (the last target), and, where not all did, the median of"
            " the best value. What has the same cells shares a row. A local method is shown in two kinds: as it"
            " *stops* by its test, and as it *restarts* at random points, the same for all, until the budget is spent."
            " A method that draws nothing and ignores its start runs once."
            f" {_NOT_RUN}: was not run, or cannot run there. {_CUT}: the time limit ended some of the runs."
        ),
        "```text\nbench run study=field execution=processes\npython -m benchmarks.field results/field\n```",
        text(f"{_made(runs)}."),
        table([*_HEAD, *problems], rows),
    ]
    return "\n\n".join(blocks) + "\n"


def counted(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each method, kind and problem: runs, those at the goal, those cut off, and the best value.

    Columns: method, ends ("stops", "restarts" or ""), problem, dimension, runs, reached, cut (by the time limit) and
    best (the median). Methods by name, problems by dimension.
    """
    ends = endings(runs)
    named = runs.assign(
        method=runs["optimizer"],
        ends=ends,
        restarts=ends == "restarts",
        hit=np.isfinite(stats.goal_hits(runs)),
        late=runs["status"] == "timeout",
    )
    cells = named.groupby(["method", "restarts", "problem"], as_index=False).agg(
        ends=("ends", "first"), dimension=("dimension", "first"), runs=("run_id", "size"), reached=("hit", "sum"),
        best=("best_value", "median"), cut=("late", "sum"),
    )  # fmt: skip
    return cells.sort_values(["method", "restarts", "dimension", "problem"], kind="stable", ignore_index=True)


def _cell(cell: pd.Series) -> str:
    best = "" if cell["reached"] == cell["runs"] else f" {cell['best']:.0e}"
    return f"{cell['reached']:.0f}/{cell['runs']:.0f}{best}{_CUT if cell['cut'] else ''}"


def _made(runs: pd.DataFrame) -> str:
    """Return which code made the runs, and when."""
    commits = ", ".join(sorted({str(commit)[:7] for commit in runs["git_commit"].dropna()})) or "unknown"
    day = str(runs["started_at"].min())[:10]
    methods = runs["optimizer"].nunique()
    return f"Commit {commits}, {day}, {len(runs)} runs of {methods} methods"


if __name__ == "__main__":
    main()
