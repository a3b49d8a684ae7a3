"""``report.html``: one study as a page that a researcher reads alone, offline: what was compared, and what came out.

The answer first, then all problems together, then a section a problem with its tables and charts, printed tables beside
ours where somebody adds them (`bench.report.study.additions`), what failed, how to do it again. Nothing is fetched:
what is drawn, and the scripts that draw it, are inside. Without scripts the tables and drawings stand in their place.

The head of a study's page: how much was run under which budget, and which methods reached the goal where.
"""

from __future__ import annotations

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
from calibench.bench.report.shared.page import Inline, Table, drawing_inside, render
from calibench.bench.report.study import figures
from calibench.bench.report.study import html_tables as study_origin
from calibench.bench.report.study import html_tables as study_tables
from calibench.bench.report.study.additions import FilledSection, PrintedTable
from calibench.bench.report.study.answer import Answer, answer_of
from calibench.bench.report.study.explored import Panel, as_json, explored, licence, policy, scripts
from calibench.bench.report.study.html_tables import count, differing, lost_of, number
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, mixed_code
from calibench.bench.statistics.names import in_order, method_labels, setting_text
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.priced import key_of_costs, priced
from calibench.bench.statistics.ranking import Ranked
from calibench.bench.store.manifest import in_other_shards
from calibench.bench.store.schema import HITS_SCHEMA, TRACES_SCHEMA
from calibench.core.registry import about
from calibench.core.words import plural

_OPENED = 2  # problems up to which the section of each stands open
_TABLED = 1500  # cells up to which tables are inside as text; of more the script draws those of a problem on demand
_ROOM = 1_300_000  # characters that drawings may take in all; the others are linked
_LARGEST = 2_900_000  # characters of a page, where leaving drawings out can make it so
_BROAD = 620.0  # points from which on a drawing scrolls on a small screen rather than shrink
_UNTOLD = [
    "best_x",
    "at_bound",
    "parameter_names",
    "parameter_values",
    "parameter_units",
    "parameter_starts",
    "parameter_truths",
    "hits",
    "hits_charged",
    "error",
    "error_type",
    "traceback",
    "versions",
    "platform",
    "git_commit",
    "git_dirty",
    "code_digest",
    "library",
    "library_version",
    "seed",
]  # columns of which the section of a problem says nothing, and of which thousands of slices are dear
_OVERVIEW = "Every method on every problem"


@final
@dataclass(frozen=True)
class StudyPage:
    """What a page is made of: the runs, printed tables beside ours, drawings as (name, SVG path), and the manifest.

    `identifiability` is `bench.statistics.tables.identifiability(runs)`, `about` a sentence on a prepared study,
    `beside` links to other pages: words -> address, `captions` those of added figures: name -> caption. `traces` and
    `hits` (`bench.statistics.targets.hits_of`) are what is drawn on demand, `summary` that of the runs (made here where
    it is not given), `together` the drawings of all problems: name -> caption, `ranked` is
    Friedman's test of the methods, where there are blocks enough.
    """

    folder: Path
    runs: pd.DataFrame
    sections: Sequence[FilledSection] = ()
    identifiability: pd.DataFrame = field(default_factory=pd.DataFrame)
    drawings: Mapping[str, Path] = field(default_factory=dict)
    manifest: Mapping[str, Any] = field(default_factory=dict)
    about: str = ""
    beside: Mapping[str, str] = field(default_factory=dict)
    captions: Mapping[str, str] = field(default_factory=dict)
    traces: pd.DataFrame = field(default_factory=lambda: TRACES_SCHEMA.empty_table().to_pandas())
    hits: pd.DataFrame = field(default_factory=lambda: HITS_SCHEMA.empty_table().to_pandas())
    summary: pd.DataFrame = field(default_factory=pd.DataFrame)
    together: Mapping[str, str] = field(default_factory=dict)
    ranked: Ranked | None = None

    def html(self) -> str:
        """Return the page."""
        name = self.folder.resolve().name
        names = stats.method_names(self.runs)
        groups = problems_of(self.runs.drop(columns=_UNTOLD, errors="ignore"))
        money = bool(priced(self.runs, self._costs).notna().any())
        cells = stats.summary(self.runs, self._costs) if self.summary.empty else self.summary
        first = answer_of(self.runs, self.traces, self.manifest, names, cells)
        panels = [
            Panel(title, error, anchor(title), mine, optimum_of(mine))
            for title, group in groups.items()
            for error, mine in study_tables.by_error(group)
        ]
        numbers: dict[str, list[int]] = {}
        for i, panel in enumerate(panels):
            numbers.setdefault(panel.title, []).append(i)
        described = {
            name: about(problems.registry.factories()[name]).replace("`", "")
            for name in set(self.runs["problem"]) & set(problems.registry.names())
        }
        tabled = len(cells) <= _TABLED
        priced_problems = {key_of_costs(record): record for record in self._costs}
        page = partial(
            render,
            "report/study/templates/study.html.j2",
            title=name,
            policy=policy(),
            scripts=scripts(),
            licence=licence(),
            numbers=as_json(explored(panels, self.traces, self.hits, cells, name)),
            head=headline(
                self.runs, self.manifest.get("planned", {}), self._in_other_shards(),
                self.about, first, condition=not self.identifiability.empty, money=money,
            ),
            contents=contents(panels, names, cells),
            links=self._links(),
            overview=_OVERVIEW,
            problems=[
                self._problem(title, group, names, cells, numbers[title], panels, described, tabled, priced_problems)
                for title, group in groups.items()
            ],
            opened=_OPENED,
            differ=None if self.ranked is None or self.ranked.refused else differing(self.ranked),
            together=self.together,
            sections=[(section, [_printed(*one) for one in filled]) for section, filled in self.sections],
            beside=self._beside(),
            failures=study_tables.failures(self.runs),
            commands=[str(command) for command in self.manifest.get("commands", [])],
            report=shlex.join(["bench", "report", str(self.folder)]),
            provenance=self._provenance(),
            broad=_BROAD,
        )  # fmt: skip
        text = self._with_drawings(page, _ROOM)
        return text if len(text) <= _LARGEST else self._with_drawings(page, _ROOM - (len(text) - _LARGEST))

    def _with_drawings(self, page: Callable[..., str], room: int) -> str:
        inside, linked = self._drawings(room)
        return page(drawings=inside, linked=linked)

    def _drawings(self, room: int) -> tuple[Mapping[str, Inline], Mapping[str, str]]:
        """Return the drawings inside the page by name, and the address of those beyond `room` characters."""
        inside: dict[str, Inline] = {}
        linked = {}
        left = room
        for name, path in self.drawings.items():
            drawing = drawing_inside(path, name)
            size = len(drawing.svg or drawing.png)
            if size <= left:
                inside[name] = drawing
                left -= size
            else:
                linked[name] = f"{path.parent.name}/{path.name}"
        return inside, linked

    def _in_other_shards(self) -> set[str]:
        """Return the ids of the runs of this sweep that other shards have and this study has not."""
        return in_other_shards(self.manifest, set(self.runs["run_id"])) if self.manifest else set()

    @property
    def _costs(self) -> Sequence[Mapping[str, Any]]:
        return list(self.manifest.get("costs", []))

    def _links(self) -> Mapping[str, str]:
        links = {"all problems together": "#suite", "each problem": "#contents"}
        links |= {section.link: f"#{section.anchor}" for section, _ in self.sections}
        links |= {"figures beside the runs": "#beside"} if self._beside() else {}
        links |= {"failures": "#failures", "how to do it again": "#again", "where this comes from": "#provenance"}
        return {**links, **self.beside}

    def _problem(
        self,
        title: str,
        runs: pd.DataFrame,
        names: pd.Series,
        cells: pd.DataFrame,
        numbers: Sequence[int],
        panels: Sequence[Panel],
        described: Mapping[str, str],
        tabled: bool,
        priced_problems: Mapping[tuple[Any, ...], Mapping[str, Any]],
    ) -> _Problem:
        mine = [panels[i] for i in numbers]
        remarks = [
            described.get(str(runs["problem"].iloc[0]), ""),
            *self._visible(runs),
            *(panel.optimum.remark() for panel in mine),
            *study_tables.prices([(panel.error, panel.runs) for panel in mine], priced_problems),
        ]
        return _Problem(
            title,
            anchor(title),
            figures.file_name(title),
            f"{things(len(runs), 'run')}, {things(int(runs['dimension'].iloc[0]), 'parameter')}",
            [remark for remark in remarks if remark],
            numbers,
            study_tables.methods(runs, names, self._costs, cells) if tabled else None,
        )

    def _visible(self, runs: pd.DataFrame) -> list[str]:
        """Return what the data of this problem can tell, once for each error function where they differ."""
        if self.identifiability.empty:
            return []
        known = self.identifiability.drop_duplicates(PROBLEM[:2]).set_index(PROBLEM[:2])["finding"]
        said: dict[str, list[str]] = {}
        for problem, options in runs[PROBLEM[:2]].drop_duplicates().to_numpy():
            if (problem, options) in known.index:
                said.setdefault(known[problem, options], []).append(str(json.loads(options).get("error", "")))
        return [
            f"{', '.join(errors)}: {finding}" if len(said) > 1 else finding[:1].upper() + finding[1:]
            for finding, errors in said.items()
        ]

    def _beside(self) -> Mapping[str, str]:
        """Return the figures that belong to no problem: name -> caption."""
        return {name: told for name, told in self.captions.items() if name in self.drawings}

    def _provenance(self) -> Mapping[str, str]:
        versions = study_origin.versions(self.runs)
        return {
            "git commit": study_origin.commits(self.runs),
            "machine": study_origin.machines(self.runs),
            "versions": ", ".join(f"{package} {' / '.join(found)}" for package, found in versions.items()),
            "begun": study_origin.began(self.runs),
            "computing time": f"{number(self.runs['cpu_s'].sum(), 3)} s of processor, all runs together",
        }


@final
@dataclass(frozen=True)
class _Problem:
    """The section of a problem; `label` is what the names of its figures end in.

    `numbers` are those of its panels among what the script draws; `methods` is None where the script makes the table.
    """

    title: str
    anchor: str
    label: str
    size: str
    remarks: Sequence[str]
    numbers: Sequence[int]
    methods: Table | None


def _printed(printed: PrintedTable, rows: pd.DataFrame) -> tuple[str, Table]:
    named = rows.rename(columns={"method": "optimizer", "options": "optimizer_options"})
    return printed.title, study_tables.printed_table(rows, method_labels(named), printed.column_title)


def problems_of(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs by what shares a figure: a problem and its options but the error function, smallest first."""
    groups = figures.panels_of(runs)
    return dict(sorted(groups.items(), key=lambda item: (int(item[1]["dimension"].iloc[0]), in_order(item[0]))))


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
