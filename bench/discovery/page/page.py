"""``report.html``: one search for a missing effect as a page that an engineer reads alone, offline.

Words first; each statistic is explained in a line where it stands. No script, nothing fetched: the drawings are inside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, final

from calibench.bench.discovery.page.limits import limits
from calibench.bench.discovery.page.noise_charts import CAPTIONS
from calibench.bench.discovery.page.tables import (
    parameter_table,
    score_table,
    set_table,
)
from calibench.bench.discovery.page.words import (
    as_sentence,
    chance_sentence,
    column_sentence,
    doubt_sentences,
    first_notes,
    floor_holds_the_gap,
    gap_sentence,
    headline,
    is_noise,
    moved_sentence,
    next_sentences,
    noise_words,
    size_notes,
    unnamed_sentences,
)
from calibench.bench.report.shared.page import inline_svg
from calibench.bench.report.shared.templating import render
from calibench.discrepancy.model.description import Correction
from calibench.discrepancy.report import Report

_MARKS = {
    "none": ("✓", "nothing missing"),
    "negligible": ("≈", "too small to matter"),
    "named": ("●", "named"),
    "ambiguous": ("◐", "a set that cannot be told apart"),
    "partly": ("◑", "named in part"),
    "unknown": ("?", "unknown"),
}
_PALE = 1e-3  # p of the strongest place above which a map shows nothing by itself
_ENOUGH = {
    "named": "Nothing more is needed to tell the name: it stands alone.",
    "negligible": "Nothing: what is missing is too small to matter.",
    "none": "Smaller effects take more readings of this kind: four times as many show half the size.",
}


@final
@dataclass(frozen=True)
class Page:
    """The content of a page: the report, drawings as SVG text by name, and facts about the data.

    `causes` are family -> its words, and its formula; `units` are those of the calibrated parameters; `noise` is the
    stated noise of one reading, in words; `correction` is the file that the user gives back to the machine.
    """

    report: Report
    drawings: Mapping[str, str] = field(default_factory=dict)
    about_data: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    causes: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    noise: str = ""
    correction: Correction | None = None

    def html(self) -> str:
        """Return the page."""
        report = self.report
        first, sizes = first_notes(report), size_notes(report)
        mark, word = _MARKS[report.verdict]
        next_said = next_sentences(report)
        parameters = report.parameters
        moved = any(p.before != p.after for p in parameters.values())
        strongest = min((place.p for place in report.where if isfinite(place.p)), default=1.0)
        return render(
            "discovery/page/templates/discovery.html.j2",
            title=f"{report.case}: is anything missing from the model of {report.machine}?",
            verdict=report.verdict,
            mark=mark,
            word=word,
            about=" · ".join(f"{key} {value}" for key, value in self.about_data.items()),
            first=[as_sentence(note, report.parameters) for note in first],
            headline=headline(report),
            said=[
                *unnamed_sentences(report),
                gap_sentence(report),
                *doubt_sentences(report),
                *map(as_sentence, sizes),
                moved_sentence(report, self.units),
                chance_sentence(report),
            ],
            first_advice=as_sentence(next_said[0]) if next_said else "",
            pale=strongest > _PALE,
            set_table=set_table(report, self.causes),
            score_table=score_table(report),
            sets=any(len(finding.set) > 1 for finding in report.findings),
            several=len(report.findings) > 1,
            many=sum(not is_noise(finding) for finding in report.findings) > 1,
            noises=self._noises(),
            residuals=[name for name in self.drawings if name.startswith("residuals_")],
            crossed=report.gap.cross_validated,
            noise=self.noise,
            called=noise_words(self.report),
            bounded=not floor_holds_the_gap(self.report),
            parameters=parameter_table(report, self.units, moved),
            moved=moved,
            correction=self.correction,
            advice=self._advice(next_said),
            limits=limits(report),
            notes=[as_sentence(str(note)) for note in self.notes if note not in (*first, *sizes)],
            provenance={key: value for key, value in self.provenance.items() if value},
            drawings={name: inline_svg(svg, name) for name, svg in self.drawings.items()},
        )

    def _noises(self) -> Mapping[str, str]:
        """Return the drawings of the noise that findings blame: name -> caption."""
        blamed = [finding.family for finding in self.report.findings if is_noise(finding)]
        captions = {f"noise_{k}": CAPTIONS.get(name, "") for k, name in enumerate(blamed, start=1)}
        return {name: caption for name, caption in captions.items() if name in self.drawings}

    def _advice(self, said: Sequence[str]) -> list[str]:
        advice = list(said) or [_ENOUGH[v] for v in (self.report.verdict,) if v in _ENOUGH]
        if (columns := column_sentence(self.report)) and columns not in advice:
            advice.append(columns)
        return [as_sentence(line) for line in advice]
