"""``report.html``: one search for a missing effect as a page that an engineer reads alone, offline.

Words first; each statistic is explained in a line where it stands. No script, nothing fetched: the drawings are inside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from math import isfinite
from typing import Any, final

from calibench.bench.discovery.page.limits import limits
from calibench.bench.discovery.page.noise_charts import CAPTIONS
from calibench.bench.discovery.page.tables import (
    parameter_table,
    set_table,
)
from calibench.bench.discovery.page.words import (
    chance_sentence,
    column_sentence,
    gap_sentence,
    headline,
    is_noise,
    moved_sentence,
    next_sentences,
)
from calibench.bench.report.shared.page import STYLE, facts, inline_svg, whole_page
from calibench.discrepancy.report import Report

_MARKS = {
    "none": ("✓", "nothing missing"),
    "negligible": ("≈", "too small to matter"),
    "named": ("●", "named"),
    "ambiguous": ("◐", "a set that cannot be told apart"),
    "unknown": ("?", "unknown"),
}
_PALE = 1e-3  # p of the strongest place above which a map shows nothing by itself
_ENOUGH = {
    "named": "Nothing more is needed to tell the name: it stands alone.",
    "negligible": "Nothing: what is missing is too small to matter.",
    "none": "Smaller effects take more readings of this kind: four times as many show half the size.",
}
_STYLE = f"""{STYLE}
body{{max-width:60rem}}h1{{margin-bottom:.6rem}}figure{{margin:.6rem 0 1rem}}
.verdict{{border-left:.5rem solid #555;padding:.6rem 1rem;margin:1rem 0;background:#f3f3f3}}
.verdict p{{margin:.4rem 0}}.verdict .said{{font-size:1.22rem;line-height:1.4}}.verdict .v{{background:#fff}}
.none{{background:#eef7f2;border-color:#009e73}}.negligible{{background:#eef4fa;border-color:#0072b2}}
.named{{background:#fbece3;border-color:#d55e00}}.ambiguous{{background:#fdf6e3;border-color:#e69f00}}
figure svg{{max-width:100%;height:auto;display:block}}figcaption{{font-size:.84rem;color:#555;margin-bottom:.3rem}}
.pair{{display:flex;flex-wrap:wrap;gap:0 1.5rem;align-items:flex-start}}
.pair figure{{flex:1 1 20rem;min-width:0;max-width:30rem}}
table.fit{{width:auto}}.fit td,.fit th{{padding-right:1.1rem}}
@media(max-width:36rem){{body{{margin:1rem auto;padding:0 .7rem}}h1{{font-size:1.3rem}}
.verdict{{padding:.5rem .7rem}}.verdict .said{{font-size:1.08rem}}
table,tbody,tr,td{{display:block;width:auto}}tr:first-child{{display:none}}tr{{border-bottom:1px solid #888;
padding:.3rem 0}}td,td.n{{border:0;padding:.05rem 0;text-align:left;white-space:normal}}
td:empty{{display:none}}td:not(:first-child)::before{{content:attr(data-head) ": ";color:#555}}
.fit td:not(:first-child){{display:inline-block;margin-right:.9rem}}
figure{{overflow-x:auto}}.broad svg{{max-width:none;min-width:34rem}}
.broad::before{{content:"move sideways to see both pictures →";font-size:.84rem;color:#555}}}}
"""


@final
@dataclass(frozen=True)
class Page:
    """What a page is made of: the report, drawings as SVG text by name, and what the data said.

    `causes` are family -> what it is in words, and its formula; `units` are those of the calibrated parameters; `noise`
    is what is stated of one reading, in words.
    """

    report: Report
    drawings: Mapping[str, str] = field(default_factory=dict)
    about_data: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    causes: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    noise: str = ""

    def html(self) -> str:
        """Return the page."""
        title = f"{self.report.case}: is anything missing from the model of {self.report.machine}?"
        sections = (
            self._where(), self._candidates(), self._noise(), self._residuals(), self._gap(), self._parameters(),
            self._next(), limits(self.report), self._notes(), self._provenance(),
        )  # fmt: skip
        return whole_page(title, _STYLE, title, self._verdict(), *sections)

    def _verdict(self) -> str:
        verdict = self.report.verdict
        mark, word = _MARKS[verdict]
        about = " · ".join(f"{key} {value}" for key, value in self.about_data.items())
        said = [gap_sentence(self.report), moved_sentence(self.report, self.units), chance_sentence(self.report)]
        parts = [
            f"<p><span class=v>{mark} {word}</span> <span class=why>{escape(about)}</span></p>",
            f"<p class=said>{escape(headline(self.report))}</p>",
            *(f"<p>{escape(sentence)}</p>" for sentence in said if sentence),
            *(f"<p><b>Measure next:</b> {escape(_sentence(advice))}</p>" for advice in next_sentences(self.report)[:1]),
        ]
        return f"<div class='verdict {verdict}'>{''.join(parts)}</div>"

    def _where(self) -> str:
        maps = self._figure("where", "Strength of the disagreement, −log10 p") + self._figure(
            "workspace", "Mean residual of a region over its own noise (2 or 3 is noise, 5 is not; grey: no readings)"
        )
        strongest = min((place.p for place in self.report.where if isfinite(place.p)), default=1.0)
        if "where" in self.drawings:
            cells = (
                "Each cell asks whether the residual of one part or region depends on one thing. "
                "<b>2</b> means that noise alone would look so in 1 of 100 such cells, <b>4</b> in 1 of 10 000. A dark "
                "cell is a place, not yet a cause."
            )
            if strongest > _PALE:
                cells += " Here none is dark: what is left does not follow one of these things by itself."
        elif self.report.verdict == "none":
            cells = "Nothing that it may depend on was found to matter, so there is no map of causes to look at."
        else:
            cells = "The readings are too few to ask on what it depends."
        return (
            "<h2>Where model and data disagree</h2><p>The model without any effect was fitted first; this is about "
            f"what it leaves, the residual. {cells}</p>{f'<div class=pair>{maps}</div>' if maps else ''}"
        )

    def _candidates(self) -> str:
        findings = self.report.findings
        table = set_table(self.report, self.causes)
        chart = self._figure("candidates", "The best candidates, added one at a time to the model without any:")
        if not table and not chart:
            return ""
        unnamed = {
            "none": "No candidate explains more than noise would, so none is named.",
            "unknown": "None is named, however large its gain: the best still leaves much more than noise, or smooth "
            "curves without a name explain far more than it does. What leads below is a hint at most.",
        }.get(self.report.verdict, "No candidate explains enough to be named.")
        remarks = ["The size is that of the first of a set."] if any(len(f.set) > 1 for f in findings) else []
        if len(findings) > 1:
            remarks.append(
                "The gain of a further effect is what it adds to those before it; the chart has each by itself."
            )
        return (
            "<h2>Which effect</h2><p>Every effect of the catalogue was added in turn and the machine calibrated again "
            "with it. The <b>gain</b> is how much better the data are then explained, less what the effect's own "
            "numbers cost (BIC); 6 more is about 20 times as plausible. Those within 6 of the best, but "
            "for the least likely of them, are <b>the set</b>: these data do not decide among them, and the weight "
            "says how they share the belief. "
            f"{' '.join(remarks)}</p>{table or f'<p>{unnamed}</p>'}{chart}"
        )

    def _noise(self) -> str:
        blamed = [finding.family for finding in self.report.findings if is_noise(finding)]
        charts = "".join(self._figure(f"noise_{k}", CAPTIONS.get(name, "")) for k, name in enumerate(blamed, start=1))
        if not charts:
            return ""
        return (
            "<h2>The noise</h2><p>These findings move no mean: they say that readings scatter otherwise than stated. "
            "Calibration then trusts such readings less, it does not correct them. Their gain is that of the "
            f"likelihood and stands in no chart of candidates.</p>{charts}"
        )

    def _residuals(self) -> str:
        charts = "".join(self._figure(name) for name in self.drawings if name.startswith("residuals_"))
        if not charts and self.report.verdict == "unknown":
            return (
                "<h2>The residual, before and after</h2><p>Nothing was added, named or not: no smooth curve made the "
                "error on poses left out smaller. So there is no after to draw.</p>"
            )
        if not charts:
            return ""
        many = sum(not is_noise(f) for f in self.report.findings) > 1
        told = (
            "No effect was added: smooth curves without a name were, where the map is darkest, to see how much they "
            "take away. The shape on the left is what a cause has to explain."
            if self.report.verdict == "unknown"
            else f"If the effect{'s are' if many else ' is'} the right one{'s' if many else ''}, the black means show "
            "a shape on the left and none on the right."
        )
        return (
            "<h2>The residual, before and after</h2><p>Each dot is one reading: the error of the guilty quantity that "
            "would explain what the calibrated model leaves of it, over what the effect depends on. Black are means "
            f"with two standard errors; grey is the noise of one typical reading. {told} Calibration has already "
            "swallowed part of the shape on the left.</p><p class=why>Where several effects were found, each picture "
            "leaves out only its own. Where an effect changes several quantities, the one that matters most is drawn. "
            "An effect that follows no single column is drawn over what it changes of each reading. The quarter of the "
            f"readings that know the quantity least has no dots; a triangle is a dot beyond the frame.</p>{charts}"
        )

    def _gap(self) -> str:
        chart = self._figure("gap")
        if not chart:
            return ""
        crossed = self.report.gap.cross_validated
        unseen = (
            "poses that were left out of the fit in turn" if crossed else "the readings that were kept from the fit"
        )
        noise = f" 1 is the stated noise of a reading: {escape(self.noise)}." if self.noise else ""
        return (
            f"<h2>The gap, on readings that were not fitted</h2><p>Bars are the rms error on {unseen}.{noise} The "
            "dashed line is what noise alone leaves there: that of the reading, as the repeats have it where there are "
            "any, and that of the parameters, which readings with noise have calibrated. The whisker is the 95 % "
            "interval of its bar. A gap that closes speaks for an effect but does not by itself prove its name."
            f"</p>{chart}"
        )

    def _parameters(self) -> str:
        parameters = self.report.parameters
        if not parameters:
            return ""
        moved = any(p.before != p.after for p in parameters.values())
        told = "No effect was added: this is the calibration by itself."
        if moved:
            many = sum(not is_noise(f) for f in self.report.findings) > 1
            added = {True: "the effects are", False: "the effect is"}[many]
            added = "a smooth correction is" if self.report.verdict == "unknown" else added
            told = (
                "Without what is missing, the parameters bend to imitate it. Bold: moved by more than two standard "
                f"errors (those after) once {added} in the model."
            )
        table = parameter_table(self.report, self.units, moved)
        return f"<h2>The calibrated parameters</h2><p>{told}</p>{table}"

    def _next(self) -> str:
        advice = next_sentences(self.report)
        if not advice and self.report.verdict in _ENOUGH:
            advice = [_ENOUGH[self.report.verdict]]
        if (columns := column_sentence(self.report)) and columns not in advice:
            advice.append(columns)
        items = "".join(f"<li>{escape(_sentence(a))}</li>" for a in advice)
        return f"<h2>What to measure next</h2><ul>{items}</ul>" if items else ""

    def _notes(self) -> str:
        items = "".join(f"<li>{escape(_sentence(str(note)))}</li>" for note in self.notes)
        return f"<h2>Notes on the data</h2><ul>{items}</ul>" if items else ""

    def _provenance(self) -> str:
        known = facts(self.provenance)
        return f"<h2>Where this comes from</h2>{known}" if known else ""

    def _figure(self, name: str, caption: str = "") -> str:
        if name not in self.drawings:
            return ""
        told = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
        broad = " class=broad" if name.startswith("residuals_") else ""
        return f"<figure{broad}>{told}{inline_svg(self.drawings[name], name)}</figure>"


def _sentence(text: str) -> str:
    """Return a remark as a sentence: a capital first, a stop last."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"
