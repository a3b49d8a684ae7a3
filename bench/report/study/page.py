"""``report.html``: one study as a page that a researcher reads alone, offline: what was compared, and what came out.

The summary first, then a section a problem with its table and figures, printed tables beside ours where somebody adds
them (`bench.report.study.additions`), what failed, how to do it again. No script, nothing fetched: drawings are inside.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench import problems
from calibench.bench.report.shared.page import Table, drawing_inside
from calibench.bench.report.shared.templating import render
from calibench.bench.report.study import figures
from calibench.bench.report.study import headline as study_summary
from calibench.bench.report.study import html_tables as study_tables
from calibench.bench.report.study import origin as study_origin
from calibench.bench.report.study.additions import FilledSection, PrintedTable
from calibench.bench.report.study.headline import anchor, things
from calibench.bench.report.study.html_tables import number
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.labels import in_order, method_labels
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.priced import priced
from calibench.core.registry import about

_BROAD = 620.0  # points from which on a drawing scrolls on a small screen rather than shrink
_OVERVIEW = "Every method on every problem"


@final
@dataclass(frozen=True)
class StudyPage:
    """What a page is made of: the runs, printed tables beside ours, drawings as (name, SVG path), and the manifest.

    `identifiability` is `bench.statistics.tables.identifiability(runs)`, `about` a sentence on a prepared study,
    `beside` links to other pages: words -> address, `captions` those of added figures: name -> caption.
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

    def html(self) -> str:
        """Return the page."""
        name = self.folder.resolve().name
        names = stats.method_names(self.runs)
        groups = _problems(self.runs)
        money = bool(priced(self.runs, self._costs).notna().any())
        cells = stats.summary(self.runs, self._costs)
        return render(
            "report/study/templates/study.html.j2",
            title=name,
            head=study_summary.headline(
                self.runs, len(groups), self.manifest.get("planned", {}), self.about,
                condition=not self.identifiability.empty, money=money,
            ),
            contents=study_summary.contents(groups, names, cells),
            links=self._links(),
            overview=_OVERVIEW,
            problems=[self._problem(title, group, names, cells) for title, group in groups.items()],
            sections=[(section, [_printed(*one) for one in filled]) for section, filled in self.sections],
            beside=self._beside(),
            failures=study_tables.failures(self.runs),
            commands=[str(command) for command in self.manifest.get("commands", [])],
            report=shlex.join(["bench", "report", str(self.folder)]),
            provenance=self._provenance(),
            drawings={name: drawing_inside(path, name) for name, path in self.drawings.items()},
            broad=_BROAD,
        )  # fmt: skip

    @property
    def _costs(self) -> Sequence[Mapping[str, Any]]:
        return list(self.manifest.get("costs", []))

    def _links(self) -> Mapping[str, str]:
        links = {section.link: f"#{section.anchor}" for section, _ in self.sections}
        links |= {"figures beside the runs": "#beside"} if self._beside() else {}
        links |= {"failures": "#failures", "how to do it again": "#again", "where this comes from": "#provenance"}
        return {**links, **self.beside}

    def _problem(self, title: str, runs: pd.DataFrame, names: pd.Series, cells: pd.DataFrame) -> _Problem:
        name = str(runs["problem"].iloc[0])
        described = about(problems.registry.factories()[name]) if name in problems.registry.names() else ""
        remarks = [
            described.replace("`", ""),
            *self._visible(runs),
            *(optimum_of(mine).remark() for _, mine in study_tables.by_error(runs)),
            *study_tables.prices(runs, self._costs),
        ]
        return _Problem(
            title,
            anchor(title),
            figures.file_name(title),
            f"{things(len(runs), 'run')}, {things(int(runs['dimension'].iloc[0]), 'parameter')}",
            [remark for remark in remarks if remark],
            study_tables.methods(runs, names, self._costs, cells),
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
    """The section of a problem; `label` is what the names of its figures end in."""

    title: str
    anchor: str
    label: str
    size: str
    remarks: Sequence[str]
    methods: Table


def _printed(printed: PrintedTable, rows: pd.DataFrame) -> tuple[str, Table]:
    named = rows.rename(columns={"method": "optimizer", "options": "optimizer_options"})
    return printed.title, study_tables.printed_table(rows, method_labels(named), printed.column_title)


def _problems(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs by what shares a figure: a problem and its options but the error function, smallest first."""
    groups = figures.panels_of(runs)
    return dict(sorted(groups.items(), key=lambda item: (int(item[1]["dimension"].iloc[0]), in_order(item[0]))))
