"""``report.html``: one study as a page that a researcher reads alone, offline: what was compared, and what came out.

The summary first, then a section a problem with its table and figures, printed tables beside ours where somebody adds
them (`bench.report.study.additions`), what failed, how to do it again. No script, nothing fetched: drawings are inside.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench import problems
from calibench.bench.report.shared.page import STYLE, drawing_inside, facts, whole_page
from calibench.bench.report.study import figures
from calibench.bench.report.study import headline as study_summary
from calibench.bench.report.study import html_tables as study_tables
from calibench.bench.report.study import origin as study_origin
from calibench.bench.report.study.additions import FilledSection
from calibench.bench.report.study.headline import anchor, things
from calibench.bench.report.study.html_tables import number
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.labels import in_order, method_labels
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.sweep import costs
from calibench.core.registry import about

_BROAD = 620.0  # points from which on a drawing scrolls on a small screen rather than shrink
_STYLE = f"""{STYLE}
h1{{margin-bottom:.2rem}}h2{{border-top:1px solid #ddd;padding-top:1.4rem}}h3{{margin:1.6rem 0 .4rem}}
.lead{{font-size:1.08rem;max-width:62rem}}p{{max-width:62rem;margin:.5rem 0}}
.facts{{display:flex;flex-wrap:wrap;gap:.6rem;margin:1rem 0}}
.facts div{{border:1px solid #ccc;border-radius:.3rem;padding:.35rem .8rem}}
.facts b{{display:block;font-size:1.25rem;font-variant-numeric:tabular-nums}}.facts span{{font-size:.8rem;color:#555}}
.facts .bad{{background:#f8dcc8;border:2px solid #d55e00}}
a{{color:#0072b2}}
.scroll table{{width:auto;min-width:min(100%,40rem)}}td.w{{white-space:nowrap}}th{{white-space:nowrap}}
th.n{{white-space:normal;min-width:4.4rem;max-width:13rem}}th{{vertical-align:bottom}}th.why{{color:inherit}}
td.w small{{display:inline-block;white-space:normal;min-width:4.6rem;max-width:26rem}}
td.why{{min-width:18rem;max-width:30rem;color:#1a1a1a}}
td{{vertical-align:middle}}.tall{{max-height:36rem;overflow-y:auto;border-bottom:1px solid #888}}
tr.part th{{position:static;background:#f3f3f3;border-bottom:1px solid #ddd;font-weight:600;padding-top:.5rem}}
tr.part span{{position:sticky;left:.5rem}}tbody tr:hover td{{background:#f6f9fc}}
.share{{display:inline-block;position:relative;width:5rem;height:.7rem;background:#eee;vertical-align:middle}}
.share i{{position:absolute;top:.2rem;height:.3rem;background:#56b4e9}}
.share u{{position:absolute;top:0;height:.7rem;width:3px;margin-left:-1.5px;background:#000}}
figure{{margin:1rem 0;overflow-x:auto}}figure svg,figure img{{max-width:100%;height:auto;display:block}}
.pair{{display:flex;flex-wrap:wrap;gap:0 2rem;align-items:flex-start}}.pair figure{{max-width:100%}}
figcaption{{font-size:.84rem;color:#555;margin-bottom:.3rem;position:sticky;left:0}}
pre{{background:#f3f3f3;padding:.6rem .8rem;overflow-x:auto;font-size:.84rem}}s{{color:#a33}}
@media(max-width:48rem){{body{{margin:1rem auto;padding:0 .7rem}}h1{{font-size:1.3rem}}.lead{{font-size:1rem}}
th{{position:static}}
figcaption::after{{content:" (move sideways →)"}}
figure svg,figure img{{max-width:none;min-width:30rem;width:100%}}figure.broad svg,figure.broad img{{min-width:52rem}}}}
@media print{{td{{vertical-align:middle}}.tall{{max-height:none}}}}
"""
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
        priced = costs.priced(self.runs, self._costs).notna().any()
        cells = stats.summary(self.runs, self._costs)
        sections = (
            self._contents(groups, names, cells), self._field(),
            *(self._problem(title, group, names, cells) for title, group in groups.items()),
            self._printed(), self._alone(), self._failures(), self._again(), self._provenance(),
        )  # fmt: skip
        head = study_summary.headline(
            self.runs, len(groups), self.manifest.get("planned", {}), self.about,
            condition=not self.identifiability.empty, money=bool(priced),
        )  # fmt: skip
        return whole_page(name, _STYLE, f"Study {name}", head, *sections)

    @property
    def _costs(self) -> Sequence[Mapping[str, Any]]:
        return list(self.manifest.get("costs", []))

    def _contents(self, groups: Mapping[str, pd.DataFrame], names: pd.Series, cells: pd.DataFrame) -> str:
        further = {section.link: f"#{section.anchor}" for section, _ in self.sections}
        further |= {"figures beside the runs": "#beside"} if self._alone() else {}
        further |= {"failures": "#failures", "how to do it again": "#again", "where this comes from": "#provenance"}
        return study_summary.contents(groups, names, {**further, **self.beside}, cells)

    def _field(self) -> str:
        if "overview" not in self.drawings:
            return ""
        return f"<h2 id=field>All methods</h2>{self._figure('overview', _OVERVIEW)}"

    def _problem(self, title: str, runs: pd.DataFrame, names: pd.Series, cells: pd.DataFrame) -> str:
        name = str(runs["problem"].iloc[0])
        described = about(problems.registry.factories()[name]) if name in problems.registry.names() else ""
        remarks = [optimum_of(mine).remark() for _, mine in study_tables.by_error(runs)]
        told = "".join(
            f"<p class=why>{escape(said)}</p>"
            for said in (
                described.replace("`", ""),
                *self._visible(runs),
                *remarks,
                *study_tables.prices(runs, self._costs),
            )
            if said
        )
        label = figures.file_name(title)
        drawn = self._figure(
            f"convergence_{label}", "Best value over charged evaluations: median, band from quartile to quartile"
        ) + self._figure(f"target_{label}", "What each run paid until the goal; a method that never got there stays")
        drawn = f"<div class=pair>{drawn}</div>" if drawn else ""
        table = study_tables.methods(runs, names, self._costs, cells)
        return (
            f"<h2 id='{anchor(title)}'>{escape(title)}</h2><p class=why>{things(len(runs), 'run')},"
            f" {things(int(runs['dimension'].iloc[0]), 'parameter')}</p>{told}{table}{drawn}"
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

    def _printed(self) -> str:
        parts = []
        for section, filled in self.sections:
            heading = f"<h2 id={section.anchor}>{escape(section.heading, quote=False)}</h2>"
            parts.append(f"{heading}<p>{escape(section.note, quote=False)}</p>")
            for printed, rows in filled:
                named = rows.rename(columns={"method": "optimizer", "options": "optimizer_options"})
                table = study_tables.printed_table(rows, method_labels(named), printed.column_title)
                parts.append(f"<h3>{escape(printed.title)}</h3>{table}")
        return "".join(parts)

    def _alone(self) -> str:
        drawn = "".join(self._figure(name, told) for name, told in self.captions.items())
        return f"<h2 id=beside>Beside the runs</h2>{drawn}" if drawn else ""

    def _failures(self) -> str:
        found = study_tables.failures(self.runs)
        return f"<h2 id=failures>Failures</h2>{found or '<p>No run failed.</p>'}"

    def _again(self) -> str:
        commands = [str(command) for command in self.manifest.get("commands", [])]
        report = shlex.join(["bench", "report", str(self.folder)])
        told = (
            "The runs; those that are done are skipped, and the same command gives the same values:"
            if commands
            else "This page, the tables and the figures, from the runs in this folder:"
        )
        return (
            f"<h2 id=again>How to do it again</h2><p>{told}</p>"
            f"<pre>{escape(chr(10).join([*commands, report]))}</pre><p>The numbers behind this page, in its folder: "
            "<code>runs.parquet</code>, <code>traces.parquet</code>, <code>summary.csv</code>, and a CSV beside each "
            "figure.</p>"
        )

    def _provenance(self) -> str:
        versions = study_origin.versions(self.runs)
        said = {
            "git commit": study_origin.commits(self.runs),
            "machine": study_origin.machines(self.runs),
            "versions": ", ".join(f"{package} {' / '.join(found)}" for package, found in versions.items()),
            "begun": study_origin.began(self.runs),
            "computing time": f"{number(self.runs['cpu_s'].sum(), 3)} s of processor, all runs together",
        }
        return f"<h2 id=provenance>Where this comes from</h2>{facts(said)}"

    def _figure(self, name: str, caption: str) -> str:
        path = self.drawings.get(name)
        if path is None:
            return ""
        element, width = drawing_inside(path, name)
        broad = " class=broad" if width > _BROAD else ""
        return f"<figure{broad}><figcaption>{escape(caption)}</figcaption>{element}</figure>"


def _problems(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs by what shares a figure: a problem and its options but the error function, smallest first."""
    groups = figures.panels_of(runs)
    return dict(sorted(groups.items(), key=lambda item: (int(item[1]["dimension"].iloc[0]), in_order(item[0]))))
