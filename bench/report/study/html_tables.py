"""The tables of a study's page, and the words around them: methods, printed numbers, failures, where runs come from.

A run that failed reached nothing; one that was ended by its time limit keeps what it reached, as
`bench.statistics.summary.goal_hits` counts them. In the tables of a summary `failed` is both together.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from operator import itemgetter
from typing import Any, final

import numpy as np
import pandas as pd

from calibench.bench.execution.answer import PREFIX, heading
from calibench.bench.report.shared.page import Head, Table, macros
from calibench.bench.report.study import figures
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import CELL, PROBLEM, parted
from calibench.bench.statistics.names import (
    method_labels,
    method_titles,
    name_of_each,
    problem_titles,
    setting_text,
    several,
)
from calibench.bench.statistics.optimum import Optimum, optimum_of
from calibench.bench.statistics.progress import without_numbers
from calibench.bench.statistics.ranking import LEVEL, Ranked, best_first
from calibench.bench.statistics.summary import priced as priced_runs
from calibench.bench.statistics.targets import COLUMN
from calibench.bench.store.columns import parts
from calibench.core.words import counted, listed

CELLS = "report/study/templates/cells.html.j2"
Costs = Sequence[Mapping[str, Any]]  # records of `bench.sweep.costs`
_SHOWN = 8  # names in a cell, beyond which they are counted
_TALL = 48  # rows from which on a table scrolls in a box of its own height
_CALLS = {
    "value_s": "a value", "batch_s": "a candidate in a batch of 100", "residuals_s": "residuals",
    "jacobian_s": "a Jacobian", "gradient_s": "a gradient", "joint_s": "a value with its gradient",
}  # fmt: skip
_SLOPES = ("jacobian_s", "gradient_s")


def number(value: float, digits: int = 2) -> str:
    """Return a number in few digits; a dash where there is none.

    >>> number(1.93e-25), number(0.0), number(float("nan"))
    ('1.9e-25', '0', '–')
    """
    return f"{value:.{digits}g}" if isfinite(value) else "–"


def count(value: float) -> str:
    """Return a count of evaluations with its thousands apart; a dash where there is none.

    >>> count(50_000_000.0), count(float("nan"))
    ('50\\u202f000\\u202f000', '–')
    """
    return f"{value:,.0f}".replace(",", "\u202f") if isfinite(value) else "–"


def table(heads: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]]) -> Table:
    """Return the table of these (title, cell class) and cells; what is no number nor a reason stays in one line."""
    return Table([Head(title, kind or "w") for title, kind in heads], rows, tall=len(rows) > _TALL)


def methods(runs: pd.DataFrame, names: pd.Series, costs: Costs = (), cells: pd.DataFrame | None = None) -> Table:
    """Return the methods on one problem, under each error function the best first; `names` are by index of `runs`."""
    # out of `cells` where those hold it: to make the summary anew costs ten times as much
    cells = stats.summary(runs, costs) if cells is None else runs[CELL].drop_duplicates().merge(cells, on=CELL)
    rows: list[list[str]] = []
    settings = several(runs)
    measured = runs["kmrmse_aligned"].notna().any()
    goals = any(goal_text(mine, optimum_of(mine)) for _, mine in by_error(runs))
    priced = priced_runs(runs, costs).notna().any()
    merits = cells.filter(like=PREFIX).dropna(axis=1, how="all")
    noisy = runs["judged_evaluations"].notna().any()
    heads = [("optimiser", ""), *((column, "n") for column in settings)]
    heads += [("at the goal", ""), ("share, 95 %", ""), ("evaluations to it", "n")] if goals else [("runs", "")]
    heads += [("best, median", "n"), ("quartiles", "n"), ("spent", "n"), ("seconds", "n")]
    heads += [("of these the objective's", "n")] if priced else []
    heads += [("lowest seen, median", "n")] if noisy else []
    heads += [("kmrmse* [mm]", "n")] if measured else []
    heads += [(heading(str(key)), "n") for key in merits]
    for _, mine in by_error(runs):
        known = optimum_of(mine)
        goal = goal_text(mine, known)
        rows.append([f"{known.heading} · {f'goal {goal}' if goal else 'no goal is known'}"])
        mine_cells = ranked(mine, names, mine[CELL].drop_duplicates().merge(cells, on=CELL))
        late = mine[mine["status"] == "timeout"].groupby(CELL, dropna=False).size().rename("late").reset_index()
        for cell in mine_cells.merge(late, on=CELL, how="left").fillna({"late": 0}).to_dict("records"):
            low, middle, high = (known.text(cell[f"best_{key}"]) for key in ("q1", "median", "q3"))
            options = parts(json.loads(cell["optimizer_options"]), classes=False).items()
            row = [macros(CELLS).hint(cell["method"], ", ".join(stats.option_text(*option) for option in options))]
            for column in settings:
                value = cell[column]
                row.append(count(value) if column == "budget" else str(value) if column == "start" else number(value))
            row.append(_reached(cell))
            if goals:  # the share of runs at the goal with its interval, as a drawing with the numbers beside it
                share = "–"
                if isfinite(cell["goal"]):
                    ends = (cell[name] for name in ("success_low", "success", "success_high"))
                    certain = not isfinite(cell["success_low"])
                    share = macros(CELLS).small("no chance in it") if certain else macros(CELLS).share(*ends)
                row += [share, count(cell["charged_to_target"])]
            row += [macros(CELLS).strong(middle), f"{low} .. {high}" if cell["runs"] > 1 else ""]
            row += [count(cell["charged_median"]), number(cell["wall_s_median"])]
            row += [number(cell["objective_s_median"])] if priced else []
            row += [number(cell["seen_median"], 6)] if noisy else []
            row += [number(cell["kmrmse_aligned_median"])] if measured else []
            row += [number(cell.get(key, float("nan")), 4) for key in merits]
            rows.append(row)
    return table(heads, rows)


def prices(runs: Sequence[tuple[str, pd.DataFrame]], known: Mapping[tuple[Any, ...], Mapping[str, Any]]) -> list[str]:
    """Return what a call of this problem takes, in words, under each error function; none where it is not known."""
    sentences = []
    for error, mine in runs if known else ():
        record = known.get(tuple(mine[name].iloc[0] for name in PROBLEM), {})
        value, parts = record.get("value_s"), []
        for kind, words in _CALLS.items():
            seconds = record.get(kind)
            if not seconds:
                continue
            units = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"))
            scale, unit = next(((s, u) for s, u in units if seconds >= s), (1e-9, "ns"))
            as_long = ""
            if value and kind in _SLOPES:
                charged = int(mine["dimension"].iloc[0])
                as_long = f", as long as {number(seconds / value)} values (it is charged {charged})"
            parts.append(f"{words} {number(seconds / scale, 3)} {unit}{as_long}")
        if parts:
            sentences.append(f"{error + ': one' if error else 'One'} call takes: {'; '.join(parts)}.")
    return sentences


def by_error(runs: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Return (error function, its runs) in order; problems without one have ''."""
    return sorted(parted(runs, figures.errors_of(runs)).items(), key=itemgetter(0))


def ranked(runs: pd.DataFrame, names: pd.Series, cells: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the summary of these runs, a row a cell, best first on each task; all of `cells`, where it is given."""
    cells = stats.summary(runs) if cells is None else cells.copy()
    called = name_of_each(runs, names)
    cells["method"] = [called[pair] for pair in zip(cells["optimizer"], cells["optimizer_options"], strict=True)]
    return best_first(cells)


def printed_table(rows: pd.DataFrame, column_title: Callable[[str], str]) -> Table:
    """Return a printed table beside ours: a row a quantity, a column a method; without true values a row is both."""
    names = method_labels(rows.rename(columns={"method": "optimizer", "options": "optimizer_options"}))

    def cells(row: Mapping[Any, Any]) -> tuple[str, str, str, str]:
        """Return the quantity, what is printed (where it is wrong, crossed out, and what to read), ours, and why."""
        unit = "" if row["unit"] in ("1", "") else f" [{row['unit']}]"
        quantity = row["quantity"].removesuffix(f" as {row['unit']}") + unit
        printed = number(row["printed"], 7)
        if isfinite(row["printed"]) and isfinite(row["read"]) and row["read"] != row["printed"]:
            printed = macros(CELLS).misprint(printed, number(row["read"], 7))
        digits = 7 if isfinite(row.get("true", float("nan"))) and row["true"] else 3
        spread = f"{number(row['q1'], 4)} .. {number(row['q3'], 4)}" if row["n"] > 1 else ""
        ours = macros(CELLS).over(number(row["median"], digits), spread)
        quantity, why = (str(text).replace("^2", "²").replace("^4", "⁴") for text in (quantity, row["why"]))
        return quantity, printed, ours, macros(CELLS).small(why) if isinstance(row["why"], str) else ""

    lines: list[list[str]] = []
    records = [(name, row, cells(row)) for name, row in zip(names, rows.to_dict("records"), strict=True)]
    if "true" not in rows:
        heads = [("method", ""), ("quantity", ""), ("printed", "n"), ("ours", "n"), ("n", "n"), ("why", "why")]
        for name, row, (quantity, printed, ours, why) in records:
            lines.append([name, quantity, printed, ours, str(row["n"]), why])
        return table(heads, lines)
    methods = list(dict.fromkeys(names))
    heads = [("quantity", ""), ("true", "n"), ("printed", "n"), *((name, "n") for name in methods), ("why", "why")]
    parts: dict[str, dict[str, list[int]]] = {}  # places of the records by table and quantity
    for place, (_, row, _) in enumerate(records):
        parts.setdefault(row["table"], {}).setdefault(row["quantity"], []).append(place)
    for key, part in parts.items():
        lines.append([column_title(key)])
        for places in part.values():
            _, row, (quantity, printed, _, why) = records[places[0]]
            by_method = {records[place][0]: records[place][2][2] for place in places}
            true, each = number(row["true"], 7), (by_method.get(name, "–") for name in methods)
            lines.append([quantity, true, printed, *each, why])
    return table(heads, lines)


def failures(runs: pd.DataFrame) -> Table:
    """Return what failed, a row for each problem, method and reason; errors alike but for numbers are one reason."""
    failed = runs[runs["status"] != "ok"]
    errors = failed["error"].fillna("")
    failed = failed.assign(
        method=method_titles(runs)[failed.index], name=problem_titles(runs)[failed.index],
        reason=errors.map(lambda text: " ".join(text.split())), alike=errors.map(without_numbers),
        kind=failed["error_type"].fillna(""),
    )  # fmt: skip
    rows = []
    settings = several(runs)
    keys = ["name", "method", "status", "kind", "alike", *settings]
    for key, same in failed.groupby(keys, sort=False, dropna=False):
        name, method, status, kind = (str(part) for part in key[:4])
        reason = str(same.sort_values("repetition")["reason"].iloc[0])
        under = ", ".join(setting_text(column, value) for column, value in zip(settings, key[5:], strict=True))
        again = ", ".join(str(r) for r in sorted(same["repetition"]))
        cells = [macros(CELLS).over(method, under), macros(CELLS).tag(f"✗ {status}", "no")]
        rows.append([name, *cells, macros(CELLS).reason(reason, kind), again, count(same["charged"].max())])
    heads = [("problem", ""), ("optimiser", ""), ("status", ""), ("reason", "why"), ("repetitions", ""), ("spent", "n")]
    return table(heads, rows)


def goal_text(runs: pd.DataFrame, known: Optimum) -> str:
    """Return the level that counts as success, in words; several where the runs had their own; '' where none."""
    goals = set(stats.goals_of(runs).tolist())
    levels = [
        f"{known.level(goal)}{', the rounding floor' if known.is_floor(goal) else ''}"
        for goal in sorted(goal for goal in goals if isfinite(goal))
    ]
    seen = ", the lowest value seen to rounding" if COLUMN in runs and runs[COLUMN].any() else ""
    return ", ".join(levels) + seen


def _reached(cell: Mapping[Any, Any]) -> str:
    total, won, late, outside = cell["runs"], cell["reached"], int(cell["late"]), cell["outside_box"]
    lost = [(f"✗ {n} {what}", "no") for n, what in ((cell["failed"], "failed"), (late, "ended by the time limit")) if n]
    if cell["failed"] == total:
        tags = [(f"✗ {total}/{total} failed", "no")]
    elif not isfinite(cell["goal"]):
        tags = [(counted(total, "run"), "open"), *lost]
    else:
        mark, style = ("✓", "ok") if won == total else ("◐", "misprint") if won else ("○", "open")
        tags = [(f"{mark} {won}/{total}", style), *lost]
    tags += [(f"◇ {outside} outside the box", "misprint")] if outside else []
    return macros(CELLS).tags(tags)


@final
@dataclass(frozen=True)
class Differing:
    """A sentence on the test, and a row a method, best first."""

    sentence: str
    table: Table


def differing(ranked: Ranked) -> Differing:
    """Return the table of a test that was not refused: mean ranks, p-values after correction, and who differs."""
    alike = ranked.nemenyi >= LEVEL
    np.fill_diagonal(alike, False)
    differ = int((~alike).sum() - len(ranked.methods)) // 2
    pairs = len(ranked.methods) * (len(ranked.methods) - 1) // 2
    level = f"{100 * LEVEL:g} %"
    sentence = (
        f"Friedman's test over {counted(ranked.blocks, 'block')} (a problem with its instance under one start, at "
        f"its largest budget; seeds are none): p = {number(ranked.p)}. "
        + (
            f"Of {counted(pairs, 'pair')} of methods {differ} differ at the {level} level (Nemenyi's test, which is "
            f"corrected for all pairs): mean ranks that are {number(ranked.critical_difference, 3)} apart or more."
            if ranked.p < LEVEL
            else f"The ranks do not tell the methods apart at the {level} level, and what pairs say is not to be read."
        )
        + (f" {ranked.left_out}." if ranked.left_out else "")
    )
    heads = [
        ("method", ""), ("mean rank", "n"), ("p against the first, Holm", "n"), ("p against the first, Nemenyi", "n"),
        ("differs from", "why"), ("not told apart from", "why"),
    ]  # fmt: skip
    others, rows = len(ranked.methods) - 1, []
    for i, name in enumerate(ranked.methods):
        which = []
        for same in (False, True):
            at = [other for j, other in enumerate(ranked.methods) if j != i and alike[i, j] == same]
            told = "all others" if len(at) == others > 1 else listed(at, _SHOWN) or "none"
            which.append(macros(CELLS).parted(told))
        against = number(ranked.nemenyi[0, i]) if i else "–"
        rows.append([name, f"{ranked.mean_ranks[i]:.2f}", number(ranked.against_best[i]), against, *which])
    return Differing(sentence, table(heads, rows))


@final
@dataclass(frozen=True)
class Lost:
    """How many of some runs failed, and how many were ended by their time limit."""

    failed: int
    late: int

    def sentence(self, of: int | None = None) -> str:
        """Return both counts in words, `of` so many runs; "" where every run ended well.

        >>> Lost(2, 0).sentence()
        '2 runs failed and count as not arrived'
        >>> Lost(0, 1).sentence(of=8)
        '1 of 8 runs was ended by its time limit and keeps what it reached'
        """
        failed = "failed and counts" if self.failed == 1 else "failed and count"
        late = ("was", "its", "keeps", "it") if self.late == 1 else ("were", "their", "keep", "they")
        counts = (
            (self.failed, f"{failed} as not arrived"),
            (self.late, "{} ended by {} time limit and {} what {} reached".format(*late)),
        )
        whole = "" if of is None else f" of {counted(of, 'run')}"
        return "; ".join(f"{f'{n}{whole}' if whole else counted(n, 'run')} {what}" for n, what in counts if n)


def lost_of(runs: pd.DataFrame) -> Lost:
    """Return how many of the runs failed and how many were late."""
    late = int((runs["status"] == "timeout").sum())
    return Lost(int((runs["status"] != "ok").sum()) - late, late)


def origin(runs: pd.DataFrame) -> dict[str, str]:
    """Return where the runs come from: commits, Python, machines, begun (to the minute), and versions of packages."""
    found: dict[str, list[str]] = {}
    for text in runs["versions"].dropna().unique():
        for package, version in json.loads(text).items():
            if version and version not in found.setdefault(package, []):
                found[package].append(version)
    versions = {package: " / ".join(several) for package, several in found.items() if several}
    commits = runs[["git_commit", "git_dirty"]].drop_duplicates().to_numpy().tolist()
    began, begun = runs["started_at"].dropna(), ""
    if not began.empty:
        first, last = f"{began.min():%Y-%m-%d %H:%M}", f"{began.max():%Y-%m-%d %H:%M}"
        begun = f"{first} UTC" if first == last else f"{first} to {last} UTC"
    return {
        "commits": ", ".join(f"{c[:10]}{' with uncommitted changes' if d is True else ''}" for c, d in commits if c),
        "python": versions.get("python", ""), "machines": ", ".join(runs["platform"].dropna().unique()), "begun": begun,
        "versions": ", ".join(f"{package} {several}" for package, several in versions.items()),
    }  # fmt: skip
