"""``report.html``: one study as a page that a researcher reads alone, offline: what was compared, and what came out.

The answer first, then all problems together, a section a problem, printed tables beside ours where somebody adds them
(`bench.report.study.additions`), what failed, how to do it again. Nothing is fetched: what draws is inside.
"""

import json
import shlex
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.report.shared.page import Inline, Table, drawing_inside, macros, render
from calibench.bench.report.study import figures, html_tables
from calibench.bench.report.study.additions import FilledSection
from calibench.bench.report.study.answer import Answer, answer_of
from calibench.bench.report.study.explored import Panel, as_json, explored, policy, read_static, scripts
from calibench.bench.report.study.html_tables import count, goal_text, lost_of, number
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, mixed_code
from calibench.bench.statistics.fixed_target import Hits
from calibench.bench.statistics.names import in_order, setting_text
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.ranking import Ranked
from calibench.bench.statistics.summary import key_of_costs, priced
from calibench.bench.store.arrays import HITS_SCHEMA, TRACES_SCHEMA, give_back
from calibench.bench.store.columns import plain
from calibench.bench.store.manifest import in_other_shards
from calibench.core.registry import about
from calibench.core.words import plural

_OPENED = 2  # problems up to which the section of each stands open
_TABLED = 1500  # cells up to which tables are inside as text; of more the script draws those of a problem on demand
_ROOM = 1_300_000  # characters that drawings may take in all; the others are linked
_LARGEST = 2_900_000  # characters of a page, where leaving drawings out can make it so
_BROAD = 620.0  # points from which on a drawing scrolls on a small screen rather than shrink


@final
@dataclass(frozen=True, kw_only=True)
class StudyPage:
    """What a page is made of; `drawings()` are name -> files, an SVG first; `about` is a sentence on a prepared study,
    `beside` words -> address of other pages, `captions` of added figures and `together`, of all problems, name ->
    caption."""

    folder: Path
    runs: pd.DataFrame
    sections: Sequence[FilledSection] = ()
    identifiability: pd.DataFrame = field(default_factory=pd.DataFrame)
    drawings: Callable[[], Mapping[str, Sequence[Path]]] = dict
    manifest: Mapping[str, Any] = field(default_factory=dict)
    about: str = ""
    beside: Mapping[str, str] = field(default_factory=dict)
    captions: Mapping[str, str] = field(default_factory=dict)
    traces: pd.DataFrame = field(default_factory=lambda: TRACES_SCHEMA.empty_table().to_pandas())
    hits: Hits = field(default_factory=lambda: Hits.of(HITS_SCHEMA.empty_table()))
    summary: pd.DataFrame = field(default_factory=pd.DataFrame)
    together: Mapping[str, str] = field(default_factory=dict)
    ranked: Ranked | None = None

    def html(self) -> str:
        runs, name = self.runs, self.folder.resolve().name
        costs: Sequence[Mapping[str, Any]] = list(self.manifest.get("costs", []))
        by_problem = {key_of_costs(record): record for record in costs}
        names = stats.method_names(runs)
        groups = figures.panels_of(runs.drop(columns=figures.UNUSED, errors="ignore"))  # the smallest first
        groups = dict(sorted(groups.items(), key=lambda one: (int(one[1]["dimension"].iloc[0]), in_order(one[0]))))
        cells = stats.summary(runs, costs) if self.summary.empty else self.summary
        panels: list[Panel] = []
        sections = []
        described = {
            name: about(problems.registry.factories()[name]).replace("`", "")
            for name in {*runs["problem"].unique()} & {*problems.registry.names()}
        }
        for title, group in groups.items():
            by_error = html_tables.by_error(group)
            label = figures.file_name(title)  # what the names of its figures end in
            anchor = f"problem-{label}"
            known = [(error, some, optimum_of(some)) for error, some in by_error]
            mine = [Panel(title, error, anchor, some, it, goal_text(some, it)) for error, some, it in known]
            remarks = [
                described.get(str(group["problem"].iloc[0]), ""), *self._visible(group),
                *(panel.optimum.remark() for panel in mine),
                *html_tables.prices([(panel.error, panel.runs) for panel in mine], by_problem),
            ]  # fmt: skip
            sections.append(
                {
                    "title": title, "anchor": anchor, "label": label,
                    "size": f"{things(len(group), 'run')}, {things(int(group['dimension'].iloc[0]), 'parameter')}",
                    "remarks": [remark for remark in remarks if remark],
                    # of its panels among what the script draws, which also makes the table where there is none
                    "numbers": range(len(panels), len(panels) + len(mine)),
                    "methods": html_tables.methods(group, names, costs, cells) if len(cells) <= _TABLED else None,
                }
            )  # fmt: skip
            panels += mine
        # the runs of this sweep that other shards have and this study has not
        others = in_other_shards(self.manifest, {*plain(runs["run_id"])}) if self.manifest else set()
        links = {"all problems together": "#suite", "each problem": "#contents"}
        links |= {section.link: f"#{section.anchor}" for section, _ in self.sections}
        links |= {"figures beside the runs": "#beside"} if self.captions else {}
        links |= {"failures": "#failures", "how to do it again": "#again", "where this comes from": "#provenance"}
        origin = html_tables.origin(runs)
        numbers = as_json(explored(panels, self.traces, self.hits, cells, name))
        give_back()
        page = partial(
            render, "report/study/templates/study.html.j2", title=name, policy=policy(), scripts=scripts(),
            licence=read_static("uPlot-LICENSE.txt").strip(),
            numbers=numbers,
            head=headline(
                runs, self.manifest.get("planned", {}), others, self.about,
                answer_of(runs, self.traces, self.manifest, names, cells),
                condition=not self.identifiability.empty, money=bool(priced(runs, costs).notna().any()),
                goals=dict.fromkeys(panel.goal for panel in panels if panel.goal),
            ),
            contents=contents(panels, names, cells), links={**links, **self.beside},
            overview="Every method on every problem", problems=sections, opened=_OPENED,
            differ=None if self.ranked is None or self.ranked.refused else html_tables.differing(self.ranked),
            sections=[
                (section, [(one.title, html_tables.printed_table(rows, one.column_title)) for one, rows in filled])
                for section, filled in self.sections
            ],
            together=self.together, beside=self.captions, broad=_BROAD, failures=html_tables.failures(runs),
            commands=[str(command) for command in self.manifest.get("commands", [])],
            report=shlex.join(["bench", "report", str(self.folder)]),
            provenance={
                "git commit": origin["commits"], "machine": origin["machines"], "versions": origin["versions"],
                "begun": origin["begun"],
                "computing time": f"{number(runs['cpu_s'].sum(), 3)} s of processor, all runs together",
            },
        )  # fmt: skip
        text = self._with_drawings(page, _ROOM)
        return text if len(text) <= _LARGEST else self._with_drawings(page, _ROOM - (len(text) - _LARGEST))

    def _with_drawings(self, page: Callable[..., str], room: int) -> str:
        """Return the page with drawings inside, and links to those beyond `room` characters."""
        inside: dict[str, Inline] = {}
        linked = {}
        for name, (path, *_) in self.drawings().items():
            drawing = drawing_inside(path, name)
            size = len(drawing.svg or drawing.png)
            if size <= room:
                inside[name] = drawing
                room -= size
            else:
                linked[name] = f"{path.parent.name}/{path.name}"
        return page(drawings=inside, linked=linked)

    def _visible(self, runs: pd.DataFrame) -> list[str]:
        """Return what the data of this problem can tell, once for each error function where they differ."""
        if self.identifiability.empty:
            return []
        known = self.identifiability.drop_duplicates(PROBLEM[:2]).set_index(PROBLEM[:2])["finding"]
        errors_of: dict[str, list[str]] = {}
        for problem, options in runs[PROBLEM[:2]].drop_duplicates().to_numpy():
            if (problem, options) in known.index:
                errors_of.setdefault(known[problem, options], []).append(str(json.loads(options).get("error", "")))
        return [
            f"{', '.join(errors)}: {finding}" if len(errors_of) > 1 else finding[:1].upper() + finding[1:]
            for finding, errors in errors_of.items()
        ]


def headline(
    runs: pd.DataFrame, planned: Collection[str], in_other_shards: Collection[str], about: str, answer: Answer,
    condition: bool = False, money: bool = False, goals: Collection[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """Return the values of the head of the page: the counts, where the runs come from, and what was compared."""
    lost = lost_of(runs)
    budgets = [count(b) for b in sorted(set(runs["budget"].dropna()))]
    cells = runs.groupby(CELL, dropna=False).size()
    seeds = str(cells.max()) if cells.min() == cells.max() else f"{cells.min()} to {cells.max()}"
    to_do, away = len({*planned} - {*plain(runs["run_id"])}), len(in_other_shards)
    methods, problems = (len(runs[columns].drop_duplicates()) for columns in (METHOD, PROBLEM))
    facts = [  # a number, what it counts, and "bad" where it has a mark
        (count(len(runs)), plural("run", len(runs)), ""),
        (count(lost.failed), "failed", "bad" if lost.failed else ""),
        *([(count(lost.late), "ended by the time limit", "bad")] if lost.late else []),
        *([(" / ".join(budgets), "evaluations a run, at most", "")] if budgets else []),
        (seeds, f"{plural('seed', cells.max())} a cell", ""),
        (str(problems), plural("problem", problems), ""),
        (str(methods), plural("optimiser", methods), ""),
        (str(len(cells)), plural("cell", len(cells)), ""),
        *((goal, "is the goal", "") for goal in goals if len(goals) == 1),  # of several each table has its own
        *([(count(to_do), "planned, not done yet", "bad")] if to_do else []),
        *([(count(away), "of other shards, not here", "bad")] if away else []),
    ]
    open_ = runs["minimum"].isna().to_numpy()  # where the best value of the study stands for it, as one in the box
    names = stats.method_names(runs)
    away_of = names[stats.outside_box(runs) & open_].value_counts()
    origin = html_tables.origin(runs)
    made = {"commit": "commits", "Python": "python", "on": "machines", "begun": "begun"}
    starts = " and ".join(f"the {s}" for s in sorted(set(runs["start"].dropna().astype(str))))
    starts = f"{starts} start{'s' if ' and ' in starts else ''}" if starts else ""
    no_start = "starts that are not told" if runs["start"].isna().any() else ""  # of published runs
    return {
        "about": about, "answer": answer, "facts": facts,
        "made": " · ".join(f"{word} {origin[name]}" for word, name in made.items() if origin[name]),
        "cells": things(len(cells), "cell"), "runs": things(len(runs), "run"),
        "starts": " and ".join(filter(None, (starts, no_start))), "budgets": budgets,
        "without_budget": bool(runs["budget"].isna().any()),  # of published runs, which tell none
        "lost": lost.sentence(len(runs)),  # empty where every run ended well
        "outside": [f"{count(n)} of the {count(int((names == name).sum()))} of {name}" for name, n in away_of.items()],
        "mixed": mixed_code(runs), "merit": bool(runs["kmrmse_aligned"].notna().any()), "condition": condition,
        "money": money,
    }  # fmt: skip


def contents(panels: Sequence[Panel], names: pd.Series, summary: pd.DataFrame) -> Table:
    """Return a row a problem and error, linked to its section; `names` of the methods are by index of the runs."""
    rows, cell_macros = [], macros(html_tables.CELLS)
    goals = bool(summary["goal"].notna().any())
    errors = any(panel.error for panel in panels)  # functions of the error, of which a problem may have several
    late = any(lost_of(panel.runs).late for panel in panels)
    every = pd.concat([panel.runs[METHOD] for panel in panels])
    ranked = html_tables.ranked(every, names, summary)
    by_problem: dict[tuple[str, ...], list[dict[Any, Any]]] = {}
    for cell in ranked.to_dict("records"):
        by_problem.setdefault(tuple(cell[column] for column in PROBLEM), []).append(cell)
    above = ""
    for panel in panels:
        title, mine, optimum = panel.title, panel.runs, panel.optimum
        cells = by_problem[tuple(mine[column].iloc[0] for column in PROBLEM)]
        settings = [c for c in SETTING if len({None if cell[c] != cell[c] else cell[c] for cell in cells}) > 1]
        won = sorted((cell for cell in cells if cell["success"] == 1.0), key=itemgetter("charged_to_target"))
        known = any(cell["goal"] == cell["goal"] for cell in cells)
        lowest = min(cells, key=itemgetter("best_median"))
        lost = lost_of(mine)
        best = won[0] if won else lowest
        called = ", ".join([best["method"], *(setting_text(c, best[c]) for c in settings)])
        has_value = np.isfinite(lowest["best_median"])
        first = (
            f"{called}, {count(best['charged_to_target'])} evaluations"
            if won
            else "none: every run failed"
            if (mine["status"] == "failed").all() and not has_value
            else "none: of every method half of the runs or more found no value"
            if not has_value
            else f"{'none; ' if known else ''}lowest median: {called}, {optimum.sentence(lowest['best_median'])}"
        )
        rows.append(
            [
                "" if title == above else cell_macros.link(title, f"#{panel.anchor}"),
                *([panel.error or "f"] if errors else []), str(int(mine["dimension"].iloc[0])),
                str(len({tuple(cell[column] for column in METHOD) for cell in cells})), str(len(cells)),
                *([str(len(won)) if known else "–"] if goals else []), first,
                *(cell_macros.tag(f"✗ {n}", "no") if n else "0" for n in (lost.failed, lost.late)[: 1 + late]),
            ]
        )  # fmt: skip
        above = title
    heads = [
        ("problem", ""), *([("error", "")] if errors else []), ("parameters", "n"), ("methods", "n"), ("cells", "n"),
        *([("at the goal in every run", "n")] if goals else []),
        ("fewest evaluations to the goal" if goals else "best", "why"), ("failed runs", "n"),
        *([("ended by the time limit", "n")] if late else []),
    ]  # fmt: skip
    return html_tables.table(heads, rows)


def things(n: int, what: str) -> str:
    return f"{count(n)} {plural(what, n)}"
