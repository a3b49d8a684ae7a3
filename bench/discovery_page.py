"""``report.html``: one search for a missing effect as a page that an engineer reads alone, offline.

Words first; each statistic is explained in a line where it stands. No script, nothing fetched: the drawings are inside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from math import isfinite
from typing import Any, final

from bench.discovery_words import (
    chance_sentence,
    effect_words,
    gap_sentence,
    headline,
    is_noise,
    moved_sentence,
    next_sentences,
    size_of,
)
from bench.page_style import STYLE, inline_svg
from bench.quantity import amount, share
from discrepancy.report import Candidate

_MARKS = {
    "none": ("✓", "nothing missing"),
    "negligible": ("≈", "too small to matter"),
    "named": ("●", "named"),
    "ambiguous": ("◐", "a set that cannot be told apart"),
    "unknown": ("?", "unknown"),
}
_SHOWS = {
    "outlier": "What the misfit of each reading would be as an error of this encoder. The quarter of the readings that "
    "know it least is left out.",
    "quantisation": "Readings of an encoder without steps lie anywhere between two steps (dashed); these lie on them.",
    "heavy_tails": "How many residuals are at least so large. Gaussian noise would follow the dashed line and has an "
    "excess kurtosis of 0; rare shocks reach beyond it and raise that number.",
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
table.fit{{width:auto}}.fit td,.fit th{{padding-right:1.1rem}}td.in{{font-weight:600}}
dl{{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1rem;font-size:.84rem}}
dt{{color:#555}}dd{{margin:0;overflow-wrap:anywhere}}
@media(max-width:36rem){{body{{margin:1rem auto;padding:0 .7rem}}h1{{font-size:1.3rem}}
.verdict{{padding:.5rem .7rem}}.verdict .said{{font-size:1.08rem}}
dl{{grid-template-columns:1fr}}dd{{margin-bottom:.4rem}}table.wide{{min-width:36rem}}
figure{{overflow-x:auto}}.broad svg{{max-width:none;min-width:34rem}}}}
"""


@final
@dataclass(frozen=True)
class Page:
    """What a page is made of: the report as JSON has it, drawings as SVG text by name, and what the data said.

    `causes` are family -> what it is in words, and its formula; `units` are those of the calibrated parameters.
    """

    report: Mapping[str, Any]
    drawings: Mapping[str, str] = field(default_factory=dict)
    about_data: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    causes: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    candidates: Sequence[Candidate] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def html(self) -> str:
        """Return the page."""
        title = f"{self.report['case']}: what the model of {self.report['machine']} is missing"
        sections = (
            self._where(), self._candidates(), self._noise(), self._residuals(), self._gap(), self._parameters(),
            self._next(), self._limits(), self._notes(), self._provenance(),
        )  # fmt: skip
        return "\n".join(
            [
                f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
                f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{_STYLE}</style></head>'
                f"<body><h1>{escape(title)}</h1>",
                self._verdict(),
                *(section for section in sections if section),
                "</body></html>\n",
            ]
        )

    def _verdict(self) -> str:
        verdict = self.report["verdict"]
        mark, word = _MARKS[verdict]
        about = " · ".join(f"{key} {value}" for key, value in self.about_data.items())
        said = [gap_sentence(self.report), moved_sentence(self.report, self.units), chance_sentence(self.report)]
        parts = [
            f"<p><span class=v>{mark} {word}</span> <span class=why>{escape(about)}</span></p>",
            f"<p class=said>{escape(headline(self.report))}</p>",
            *(f"<p>{escape(sentence)}</p>" for sentence in said if sentence),
            *(f"<p><b>Measure next:</b> {escape(advice)}</p>" for advice in next_sentences(self.report)[:1]),
        ]
        return f"<div class='verdict {verdict}'>{''.join(parts)}</div>"

    def _where(self) -> str:
        maps = self._figure("where", "Strength of the disagreement, -log10 p") + self._figure(
            "workspace", "Mean residual of a region over its own noise (2 or 3 is noise, 5 is not)"
        )
        if not maps:
            return ""
        cells = (
            " Each cell asks whether the residual of one joint, leg or region depends on one thing. "
            "<b>2</b> means that noise alone would look so in 1 of 100 such cells, <b>4</b> in 1 of 10 000. A dark "
            "cell is a place, not yet a cause."
            if "where" in self.drawings
            else ""
        )
        return (
            "<h2>Where model and data disagree</h2><p>The model without any effect was fitted first; here is what it "
            f"leaves.{cells}</p><div class=pair>{maps}</div>"
        )

    def _candidates(self) -> str:
        findings = self.report.get("findings", [])
        rows = "".join(self._rival(f, r) for f in findings for r in _ranked(f))
        chart = self._figure("candidates", "The best candidates, added one at a time to the model without any:")
        if not rows and not chart:
            return ""
        heads = "<tr><th>effect</th><th>what it is</th><th>size</th><th class=n>weight</th><th class=n>gain</th></tr>"
        table = (
            f"<div class=scroll><table class=wide>{heads}{rows}</table></div>"
            if rows
            else "<p>No candidate explains enough to be named.</p>"
        )
        return (
            "<h2>Which effect</h2><p>Every effect of the catalogue was added in turn and the machine calibrated again "
            "with it. The <b>gain</b> is how much better the data are then explained, less what the effect's own "
            "numbers cost (BIC); 6 more is about 20 times as plausible. All within 6 of the best are "
            "<b>the set</b>: these data do not decide among them, and the weight says how they share the belief.</p>"
            f"{table}{chart}"
        )

    def _rival(self, finding: Mapping[str, Any], rival: Mapping[str, Any]) -> str:
        """Return a member of a finding's set as a row; the first has the finding's size and gain."""
        first = (rival.get("family"), rival.get("target")) == (finding.get("family"), finding.get("target"))
        cause, formula = self.causes.get(str(rival.get("family")), ("", ""))
        weight = rival.get("weight")
        return (
            f"<tr><td{' class=in' if first else ''}>{'●' if first else '◐'} "
            f"{escape(effect_words(str(rival.get('family')), str(rival.get('target'))))}</td>"
            f"<td>{escape(cause)}{f'<br><small>{escape(formula)}</small>' if formula else ''}</td>"
            f"<td>{escape(size_of(finding)) if first else ''}</td>"
            f"<td class=n>{'' if weight is None else f'{100 * weight:.0f} %'}</td>"
            f"<td class=n>{_gain(finding) if first else ''}</td></tr>"
        )

    def _noise(self) -> str:
        blamed = [finding["family"] for finding in self.report.get("findings", []) if is_noise(finding)]
        charts = "".join(self._figure(f"noise_{k}", _SHOWS.get(name, "")) for k, name in enumerate(blamed, start=1))
        if not charts:
            return ""
        return (
            "<h2>The noise</h2><p>These findings move no mean: they say that readings scatter otherwise than stated. "
            "Calibration then trusts such readings less, it does not correct them. Their gain is that of the "
            f"likelihood and stands in no chart of candidates.</p>{charts}"
        )

    def _residuals(self) -> str:
        charts = "".join(self._figure(name) for name in self.drawings if name.startswith("residuals_"))
        if not charts:
            return ""
        told = (
            "No effect was added: smooth curves without a name were, where the map is darkest, to see how much they "
            "take away. The shape on the left is what a cause has to explain."
            if self.report["verdict"] == "unknown"
            else "If the effect is the right one, the black line shows a shape on the left and none on the right."
        )
        return (
            "<h2>The residual, before and after</h2><p>Each dot is one reading: the error of the guilty quantity that "
            "would explain what the calibrated model leaves of it, over what the effect depends on. Black are means "
            f"with two standard errors; grey is the noise of one typical reading. {told} Calibration has already "
            f"swallowed part of the shape on the left.</p>{charts}"
        )

    def _gap(self) -> str:
        chart = self._figure("gap")
        if not chart:
            return ""
        return (
            "<h2>The gap, on readings that were not fitted</h2><p>Bars are the rms error on readings that were not "
            "fitted (held out, or each pose left out in turn); the dashed line is what noise alone leaves, from "
            "repeats where there are any. The whisker is its 95 % interval. A gap that closes speaks for the effect "
            f"but does not by itself prove its name.</p>{chart}"
        )

    def _parameters(self) -> str:
        parameters = self.report.get("parameters") or {}
        if not parameters:
            return ""
        moved = any(p.get("before") != p.get("after") for p in parameters.values())
        rows = "".join(_parameter(name, self.units.get(name, ""), p, moved) for name, p in parameters.items())
        names = ("before", "after", "standard error", "moved", "in standard errors") if moved else (
            "value", "standard error")  # fmt: skip
        heads = "<th>parameter</th><th>unit</th>" + "".join(f"<th class=n>{name}</th>" for name in names)
        told = "No effect was added: this is the calibration by itself."
        if moved:
            added = "a smooth correction" if self.report["verdict"] == "unknown" else "the effect"
            told = (
                "Without what is missing, the parameters bend to imitate it. Bold: moved by more than two standard "
                f"errors once {added} is in the model."
            )
        return (
            f"<h2>The calibrated parameters</h2><p>{told}</p>"
            f"<div class=scroll><table class=fit><tr>{heads}</tr>{rows}</table></div>"
        )

    def _next(self) -> str:
        advice = next_sentences(self.report)
        if not advice:
            return ""
        return f"<h2>What to measure next</h2><ul>{''.join(f'<li>{escape(a)}</li>' for a in advice)}</ul>"

    def _limits(self) -> str:
        parts = []
        if untested := self.report.get("not_testable"):
            items = "".join(f"<li>{escape(line)}</li>" for line in _untested(untested))
            parts.append(f"<h3>Could not be tested</h3><ul>{items}</ul>")
        if unseen := self.report.get("invisible"):
            rows = "".join(
                f"<tr><td>{escape(effect_words(str(item['family']), str(item['target'])))}</td>"
                f"<td class=n>{_share(item)}</td>"
                f"<td class=n>{escape(_detectable(item))}</td></tr>"
                for item in unseen
            )
            parts.append(
                "<h3>Invisible, or nearly</h3><p>Calibration absorbs these: the parameters move a little and the "
                "residual shows next to nothing. The visible share is what is left of the effect's trace; an effect "
                "smaller than the last column would have gone unseen.</p><div class=scroll><table class=fit><tr>"
                f"<th>effect</th><th class=n>visible share</th><th class=n>smallest size seen</th></tr>{rows}"
                "</table></div>"
            )
        if seen := [c for c in self.candidates if isfinite(c.minimum_detectable)]:
            rows = "".join(
                f"<tr><td>{escape(effect_words(c.family, c.target))}</td>"
                f"<td class=n>{share(c.visible_fraction)}</td>"
                f"<td class=n>{escape(amount(c.minimum_detectable, c.unit))}</td></tr>"
                for c in sorted(seen, key=lambda c: (c.family, c.target))
            )
            parts.append(
                f"<details><summary>The smallest size that would have been seen, for all {len(seen)} candidates"
                "</summary><div class=scroll><table class=fit><tr><th>effect</th><th class=n>visible share</th>"
                f"<th class=n>smallest size seen</th></tr>{rows}</table></div></details>"
            )
        return f"<h2>What these data could not tell</h2>{''.join(parts)}" if parts else ""

    def _notes(self) -> str:
        if not self.notes:
            return ""
        return f"<h2>Notes on the data</h2><ul>{''.join(f'<li>{escape(str(note))}</li>' for note in self.notes)}</ul>"

    def _provenance(self) -> str:
        rows = "".join(f"<dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd>" for k, v in self.provenance.items() if v)
        return f"<h2>Where this comes from</h2><dl>{rows}</dl>" if rows else ""

    def _figure(self, name: str, caption: str = "") -> str:
        if name not in self.drawings:
            return ""
        told = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
        broad = " class=broad" if name.startswith("residuals_") else ""
        return f"<figure{broad}>{told}{inline_svg(self.drawings[name], name)}</figure>"


def _parameter(name: str, unit: str, p: Mapping[str, Any], moves: bool) -> str:
    """Return a parameter as a row: before, after and how far it moved, or where nothing was added, its value."""
    before, after, sd = (p.get(key) for key in ("before", "after", "sd"))
    row = f"<tr><td>{escape(name)}</td><td>{escape(unit)}</td><td class=n>{_fixed(before, sd)}</td>"
    error = f"<td class=n>{_number(sd, 2)}</td>"
    if not moves:
        return f"{row}{error}</tr>"
    moved = None if before is None or after is None else after - before
    in_sd = moved / sd if moved is not None and sd else None
    bold = " in" if in_sd is not None and abs(in_sd) > 2 else ""
    return (
        f"{row}<td class=n>{_fixed(after, sd)}</td>{error}<td class='n{bold}'>{_fixed(moved, sd, signed=True)}</td>"
        f"<td class=n>{'' if in_sd is None else f'{in_sd:+.1f}'}</td></tr>"
    )


def _ranked(finding: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    rivals = finding.get("set") or [finding]
    return sorted(rivals, key=lambda rival: -(rival.get("weight") or 0.0))


def _untested(items: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what could not be tested, a line a reason."""
    by_reason: dict[str, list[str]] = {}
    for item in items:
        by_reason.setdefault(str(item["reason"]), []).append(effect_words(str(item["family"]), str(item["target"])))
    return [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]


def _share(item: Mapping[str, Any]) -> str:
    fraction = item.get("visible_fraction")
    return "–" if fraction is None else share(float(fraction))


def _detectable(item: Mapping[str, Any]) -> str:
    value = item.get("minimum_detectable")
    if isinstance(value, Mapping):
        return amount(float(value["value"]), str(value.get("unit", "")))
    return "none: no size shows" if value is None else amount(float(value), str(item.get("unit", "")))


def _gain(finding: Mapping[str, Any]) -> str:
    gain = finding.get("gain")
    return f"{gain:.0f}" if gain is not None and abs(gain) >= 100 else _number(gain, 3)


def _number(value: float | None, digits: int = 4) -> str:
    return "–" if value is None or not isfinite(value) else f"{value:.{digits}g}"


def _fixed(value: float | None, sd: float | None, signed: bool = False) -> str:
    """Return a value with the digits its standard error allows, and one more."""
    if value is None or not isfinite(value):
        return "–"
    places = 6
    if sd and isfinite(sd):
        places = next((k for k in range(9) if sd * 10**k >= 3), 9)
    return f"{value:{'+' if signed else ''}.{places}f}"
