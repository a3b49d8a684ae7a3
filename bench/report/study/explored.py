"""What the page of a study draws by itself, on demand: its numbers as one compact block, and the scripts that draw.

Numbers are rounded to what an eye can see, and no statistic is computed from them: a page of ten thousand runs stays
below three megabytes. The plotting library is uPlot (MIT, see ``static/uPlot-LICENSE.txt``).
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any, final

import numpy as np
import pandas as pd
from markupsafe import Markup

from calibench.bench.statistics.cells import CELL, PROBLEM, by_number
from calibench.bench.statistics.fixed_target import Hits, ert, runtimes, success_intervals
from calibench.bench.statistics.names import method_labels
from calibench.bench.statistics.optimum import Optimum
from calibench.bench.statistics.ranking import methods_in_order
from calibench.bench.statistics.summary import QUARTILES, method_names, option_text, quantiles
from calibench.bench.store.arrays import give_back, places
from calibench.bench.store.columns import Array, parts

GOAL = "goal"  # the quantity of the one target that counts as success on a problem
_CURVES, _SHARES, _TARGETS = 110_000, 160_000, 60_000  # numbers of all cells together; each takes some six letters
_DIGITS = 4
_AT_ONCE = 250_000  # values of runs at a time: two megabytes
_QUANTITIES = {
    GOAL: ("the goal of each problem", "",
           "the level that counts as success: a run's own target, or the problem's, or where it has none the lowest "
           "value seen, if half of the runs of some method came to it"),
    "gap": ("distance to the best value", "",
            "best value minus the least one: the declared minimum of the problem, else the best that any run of this "
            "study found"),
    "noise": ("as good as the noise of the readings", "", "the value that the noise alone leaves at the truth"),
    "parameter_error_mm": ("parameter error", "mm", "the largest error of a length in the answer"),
    "parameter_error_rad": ("parameter error", "rad", "the largest error of an angle in the answer"),
    "parameter_error_mm_aligned": ("parameter error, aligned", "mm", "lengths, after the move that no reading sees"),
    "parameter_error_rad_aligned": ("parameter error, aligned", "rad", "angles, after the move that no reading sees"),
    "kmrmse": ("error of position", "mm", "root mean square over positions of the calibrated machine"),
    "kmrmse_aligned": ("error of position, aligned", "mm", "after the move of the whole machine that no reading sees"),
}  # fmt: skip  # quantity -> name, unit, what it is
LIBRARY = "uPlot.iife.min.js"
_OURS = ("state.js", "style.js", "chart.js", "draw.js", "sort.js", "controls.js", "page.js")


@final
@dataclass(frozen=True)
class Panel:
    """One problem under one error function: its runs, what is known of its least value, and its goal in words."""

    title: str
    error: str
    anchor: str
    runs: pd.DataFrame
    optimum: Optimum
    goal: str


def explored(
    panels: Sequence[Panel], traces: pd.DataFrame, hits: Hits, summary: pd.DataFrame, study: str
) -> dict[str, Any]:
    """Return the numbers of a study as plain values, for `as_json`."""
    panel_of = np.repeat(np.arange(len(panels)), [len(panel.runs) for panel in panels])
    runs = pd.concat([panel.runs for panel in panels], ignore_index=True).assign(panel=panel_of)
    runs["method"], runs["plain"] = method_labels(runs), method_names(runs)
    runs["cell"] = runs.groupby(CELL, sort=False, dropna=False).ngroup()
    first = runs.drop_duplicates("cell")
    numbers = first[[*CELL, "cell", "panel", "method"]].merge(summary, on=CELL, how="left")
    names = methods_in_order(runs, summary)
    groups = groups_of(runs)
    group_names = list(groups.unique())
    count = len(numbers)
    most = max(float(runs["charged"].max()), 2.0)
    at, costs = (  # counts evenly apart on a logarithmic axis, fewer where there is no room
        np.unique(np.round(np.geomspace(1, most, int(np.clip(room, 8, points))))).astype(np.int64).astype(float)
        for room, points in ((_CURVES // (3 * count), 90), (_SHARES // (2 * count), 120))
    )
    curves: list[Any] = [None] * count
    by_panel = by_number(panel_of)
    cells_of: list[list[int]] = []
    short = runs[["run_id", "cell"]]
    for i, traced in enumerate(traces_of(traces, [panel.runs for panel in panels])):
        mine = short.iloc[by_panel.rows(i)].reset_index(drop=True)
        counts: dict[Any, int] = mine["cell"].value_counts().to_dict()
        cells_of.append(list(counts))
        for cell, quartiles in bands(mine, traced, at).items():
            band = panels[i].optimum.above(np.where(np.isinf(quartiles), np.nan, quartiles))
            curves[cell] = [_row(band[k]) for k in ((1, 0, 2) if counts[cell] > 1 else (1,))]  # median, quartiles
    give_back()
    goals = dict(zip(numbers["cell"].tolist(), numbers["goal"].tolist(), strict=True))
    quantities = reached_targets(runs, hits, goals, costs)
    methods = []  # what each is called, in tables too (``plain``), and all its options
    for name in names:
        row = first[first["method"] == name].iloc[0]
        options = parts(json.loads(row["optimizer_options"]), classes=False).items()
        said = ", ".join([str(row["optimizer"]), *(option_text(*option) for option in options)])
        methods.append({"name": name, "plain": row["plain"], "options": said})

    def drawn(i: int) -> Array:
        """Return the values of the curves of a panel, medians and beside each its quartiles."""
        points = (point for cell in cells_of[i] for point in zip(*curves[cell], strict=True) if point[0] is not None)
        return np.array([value for point in points for value in point if value is not None], dtype=float)

    def above(name: str) -> list[float | None]:
        pairs = zip(numbers["panel"], numbers[f"best_{name}"])
        return [_short(float(panels[p].optimum.above(v))) if np.isfinite(v) else None for p, v in pairs]

    return {
        "study": study, "methods": methods, "groups": group_names if 1 < len(group_names) < len(panels) else [],
        "problems": [
            {
                "title": f"{panel.title} {panel.error}".strip(), "anchor": panel.anchor,
                "group": group_names.index(str(groups.iloc[by_panel.first[i]])),
                "parameters": int(panel.runs["dimension"].iloc[0]),
                "axis": panel.optimum.axis, "scale": panel.optimum.scale(drawn(i)),
                "goal": panel.goal, "noisy": panel.optimum.noisy,
                "floor": _short(panel.optimum.floor) if panel.optimum.floor else None,
            }
            for i, panel in enumerate(panels)
        ],
        "cells": {
            "problem": numbers["panel"].tolist(), "method": [names.index(name) for name in numbers["method"]],
            "runs": numbers["runs"].tolist(),
            "failed": (numbers["failed"] + numbers["timeouts"]).tolist(),  # or out of time: both are lost
            "spent": _row(runs.groupby("cell")["charged"].sum().reindex(numbers["cell"])),
            "seconds": _row(numbers["wall_s_median"]),
            **{name: above(name) for name in ("median", "q1", "q3")},
        },
        "at": at.tolist(), "curves": curves, "costs": costs.tolist(),
        "quantities": [_quantity(one, count) for one in quantities],
        "intervals": _intervals(numbers["runs"].to_numpy(), quantities),
    }  # fmt: skip


def as_json(values: Any) -> Markup:
    """Return values as JSON that may stand inside a script element, whatever words are in it.

    >>> str(as_json({"name": "</script>"}))
    '{"name":"\\\\u003c/script\\\\u003e"}'
    """
    text = json.dumps(values, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _quantity(one: Reached, cells: int) -> dict[str, Any]:
    """Return what a quantity is called, its targets, and lists of each cell, ended after the last target reached."""
    name, unit, what = _QUANTITIES.get(one.quantity, (one.quantity, "", ""))
    every = max(1, -(-cells * len(one.targets) // _TARGETS))
    chosen = np.unique([*range(0, len(one.targets), every), len(one.targets) - 1])
    reached = one.reached[:, chosen]
    last = [int(np.flatnonzero(row > 0)[-1]) + 1 if (row > 0).any() else 0 for row in reached]
    bounds = {
        key: [_row(row[chosen][:end]) for row, end in zip(values, last, strict=True)]
        for key, values in (("ert", one.ert), ("low", one.low), ("high", one.high))
    }
    counts = [
        None if np.isnan(row).all() else [0 if v != v else int(v) for v in row[:end]]
        for row, end in zip(reached, last, strict=True)
    ]
    share: list[list[int] | None] | None = None
    if one.share is not None:  # in thousandths, as fine as a line is drawn; None of a problem without such targets
        share = [None if np.isnan(row).any() else [int(v) for v in np.round(1000 * row)] for row in one.share]
    named = {"key": one.quantity, "name": name, "unit": unit, "what": what, "targets": _row(one.targets[chosen])}
    return {**named, "reached": counts, **bounds, "share": share}


def _intervals(counts: Array, quantities: Sequence[Reached]) -> Mapping[str, list[float | None]]:
    """Return ``k/n`` -> [low, high] in thousandths, Wilson's 95 % interval, for all pairs that the page shows."""
    pairs = {
        (int(k), int(n))
        for one in quantities
        for row, n in zip(one.reached, counts, strict=True)
        for k in np.unique(row[~np.isnan(row)])
    } | {(0, int(n)) for n in np.unique(counts)}
    if not pairs:
        return {}
    ordered = np.array(sorted(pairs), dtype=np.int64)
    low, high = success_intervals(ordered[:, 0], ordered[:, 1])
    return {
        f"{k}/{n}": [round(1000 * float(a), 1), round(1000 * float(b), 1)]
        for (k, n), a, b in zip(ordered.tolist(), low, high, strict=True)
    }


def _row(values: Any) -> list[float | None]:
    return [_short(value) for value in np.asarray(values, dtype=float).tolist()]


def _short(value: float | None) -> float | None:
    """Return a number to four digits, None where there is none.

    >>> _short(1234567.0), _short(0.000123456), _short(float("inf"))
    (1235000, 0.0001235, None)
    """
    if value is None or not np.isfinite(value):
        return None
    short = float(f"{value:.{_DIGITS}g}")
    return int(short) if short == int(short) and abs(short) < 1e15 else short


@final
@dataclass(frozen=True, kw_only=True)
class Reached:
    """Cells against the targets of a quantity, shape (cells, targets), NaN where there is none: `ert` with its 95 %
    interval [charged evaluations]; `share`, shape (cells, costs), of (run, target) pairs, None of a single target."""

    quantity: str
    targets: Array
    reached: Array
    ert: Array
    low: Array
    high: Array
    share: Array | None


def reached_targets(runs: pd.DataFrame, hits: Hits, goals: Mapping[int, float], costs: Array) -> list[Reached]:
    """Return what is known of each quantity in `hits`, the goal first."""
    cells = int(runs["cell"].max()) + 1
    table = ert(hits, runs)
    if table.empty:
        return []
    # the number of the cell of each row, in which the run's own target is ``target_value``
    keys = [column for column in CELL if column != "target"]
    known = runs.drop_duplicates("cell")
    numbers = known[[*keys, "cell"]].assign(own=known["target"].astype(float).fillna(-np.inf))
    rows = table[keys].assign(own=table["target_value"].astype(float).fillna(-np.inf))
    table["cell"] = np.asarray(rows.merge(numbers, on=[*keys, "own"], how="left")["cell"])
    shares: dict[str, Array] = {}
    for one in runtimes(hits, runs[["run_id", *PROBLEM, "cell", "charged", "evaluations"]]):
        cell_of, names = one.all_runs["cell"].to_numpy()[one.at], one.all_targets["quantity"].to_numpy()[one.level]
        for quantity in dict.fromkeys(names.tolist()):
            whole = shares.setdefault(str(quantity), np.full((cells, len(costs)), np.nan))
            for cell in dict.fromkeys(cell_of.tolist()):
                charged = one.of(cell_of == cell, names == quantity).charged
                at, count = np.unique(charged[charged >= 0], return_counts=True)
                within = np.cumsum([0, *count])[np.searchsorted(at.astype(float), costs, side="right")]
                whole[cell] = within / charged.size
    tables = []
    value = table[table["quantity"] == "value"]
    goal = value["cell"].map(goals).to_numpy(dtype=float)
    at_goal = value[value["target"].to_numpy(dtype=float) == goal]
    if len(at_goal):
        tables.append(_table(GOAL, at_goal.assign(target=0.0), cells, np.zeros(1), None))
    for quantity, rows in table[table["quantity"] != "value"].groupby("quantity", sort=False):
        name = str(quantity)
        if name == "noise":  # one target a problem, each of its own level
            tables.append(_table(name, rows.assign(target=0.0), cells, np.zeros(1), None))
            continue
        targets = np.sort(rows["target"].unique())[::-1].astype(float)
        tables.append(_table(name, rows, cells, targets, shares.get(name)))
    return tables


def _table(quantity: str, rows: pd.DataFrame, cells: int, targets: Array, share: Array | None) -> Reached:
    column = np.searchsorted(-targets, -rows["target"].to_numpy(dtype=float))
    filled = {}
    for name in ("reached", "ert", "ert_low", "ert_high"):
        filled[name] = np.full((cells, len(targets)), np.nan)
        filled[name][rows["cell"].to_numpy(dtype=np.int64), column] = rows[name].to_numpy(dtype=float)
    return Reached(
        quantity=quantity, targets=targets, reached=filled["reached"], ert=filled["ert"], low=filled["ert_low"],
        high=filled["ert_high"], share=share,
    )  # fmt: skip


def bands(runs: pd.DataFrame, traces: pd.DataFrame, at: Array) -> Mapping[int, Array]:
    """Return q1, median, q3 after `at` charged evaluations, shape (3, counts), for each number in the column `cell`:
    NaN before all its runs have begun, infinite where too few have a value. A run that has ended keeps its last."""
    cell_of, cells = pd.factorize(runs["cell"])
    row = places(traces["run_id"], runs["run_id"])
    column = np.searchsorted(at, traces["charged"].to_numpy()).astype(np.int32)  # the first count that knows a point
    traced = np.zeros(len(runs), dtype=bool)
    traced[row[row >= 0]] = True
    known = (row >= 0) & (column < len(at))
    row, column = row[known], column[known]
    values = np.append(traces["best_value"].to_numpy(dtype=float)[known], np.nan)  # the last before a run has begun
    cell = cell_of[row].astype(np.int32)
    order = np.argsort(cell, kind="stable").astype(np.int32)  # a trace keeps the order in which it was written
    ends = np.searchsorted(cell[order], np.arange(len(cells) + 1))
    place = np.empty(len(runs), dtype=np.int32)  # within its cell
    bands = {}
    for number, (low, high) in enumerate(pairwise(ends.tolist())):
        mine, points = np.flatnonzero(cell_of == number), order[low:high]
        place[mine] = np.arange(len(mine))
        last = np.full((len(at), len(mine)), -1, dtype=np.int32)  # point of each run until then
        last[column[points], place[row[points]]] = points  # of several the last
        np.maximum.accumulate(last, axis=0, out=last)
        band = np.full((3, len(at)), np.nan)
        step = max(1, _AT_ONCE // len(mine))
        for begin in range(0, len(at), step):
            stack = values[last[begin : begin + step]]
            stack[:, ~traced[mine]] = np.inf  # it ended before its first evaluation
            whole = np.flatnonzero(~np.isnan(stack).any(axis=1))
            if len(whole):
                band[:, begin + whole] = quantiles(stack[whole].T, QUARTILES)
        bands[int(cells[number])] = band
    return bands


def traces_of(traces: pd.DataFrame, panels: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """Return the traces of the runs of each of `panels`, their ids as a category of its own."""
    ids = [runs["run_id"].drop_duplicates() for runs in panels]
    begins = np.cumsum([0, *map(len, ids)])
    row = places(traces["run_id"], pd.concat(ids))
    panel = np.repeat(np.arange(len(panels) + 1, dtype=np.int32), [*map(len, ids), 1])[row]  # the last: of no panel
    order = np.argsort(panel, kind="stable")
    ends = np.cumsum([0, *np.bincount(panel, minlength=len(panels))])
    pieces = []
    for mine, begin, (low, high) in zip(ids, begins.tolist(), pairwise(ends[: len(panels) + 1].tolist())):
        at = order[low:high]
        together = high > low and at[-1] - at[0] == high - low - 1  # as a store has them: no copy is needed
        piece = traces.iloc[slice(at[0], at[-1] + 1) if together else at]
        pieces.append(piece.assign(run_id=pd.Categorical.from_codes(row[at] - begin, pd.Index(mine))))
    return pieces


def groups_of(runs: pd.DataFrame) -> pd.Series:
    """Return the group of each run's problem: its `problem_group`, where it declares one, else its name."""
    names = runs["problem"].astype(str)
    declared = runs["problem_group"].fillna("").astype(str) if "problem_group" in runs else names
    return declared.where(declared != "", names)


@cache
def scripts() -> Sequence[Markup]:
    """Return the texts of the page's scripts: the library, then ours as one."""
    ours = "\n".join(read_static(name) for name in _OURS)
    return Markup(read_static(LIBRARY)), Markup(f'(function () {{\n"use strict";\n{ours}}})();\n')


@cache
def policy() -> str:
    """Return the content security policy of the page: nothing is fetched, and no script runs but `scripts`."""
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts()]
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def read_static(name: str) -> str:
    return files("calibench.bench").joinpath("report", "study", "static", name).read_text(encoding="utf-8")
