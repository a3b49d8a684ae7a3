"""The head of a study's page: how much was run under which budget, and which methods reached the goal where."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, final

import numpy as np
import pandas as pd

from calibench.bench.report.shared.page import Table
from calibench.bench.report.study import figures
from calibench.bench.report.study import html_tables as study_tables
from calibench.bench.report.study import origin as study_origin
from calibench.bench.report.study.answer import Answer
from calibench.bench.report.study.explored.data import Panel
from calibench.bench.report.study.html_tables import count
from calibench.bench.report.study.lost import lost_of
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, mixed_code
from calibench.bench.statistics.names.labels import setting_text
from calibench.core.counted import plural


@final
@dataclass(frozen=True)
class Fact:
    """A number at the head of the page, and what it counts; a `bad` one has a mark."""

    value: str
    what: str
    kind: str = ""


@final
@dataclass(frozen=True)
class Headline:
    """The values of the head of a study's page, in words; `lost` is empty where every run ended well.

    `merit`, `condition` and `money` tell whether the page says anything of these.
    """

    about: str
    answer: Answer
    facts: Sequence[Fact]
    made: str
    cells: str
    runs: str
    starts: str
    budgets: Sequence[str]
    untold: bool  # whether there are published runs, which tell no budget
    lost: str
    mixed: str
    merit: bool
    condition: bool
    money: bool


def headline(
    runs: pd.DataFrame,
    planned: Collection[str],
    in_other_shards: Collection[str],
    about: str,
    answer: Answer,
    condition: bool = False,
    money: bool = False,
) -> Headline:
    """Return the head of the page: the counts, where the runs come from, and what was compared.

    `planned` are the ids of the runs that the study is to have, `in_other_shards` of those that other shards of the
    same sweep have and this study has not, `about` is a sentence on a prepared one, `answer` the
    three sentences. `condition` and `money` tell whether the page says anything of the one and the other.
    """
    lost = lost_of(runs)
    budgets = [count(b) for b in sorted(set(runs["budget"].dropna()))]
    cells = runs.groupby(CELL, dropna=False).size()
    seeds = str(cells.max()) if cells.min() == cells.max() else f"{cells.min()} to {cells.max()}"
    left = len(set(planned) - set(runs["run_id"]))
    methods, problems = (len(runs[columns].drop_duplicates()) for columns in (METHOD, PROBLEM))
    facts = [
        Fact(count(len(runs)), plural("run", len(runs))),
        Fact(count(lost.failed), "failed", "bad" if lost.failed else ""),
        *([Fact(count(lost.late), "ended by the time limit", "bad")] if lost.late else []),
        *([Fact(" / ".join(budgets), "evaluations a run, at most")] if budgets else []),
        Fact(seeds, f"{plural('seed', cells.max())} a cell"), Fact(str(problems), plural("problem", problems)),
        Fact(str(methods), plural("optimiser", methods)),
        Fact(str(len(cells)), plural("cell", len(cells))),
    ]  # fmt: skip
    facts += [Fact(count(left), "planned, not done yet", "bad")] if left else []
    away = len(in_other_shards)
    facts += [Fact(count(away), "of other shards, not here", "bad")] if away else []
    made = {
        "commit": study_origin.commits(runs),
        "Python": " / ".join(study_origin.versions(runs).get("python", [])),
        "on": study_origin.machines(runs),
        "begun": study_origin.began(runs),
    }
    starts = " and ".join(f"the {s}" for s in sorted(set(runs["start"].dropna().astype(str))))
    starts = f"{starts} start{'s' if ' and ' in starts else ''}" if starts else ""
    untold = "starts that are not told" if runs["start"].isna().any() else ""  # of published runs
    return Headline(
        about=about,
        answer=answer,
        facts=facts,
        made=" · ".join(f"{key} {value}" for key, value in made.items() if value),
        cells=things(len(cells), "cell"),
        runs=things(len(runs), "run"),
        starts=" and ".join(filter(None, (starts, untold))),
        budgets=budgets,
        untold=bool(runs["budget"].isna().any()),
        lost=lost.told(len(runs)),
        mixed=mixed_code(runs),
        merit=bool(runs["kmrmse_aligned"].notna().any()),
        condition=condition,
        money=money,
    )


def contents(panels: Sequence[Panel], names: pd.Series, summary: pd.DataFrame) -> Table:
    """Return a row a problem and error, linked to its section.

    `names` of the methods are by index of the runs, `summary` is that of all runs
    (`bench.statistics.summary.summary`).
    """
    rows = []
    goals = bool(summary["goal"].notna().any())
    errors = any(panel.error for panel in panels)  # functions of the error, of which a problem may have several
    late = any(lost_of(panel.runs).late for panel in panels)
    every = pd.concat([panel.runs[METHOD] for panel in panels])
    ranked = study_tables.ranked(every, names, summary)
    by_problem: dict[tuple[str, ...], list[dict[Any, Any]]] = {}
    for cell in ranked.to_dict("records"):
        by_problem.setdefault(tuple(cell[column] for column in PROBLEM), []).append(cell)
    above = ""
    for panel in panels:
        title, mine, optimum = panel.title, panel.runs, panel.optimum
        cells = by_problem[tuple(mine[column].iloc[0] for column in PROBLEM)]
        told = [c for c in SETTING if len({None if cell[c] != cell[c] else cell[c] for cell in cells}) > 1]
        won = sorted((cell for cell in cells if cell["success"] == 1.0), key=itemgetter("charged_to_target"))
        known = any(cell["goal"] == cell["goal"] for cell in cells)
        lowest = min(cells, key=itemgetter("best_median"))
        lost = lost_of(mine)
        best = won[0] if won else lowest
        called = ", ".join([best["method"], *(setting_text(c, best[c]) for c in told)])
        found = np.isfinite(lowest["best_median"])
        first = (
            f"{called}, {count(best['charged_to_target'])} evaluations"
            if won
            else "none: every run failed"
            if (mine["status"] == "failed").all() and not found
            else "none: of every method half of the runs or more found no value"
            if not found
            else f"{'none; ' if known else ''}lowest median: {called}, {optimum.told(lowest['best_median'])}"
        )
        rows.append(
            [
                "" if title == above else study_tables.cell_macros().link(title, f"#{panel.anchor}"),
                *([panel.error or "f"] if errors else []), str(int(mine["dimension"].iloc[0])),
                str(len({tuple(cell[column] for column in METHOD) for cell in cells})), str(len(cells)),
                *([str(len(won)) if known else "–"] if goals else []), first,
                *(_marked(number) for number in (lost.failed, lost.late)[: 1 + late]),
            ]
        )  # fmt: skip
        above = title
    heads = [
        ("problem", ""), *([("error", "")] if errors else []), ("parameters", "n"), ("methods", "n"), ("cells", "n"),
        *([("at the goal in every run", "n")] if goals else []),
        ("fewest evaluations to the goal" if goals else "best", "why"), ("failed runs", "n"),
        *([("ended by the time limit", "n")] if late else []),
    ]  # fmt: skip
    return study_tables.table(heads, rows)


def _marked(number: int) -> str:
    told: str = study_tables.cell_macros().tag(f"✗ {number}", "no") if number else "0"
    return told  # as it is: `str` of it would be set as text


def anchor(title: str) -> str:
    """Return the name of a problem's section."""
    return f"problem-{figures.file_name(title)}"


def things(n: int, what: str) -> str:
    """Return a count with what is counted."""
    return f"{count(n)} {plural(what, n)}"
