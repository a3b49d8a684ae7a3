"""``report.html``: one study as a page that a researcher reads alone, offline: what was compared, and what came out.

The summary first, then a section a problem with its table and figures, the papers' tables, what failed, how to do it
again. No script, nothing fetched: drawings are inside.
"""

from __future__ import annotations

import base64
import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, final

import pandas as pd

import problems
from bedrock.registry import about
from bench import figures, stats, study_tables
from bench.page_style import STYLE, inline_svg, rounded
from bench.study_tables import count, number

_HEAVY = 450_000  # characters from which on an SVG goes in as its PNG, where that is smaller
_BROAD = 620.0  # points from which on a drawing scrolls on a small screen rather than shrink
_STYLE = f"""{STYLE}
h1{{margin-bottom:.2rem}}h2{{border-top:1px solid #ddd;padding-top:1.4rem}}h3{{margin:1.6rem 0 .4rem}}
.lead{{font-size:1.08rem;max-width:62rem}}p{{max-width:62rem;margin:.5rem 0}}
.facts{{display:flex;flex-wrap:wrap;gap:.6rem;margin:1rem 0}}
.facts div{{border:1px solid #ccc;border-radius:.3rem;padding:.35rem .8rem}}
.facts b{{display:block;font-size:1.25rem;font-variant-numeric:tabular-nums}}.facts span{{font-size:.8rem;color:#555}}
.facts .bad{{background:#f8dcc8;border:2px solid #d55e00}}
dl{{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1rem;font-size:.84rem}}
dt{{color:#555}}dd{{margin:0;overflow-wrap:anywhere}}a{{color:#0072b2}}
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
dl{{grid-template-columns:1fr}}dd{{margin-bottom:.4rem}}th{{position:static}}
figure svg,figure img{{max-width:none;min-width:30rem;width:100%}}figure.broad svg,figure.broad img{{min-width:52rem}}}}
@media print{{td{{vertical-align:middle}}.tall{{max-height:none}}}}
"""
_ALONE = {
    "overview": "Every method on every problem",
    "gauge": "The printed 12-parameter results on the curve along which no reading changes",
    "plans": "What sampling plans can tell of 11 parameters",
    "orthoglide_residuals": "The Orthoglide's measured deviations before and after calibration",
}


@final
@dataclass(frozen=True)
class StudyPage:
    """What a page is made of: the runs, the tables beside the papers', drawings as (name, SVG path), and the manifest.

    `identifiability` is `bench.tables.identifiability(runs)`, `about` a sentence on a prepared study, `beside` links to
    other pages: words -> address.
    """

    folder: Path
    runs: pd.DataFrame
    papers: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    identifiability: pd.DataFrame = field(default_factory=pd.DataFrame)
    drawings: Mapping[str, Path] = field(default_factory=dict)
    manifest: Mapping[str, Any] = field(default_factory=dict)
    about: str = ""
    beside: Mapping[str, str] = field(default_factory=dict)

    def html(self) -> str:
        """Return the page."""
        name = self.folder.resolve().name
        names = stats.method_names(self.runs)
        groups = _problems(self.runs)
        sections = (
            self._contents(groups, names), self._field(), *(self._problem(t, g, names) for t, g in groups.items()),
            self._papers(), self._alone(), self._failures(names), self._again(), self._provenance(),
        )  # fmt: skip
        return "\n".join(
            [
                f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(name)}</title>'
                f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{_STYLE}</style></head>'
                f"<body><h1>Study {escape(name)}</h1>",
                self._headline(len(groups)),
                *(section for section in sections if section),
                "</body></html>\n",
            ]
        )

    def _headline(self, problems: int) -> str:
        runs = self.runs
        failed = int((runs["status"] != "ok").sum())
        budgets = [count(b) for b in sorted(set(runs["budget"]))]
        cells = runs.groupby(stats.CELL, dropna=False).size()
        seeds = str(cells.max()) if cells.min() == cells.max() else f"{cells.min()} to {cells.max()}"
        left = len(set(self.manifest.get("planned", {})) - set(runs["run_id"]))
        methods = runs[["optimizer", "optimizer_options"]].drop_duplicates()
        facts = [
            (count(len(runs)), _plural("run", len(runs)), ""), (count(failed), "failed", "bad" if failed else ""),
            (" / ".join(budgets), "evaluations a run, at most", ""),
            (seeds, f"{_plural('seed', cells.max())} a cell", ""), (str(problems), _plural("problem", problems), ""),
            (str(len(methods)), _plural("optimiser", len(methods)), ""),
            (str(len(cells)), _plural("cell", len(cells)), ""),
        ]  # fmt: skip
        facts += [(count(left), "planned, not done yet", "bad")] if left else []
        boxes = "".join(f"<div class='{kind}'><b>{value}</b><span>{what}</span></div>" for value, what, kind in facts)
        about = f"<p class=why>{escape(self.about)}</p>" if self.about else ""
        python = " / ".join(self._versions().get("python", []))
        made = {"commit": self._commits(), "Python": python, "on": self._machines(), "begun": self._began()}
        line = " · ".join(f"{key} {escape(value)}" for key, value in made.items() if value)
        return (
            f"{about}<div class=facts>{boxes}</div><p class=why>{line} (<a href=#provenance>all versions</a>)</p>"
            f"<p class=lead>{self._told(budgets, failed)}</p>{_READING}"
        )

    def _told(self, budgets: Sequence[str], failed: int) -> str:
        """Return what was compared, and under which budget, in sentences."""
        runs = self.runs
        one = len(budgets) == 1
        starts = " and ".join(f"the {s}" for s in sorted(set(runs["start"].astype(str))))
        calls = (
            f"Every run had the same budget of {budgets[0]} evaluations"
            if one
            else f"The budgets differ ({', '.join(budgets)} evaluations): compare only within one"
        )
        solved = runs.groupby(stats.CELL, dropna=False).ngroups
        lost = (
            f"{failed} of {len(runs)} runs failed; they stay in every table as runs that did not get there, and the "
            "<a href=#failures>reasons</a> are at the end."
            if failed
            else "No run failed."
        )
        return (
            f"{_things(solved, 'combination')} of a problem and an optimiser, {_things(len(runs), 'run')} in all, from"
            f" {escape(starts)} start{'s' if ' and ' in starts else ''}. {calls}, counted at one gate for all: one "
            "evaluation is one pass over all samples, a Jacobian is charged as many as there are parameters, and the "
            f"call after the last is refused. {lost}"
        )

    def _contents(self, groups: Mapping[str, pd.DataFrame], names: pd.Series) -> str:
        rows = []
        for title, runs in groups.items():
            for i, (error, mine) in enumerate(study_tables.by_error(runs)):
                cells = study_tables.ranked(mine, names)
                won, best = cells[cells["success"] == 1.0], cells.iloc[0]
                least, known = figures.least_and_floor(mine)[0], cells["goal"].notna().any()
                lowest = cells.sort_values("best_median", kind="stable").iloc[0]
                first = (
                    f"{escape(best['method'])}, {count(best['charged_to_target'])} evaluations"
                    if len(won)
                    else f"{'none; ' if known else ''}lowest median: {escape(lowest['method'])},"
                    f" {number(lowest['best_median'] - least)}"
                )
                failed = int((mine["status"] != "ok").sum())
                rows.append(
                    [
                        "" if i else f"<a href='#{_anchor(title)}'>{escape(title)}</a>", escape(error or "f"),
                        str(int(mine["dimension"].iloc[0])), str(len(cells)),
                        str(len(won)) if known else "–", first,
                        f"<span class='v no'>✗ {failed}</span>" if failed else "0",
                    ]
                )  # fmt: skip
        heads = [
            ("problem", ""), ("error", ""), ("parameters", "n"), ("methods", "n"), ("at the goal in every run", "n"),
            ("fewest evaluations to the goal", ""), ("failed runs", "n"),
        ]  # fmt: skip
        links = [("papers", "the papers' tables")] if self.papers else []
        links += [("beside", "figures beside the runs")] if self._alone() else []
        links += [("failures", "failures"), ("again", "how to do it again"), ("provenance", "where this comes from")]
        further = " · ".join(f"<a href='#{anchor}'>{words}</a>" for anchor, words in links)
        further += "".join(f" · <a href='{escape(a)}'>{escape(words)}</a>" for words, a in self.beside.items())
        return f"<h2 id=contents>Problems</h2>{study_tables.table(heads, rows)}<p>Further: {further}</p>"

    def _field(self) -> str:
        if "overview" not in self.drawings:
            return ""
        return f"<h2 id=field>All methods</h2>{self._figure('overview', _ALONE['overview'])}"

    def _problem(self, title: str, runs: pd.DataFrame, names: pd.Series) -> str:
        name = str(runs["problem"].iloc[0])
        described = about(problems.registry.factories()[name]) if name in problems.registry.names() else ""
        told = "".join(
            f"<p class=why>{escape(said)}</p>" for said in (described.replace("`", ""), *self._visible(runs)) if said
        )
        label = figures.file_name(title)
        drawn = self._figure(
            f"convergence_{label}", "Best value over charged evaluations: median, band from quartile to quartile"
        ) + self._figure(f"target_{label}", "What each run paid until the goal; a method that never got there stays")
        drawn = f"<div class=pair>{drawn}</div>" if drawn else ""
        return (
            f"<h2 id='{_anchor(title)}'>{escape(title)}</h2><p class=why>{_things(len(runs), 'run')},"
            f" {int(runs['dimension'].iloc[0])} parameters</p>{told}{study_tables.methods(runs, names)}{drawn}"
        )

    def _visible(self, runs: pd.DataFrame) -> list[str]:
        """Return what the data of this problem can tell, once for each error function where they differ."""
        if self.identifiability.empty:
            return []
        known = self.identifiability.set_index(["problem", "problem_options"])["finding"]
        said: dict[str, list[str]] = {}
        for problem, options in runs[["problem", "problem_options"]].drop_duplicates().to_numpy():
            if (problem, options) in known.index:
                said.setdefault(known[problem, options], []).append(str(json.loads(options).get("error", "")))
        return [
            f"{', '.join(errors)}: {finding}" if len(said) > 1 else finding[:1].upper() + finding[1:]
            for finding, errors in said.items()
        ]

    def _papers(self) -> str:
        if not self.papers:
            return ""
        parts = [
            "<h2 id=papers>The paper's tables beside ours</h2><p>Ours are medians, quartiles below where there is more "
            "than one run, at this study's budget. A printed number that is wrong is crossed out, and what to read "
            "stands beside it. The sampling plans are not published, so values agree in kind, not in digits.</p>"
        ]
        for name, rows in self.papers.items():
            named = rows.rename(columns={"method": "optimizer", "options": "optimizer_options"})
            table = study_tables.paper_table(rows, stats.method_names(named))
            parts.append(f"<h3>Table {escape(name.removeprefix('table'))} of Cong et al. 2008</h3>{table}")
        return "".join(parts)

    def _alone(self) -> str:
        drawn = "".join(self._figure(name, told) for name, told in _ALONE.items() if name != "overview")
        return f"<h2 id=beside>Beside the runs</h2>{drawn}" if drawn else ""

    def _failures(self, names: pd.Series) -> str:
        found = study_tables.failures(self.runs, names)
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
        said = {
            "git commit": self._commits(),
            "machine": self._machines(),
            "versions": ", ".join(f"{package} {' / '.join(found)}" for package, found in self._versions().items()),
            "begun": self._began(),
            "computing time": f"{number(self.runs['cpu_s'].sum(), 3)} s of processor, all runs together",
        }
        rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in said.items() if v)
        return f"<h2 id=provenance>Where this comes from</h2><dl>{rows}</dl>"

    def _versions(self) -> dict[str, list[str]]:
        """Return the versions that the runs were made with; of a package more than one where they differ."""
        versions: dict[str, list[str]] = {}
        for text in self.runs["versions"].dropna().unique():
            for package, version in json.loads(text).items():
                if version and version not in versions.setdefault(package, []):
                    versions[package].append(version)
        return {package: found for package, found in versions.items() if found}

    def _commits(self) -> str:
        commits = self.runs[["git_commit", "git_dirty"]].drop_duplicates().to_numpy().tolist()
        return ", ".join(f"{c[:10]}{' with uncommitted changes' if d is True else ''}" for c, d in commits if c)

    def _machines(self) -> str:
        return ", ".join(self.runs["platform"].dropna().unique())

    def _began(self) -> str:
        began = self.runs["started_at"].dropna()
        first, last = f"{began.min():%Y-%m-%d %H:%M}", f"{began.max():%Y-%m-%d %H:%M}"
        return "" if began.empty else f"{first} UTC" if first == last else f"{first} to {last} UTC"

    def _figure(self, name: str, caption: str) -> str:
        path = self.drawings.get(name)
        if path is None:
            return ""
        element, width = _inside(path, name)
        broad = " class=broad" if width > _BROAD else ""
        return f"<figure{broad}><figcaption>{escape(caption)}</figcaption>{element}</figure>"


_READING = """<details><summary>How to read the tables</summary><ul>
<li><b>At the goal</b>: how many of <i>all</i> runs, failed ones included, reached the level that counts as success: the
run's own target, or the problem's last, which is the rounding floor. <b>Share</b> draws it with its interval, Wilson's
at 95 %: five of five still only says above 57 %.</li>
<li><b>Evaluations to it</b>: the median over the runs that got there, in charged evaluations. Read it beside the
share.</li>
<li><b>Best, median</b> and <b>quartiles</b> are observed values over the seeds; <b>spent</b> is the median charge.
Below the goal nothing is ranked: what differs there is rounding.</li>
<li><b>kmrmse*</b>: the parameter error after the best move along the gauge.</li>
<li>Sorted by the share at the goal, then by what it cost, then by the best value.</li></ul></details>"""


def _problems(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs by what shares a figure: a problem and its options but the error function, smallest first."""
    titles = runs.apply(figures.panel_group, axis=1)
    groups = {str(title): mine for title, mine in runs.groupby(titles, sort=False)}
    return dict(sorted(groups.items(), key=lambda item: (int(item[1]["dimension"].iloc[0]), item[0])))


def _inside(path: Path, name: str) -> tuple[str, float]:
    """Return a drawing for use inside the page, and its width in points; a heavy one as its PNG, where that is less."""
    svg = rounded(path.read_text(encoding="utf-8"))
    element = inline_svg(svg, name)
    head = element[: element.index(">")]
    width = float(head.partition('width="')[2].partition("pt")[0] or 0)
    png = path.with_suffix(".png")
    if len(element) > _HEAVY and png.exists():
        coded = base64.b64encode(png.read_bytes()).decode()
        if len(coded) < len(element):
            return f'<img alt="{escape(name)}" src="data:image/png;base64,{coded}" width="{width * 4 / 3:.0f}">', width
    return element.replace("<svg ", f'<svg aria-label="{escape(name)}" ', 1), width


def _anchor(title: str) -> str:
    return f"problem-{figures.file_name(title)}"


def _things(n: int, what: str) -> str:
    return f"{count(n)} {_plural(what, n)}"


def _plural(what: str, n: int) -> str:
    return what if n == 1 else f"{what}s"
