"""The cells of a study on a terminal: methods on each problem, best first."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from calibench.bench.commands.console import print_table
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.names import several, titles_of_problems
from calibench.bench.statistics.ranking import order_of
from calibench.bench.statistics.summary import names_of_methods, runs_once
from calibench.bench.sweep.remarks import ONE_RUN
from calibench.core.words import print_plain as print

_SMALL, _LARGE = 1e-3, 1e6  # between which a number is read best without a power of ten


def best_of(summary: Mapping[Any, list[Any]], most: int) -> dict[Any, list[Any]]:
    """Return at most so many cells of a summary: as many of the best of each problem, none of too many problems."""
    tasks = list(zip(*(summary[name] for name in PROBLEM), strict=True))
    each = most // len(set(tasks))
    taken, kept = Counter[tuple[Any, ...]](), []
    for i in order_of(_with_methods(summary)).tolist():
        if taken[tasks[i]] < each:
            taken[tasks[i]] += 1
            kept.append(i)
    return {name: [column[i] for i in kept] for name, column in summary.items()}


def print_summary(summary: Mapping[Any, list[Any]], repeated: bool = False) -> None:
    named = _with_methods(summary)
    order = order_of(named).tolist()
    cells = {name: [column[i] for i in order] for name, column in named.items()}
    rows = [dict(zip(cells, row, strict=True)) for row in zip(*cells.values(), strict=True)]
    errors = [json.loads(text).get("error") for text in cells["problem_options"]]
    titles = titles_of_problems(zip(*(cells[name] for name in PROBLEM), strict=True), but=("error",))
    known, merit = (any(value == value for value in cells[name]) for name in ("goal", "kmrmse_aligned_median"))
    spread = max(cells["runs"]) > 1
    columns = {
        "problem": [f"{title} {error}" if error else title for title, error in zip(titles, errors, strict=True)],
        "optimizer": cells["method"],
        **{
            name: [str(v) if name == "start" else _or_dash(v, "g" if name == "target" else ".0f") for v in cells[name]]
            for name in several(cells)
        },
        "runs": [str(count) for count in cells["runs"]],
    }
    for name, column in (("failed", "failed"), ("out of time", "timeouts")):
        if any(row[column] for row in rows):
            columns[name] = [str(row[column]) if row[column] else "-" for row in rows]
    left_the_box = any(row["outside_box"] for row in rows)
    if left_the_box:
        columns["outside box"] = [f"◇ {row['outside_box']}" if row["outside_box"] else "-" for row in rows]
    if known:
        columns["reached"] = [f"{r['reached']}/{r['runs']}" if r["goal"] == r["goal"] else "-" for r in rows]
    columns["best median" if spread else "best"] = [text for [text] in best_texts(rows, "best_median")]
    if spread:
        several_runs = [row for row in rows if row["runs"] > 1]
        quartiles = iter(best_texts(several_runs, "best_q1", "best_q3"))
        columns["quartiles"] = [" .. ".join(next(quartiles)) if r["runs"] > 1 else "-" for r in rows]
    if known:
        columns["evaluations to target"] = [_or_dash(r["charged_to_target"], ".0f") for r in rows]
    if merit:
        columns["kmrmse*"] = [_or_dash(r["kmrmse_aligned_median"], ".1e") for r in rows]
    print_table(list(columns), [list(row) for row in zip(*columns.values(), strict=True)])
    legend = ["reached: the target of the run (target=), or else the problem's last"] if known else []
    legend += ["outside box: answers that lie outside lower .. upper"] if left_the_box else []
    legend += ["kmrmse*: mm, median, modulo the gauge"] if merit else []
    one = [row for row in rows if row["runs"] == 1 and not row["noisy"]] if spread or repeated else []
    if any(runs_once(row["optimizer"], row["optimizer_options"], str(row["start"])) for row in one):
        legend += [ONE_RUN]
    print("; ".join(legend), end="\n\n" if legend else "\n")


def _with_methods(summary: Mapping[Any, list[Any]]) -> dict[Any, list[Any]]:
    methods = names_of_methods(zip(summary["optimizer"], summary["optimizer_options"], strict=True))
    return {**summary, "method": methods}


def _or_dash(value: float, form: str) -> str:
    return f"{value:{form}}" if value == value else "-"


def best_texts(cells: Sequence[Mapping[Any, Any]], *columns: str) -> list[list[str]]:
    """Return the best values in `columns` of rows of `bench.statistics.summary.summary` as a terminal has them: f* and
    what is above it, or themselves, all of one precision.

    That is six digits where no value is very small or large; three and a power of ten where all are; six and a power
    where some are.

    >>> known = {"minimum": -3.2, "unit": "V", "noisy": False}
    >>> unknown = known | {"minimum": float("nan"), "unit": ""}
    >>> best_texts([known | {"best_median": -3.1999}, unknown | {"best_median": -3.1999}], "best_median")
    [['f*+1.0e-04 V'], ['-3.19990']]
    >>> best_texts([unknown | {"best_median": value} for value in (12.1, 6.184e-21)], "best_median")
    [['1.21000e+01'], ['6.18400e-21']]
    """
    # f*, above which the value is told; None: the value itself
    least = [float(c["minimum"]) if isfinite(c["minimum"]) and c["minimum"] and not c["noisy"] else None for c in cells]
    plain = [
        abs(float(cell[column]))
        for cell, low in zip(cells, least, strict=True)
        for column in columns
        if low is None or not isfinite(cell[column])
    ]
    usual = [_SMALL <= value < _LARGE for value in plain if isfinite(value) and value]
    form = "#.6g" if all(usual) else ".5e" if any(usual) else ".2e"
    texts = []
    for cell, low in zip(cells, least, strict=True):
        unit = f" {cell['unit']}" if cell["unit"] else ""
        values = [float(cell[column]) for column in columns]
        texts.append(
            [f"{v:{form}}{unit}" if low is None or not isfinite(v) else f"f*{v - low:+.1e}{unit}" for v in values]
        )
    return texts
