"""``report.html``: one study as a page that a researcher reads alone, offline: what was compared, and what came out.

The answer first, then all problems together, then a section a problem with its tables and charts, printed tables beside
ours where somebody adds them (`bench.report.study.additions`), what failed, how to do it again. Nothing is fetched:
what is drawn, and the scripts that draw it, are inside. Without scripts the tables and drawings stand in their place.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench import problems
from calibench.bench.report.shared.page import Inline, Table, drawing_inside
from calibench.bench.report.shared.templating import render
from calibench.bench.report.study import figures
from calibench.bench.report.study import headline as study_summary
from calibench.bench.report.study import html_tables as study_tables
from calibench.bench.report.study import origin as study_origin
from calibench.bench.report.study.additions import FilledSection, PrintedTable
from calibench.bench.report.study.answer import answer_of
from calibench.bench.report.study.differing import differing
from calibench.bench.report.study.explored.data import Panel, as_json, explored
from calibench.bench.report.study.explored.script import licence, policy, scripts
from calibench.bench.report.study.headline import anchor, things
from calibench.bench.report.study.html_tables import number
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.comparison.many_methods import Ranked
from calibench.bench.statistics.names.labels import in_order, method_labels
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.priced import key_of_costs, priced
from calibench.bench.store.manifest import in_other_shards
from calibench.bench.store.schema import HITS_SCHEMA, TRACES_SCHEMA
from calibench.core.registry import about

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
            head=study_summary.headline(
                self.runs, self.manifest.get("planned", {}), self._in_other_shards(),
                self.about, first, condition=not self.identifiability.empty, money=money,
            ),
            contents=study_summary.contents(panels, names, cells),
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
