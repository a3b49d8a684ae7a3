"""``report.html``: one search for a missing effect as a page that an engineer reads alone, offline.

Words first; each statistic is explained in a line where it stands. No script, nothing fetched: the drawings are inside.
Tables have the sets of the findings, the calibrated parameters, and what went untested or unseen; on a small screen a
row becomes a block of lines with the heads of its columns, so that nothing is cut off.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any, final

from calibench.bench.discovery.page.figures import CAPTIONS, discovery_figures, noise_charts, series_of
from calibench.bench.discovery.page.words import (
    FEW_NAMES,
    FIRST,
    SIZES,
    amount,
    amplitude_words,
    as_sentence,
    by_weight,
    chance_sentence,
    coefficients_of,
    column_sentence,
    doubt_sentences,
    floor_holds_the_gap,
    gap_sentence,
    headline,
    is_noise,
    moved_sentence,
    next_sentences,
    noise_words,
    notes_among,
    other_notes,
    reading_noise_words,
    share,
    shortest_words,
    size_of,
    unnamed_sentences,
)
from calibench.bench.discovery.record import SearchRecord
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.shared.page import Head, Table, inline_svg, macros, render
from calibench.bench.store.atomic_file import write_whole
from calibench.core.notes import Note, once
from calibench.core.words import plain
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.effects import families
from calibench.discrepancy.labels import effect_label, quantity_of
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.model.machine import Correction, last_word
from calibench.discrepancy.registries import description_of, family_of
from calibench.discrepancy.report import Candidate, Finding, Invisible, ParameterChange, Report, Rival

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
    notes: Sequence[Note] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    causes: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    noise: str = ""
    correction: Correction | None = None

    def html(self) -> str:
        """Return the page."""
        report = self.report
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
            first=[as_sentence(note, report.parameters) for note in notes_among(report.notes, FIRST)],
            headline=headline(report),
            said=[
                *unnamed_sentences(report),
                gap_sentence(report),
                *doubt_sentences(report),
                *map(as_sentence, notes_among(report.notes, SIZES)),
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
            notes=[as_sentence(text) for text in other_notes(self.notes)],
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


def write_report(record: SearchRecord, report: Report, data: MeasuredData, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` of a finished search into `folder`; return the page's path."""
    drawings = {}
    for name, drawing in chain(discovery_figures(report, series_of(report)), noise_charts(report)):
        drawings[name] = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
    formulation = report.before.model.formulation
    written = description_of(report.machine).corrected
    correction = None if written is None else written(report)
    page = Page(
        report,
        drawings,
        about_data={"readings": str(len(data)), "of them fitted": str(len(formulation.data))},
        notes=once((*data.notes, *report.notes)),
        units={p.name: p.unit for p in formulation.parameters},
        causes={family.name: (family.cause, family.formula) for family in families(report.machine)},
        provenance=_provenance(record),
        noise=reading_noise_words(report),
        correction=correction,
    )
    if correction is not None:
        write_whole(folder / correction.file, lambda file: file.write(correction.text.encode()))
    text = page.html().encode()
    return write_whole(folder / "report.html", lambda file: file.write(text))


def _provenance(record: SearchRecord) -> dict[str, Any]:
    origin = dict(record.provenance)
    dirty = " (with changes)" if origin.get("git_dirty") else ""
    moment = str(origin.get("started_at") or "")
    return {
        "case": record.case,
        "searched": f"{datetime.fromisoformat(moment).astimezone(UTC):%Y-%m-%d %H:%M} UTC" if moment else "",
        "commit": f"{origin.get('git_commit', '')}{dirty}",
        "platform": origin.get("platform"),
        "versions": ", ".join(f"{k} {v}" for k, v in json.loads(origin.get("versions") or "{}").items() if v),
        "options": record.options,
        "digest of the data": record.data_id,
        "digest of data and options": record.case_id,
        "computing time": f"{record.seconds:.2f} s" if isfinite(record.seconds) else None,
    }


def set_table(report: Report, causes: Mapping[str, tuple[str, str]]) -> Table:
    """Return the shortlists of all findings, the most likely first; no row without findings.

    The first of a list has the finding's size and coefficients; where a list has many members, each has its weight.
    `causes` are family -> what it is in words, and its formula.
    """
    rows = [_rival(report.machine, f, rival, causes) for f in report.findings for rival in _ranked(f)]
    if not any(len(f.set) > FEW_NAMES for f in report.findings):
        return table_of(("effect", "what it is", "size"), rows, "wide")
    weights = [_weight(rival) for f in report.findings for rival in _ranked(f)]
    weighted = [[row[0], weight, *row[1:]] for row, weight in zip(rows, weights, strict=True)]
    return table_of(("effect", "weight", "what it is", "size"), weighted, "wide", right=("weight",))


def score_table(report: Report) -> Table:
    """Return the decisive numbers: the weight of each member of a shortlist, and the gain of its first."""
    rows = [
        [
            effect_label(report.machine, rival.family, rival.target),
            _weight(rival),
            _gain(f.gain) if (rival.family, rival.target) == (f.family, f.target) else "",
        ]
        for f in report.findings
        for rival in _ranked(f)
    ]
    return table_of(("effect", "weight", "gain"), rows, "fit", right=("weight", "gain"))


def parameter_table(report: Report, units: Mapping[str, str], moved: bool) -> Table:
    """Return the parameters before, after and how far they moved; where nothing was added, their values."""
    heads = ("before", "after", "standard error", "moved", "in standard errors") if moved else (
        "value", "standard error")  # fmt: skip
    rows = [_parameter(report.machine, name, units.get(name, ""), p, moved) for name, p in report.parameters.items()]
    return table_of(("parameter", *heads), rows, "fit", right=heads)


def _rival(machine: str, finding: Finding, rival: Rival, causes: Mapping[str, tuple[str, str]]) -> list[str]:
    first = (rival.family, rival.target) == (finding.family, finding.target)
    cause, formula = causes.get(rival.family, ("", ""))
    name = f"{'●' if first else '◐'} {effect_label(machine, rival.family, rival.target)}"
    return [
        _cell().strong(name) if first else name,
        _cell().cause(cause, formula),
        _cell().cause(size_of(finding), coefficients_of(finding)) if first else _size_if_it(rival),
    ]


def _size_if_it(rival: Rival) -> str:
    size = "" if rival.amplitude is None else amplitude_words(rival.amplitude)
    return f"{size} if it is this" if size else ""


def _cell() -> Any:
    """Return the macros of cells that are more than text."""
    return macros("discovery/page/templates/cells.html.j2")


def _ranked(finding: Finding) -> list[Rival]:
    rivals = finding.set or (Rival(finding.effect, finding.family, finding.target, 1.0),)
    return by_weight(rivals)


def _weight(rival: Rival) -> str:
    return f"{100 * rival.weight:.0f} %" if isfinite(rival.weight) else ""


def _gain(gain: float) -> str:
    return "–" if not isfinite(gain) else f"{gain:.0f}" if abs(gain) >= 20 else f"{gain:.1f}"


def _parameter(machine: str, name: str, unit: str, p: ParameterChange, moves: bool) -> list[str]:
    cell = _cell().parameter(f"{name} [{unit}]" if unit else name, quantity_of(machine, name).label)
    error = "–" if not isfinite(p.sd) else plain(p.sd, 2) if p.sd >= 10 else f"{p.sd:#.2g}"
    if not moves:
        return [cell, _fixed(p.before, p.sd), error]
    moved = p.after - p.before
    in_sd = moved / p.sd if isfinite(moved) and isfinite(p.sd) and p.sd else None
    shift, far = _fixed(moved, p.sd, "+"), in_sd is not None and abs(in_sd) > 2
    return [
        cell, _fixed(p.before, p.sd), _fixed(p.after, p.sd), error, _cell().strong(shift) if far else shift,
        "" if in_sd is None else _unsigned_zero(f"{in_sd:+.1f}"),
    ]  # fmt: skip


def _fixed(value: float, sd: float, sign: str = "") -> str:
    """Return a value with the digits its standard error allows, and one more."""
    if not isfinite(value):
        return "–"
    places = 6
    if sd and isfinite(sd):
        places = next((k for k in range(9) if sd * 10**k >= 3), 9)
    return _unsigned_zero(f"{value:{sign}.{places}f}")


def _unsigned_zero(number: str) -> str:
    return number.lstrip("+-") if not number.strip("+-0.") else number


def table_of(heads: Sequence[str], rows: Sequence[Sequence[str]], kind: str, right: Sequence[str] = ()) -> Table:
    """Return the table of these cells, with the numbers to the `right`; on a small screen a row is a block of lines."""
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, kind, blocks=True)


_HARDLY = 0.05  # visible share below which an effect is all but invisible
_BEYOND = {  # sizes that no machine has
    "rad": (1.0, "none below 1 rad"),
    "1": (1.0, "none below 100 %"),
    "arcsec": (206265.0, "none below 1 rad"),
}
_ANY = "each of them"  # the subject of a reason that is the same for several targets
_LIMITS = ("effect", "visible share", "smallest size seen")


@final
@dataclass(frozen=True)
class Limits:
    """What went untested, a line a reason; what is `hidden` from any calibration; the smallest size `seen` of all.

    `shortest` tells the shortest waves that were looked for.
    """

    untested: Sequence[str]
    hidden: Table
    seen: Table
    shortest: str = ""
    hardly: str = f"{100 * _HARDLY:.0f} %"


def limits(report: Report) -> Limits:
    """Return the section of the page: not testable, invisible, and the smallest size seen of all candidates."""
    return Limits(
        untested_lines(report.machine, report.not_testable),
        _hidden(report),
        _table(report.machine, _ordered(c for c in report.candidates if isfinite(c.minimum_detectable))),
        shortest_words(report),
    )


def _hidden(report: Report) -> Table:
    """Return the candidates that calibration absorbs fully or nearly; no row where there are none."""
    hidden = {(item.family, item.target) for item in report.invisible}
    hardly = [c for c in report.candidates if c.visible_fraction < _HARDLY and (c.family, c.target) not in hidden]
    return _table(report.machine, [*report.invisible, *_ordered(hardly)])


def _ordered(candidates: Iterable[Candidate]) -> list[Candidate]:
    return sorted(candidates, key=lambda c: (c.family, c.target))


def _table(machine: str, items: Sequence[Candidate | Invisible]) -> Table:
    """Return the smallest size that would have been seen of each item."""
    rows = [
        [
            effect_label(machine, item.family, item.target),
            share(item.visible_fraction) if isfinite(item.visible_fraction) else "–",
            smallest(item.minimum_detectable, item.unit),
        ]
        for item in items
    ]
    return table_of(_LIMITS, rows, "fit", right=_LIMITS[1:])


def untested_lines(machine: str, items: Sequence[Untestable]) -> list[str]:
    """Return what could not be tested, one line for each reason.

    Reasons that differ only by the target's number are one.

    >>> untested_lines("gpm2002", [
    ...     Untestable("backlash", f"joint {i}", f"needs column dir_{i}", (f"dir_{i}",), True) for i in (1, 2)
    ... ])
    ['backlash of joint 1, 2: needs column dir_i']
    """
    by_reason: dict[str, list[Untestable]] = {}
    for item in items:
        by_reason.setdefault(_reason_for_any(machine, item), []).append(item)
    lines = []
    for reason, alike in by_reason.items():
        targets: dict[str, list[str]] = {}
        for item in alike:
            targets.setdefault(item.family, []).append(item.target)
        which = ", ".join(_of_targets(machine, family, of) for family, of in targets.items())
        one = len({item.target for item in alike}) == 1 and reason.startswith(_ANY)
        lines.append(f"{which}: {alike[0].reason if one else reason}")
    return lines


def _reason_for_any(machine: str, item: Untestable) -> str:
    """Return the reason as it is for every target of the family: its own columns under the names of their kind.

    A target that is the subject of its reason is told as each of them.
    """
    family = family_of(machine, item.family)
    kinds = (
        {pattern.format(i=last_word(item.target)): pattern.format(i="i") for pattern in family.columns}
        if family
        else {}
    )
    general = [kinds.get(column, column) for column in item.columns]
    reason = item.reason.replace(", ".join(item.columns), ", ".join(general)) if general else item.reason
    return f"{_ANY} {reason.removeprefix(f'{item.target} ')}" if reason.startswith(f"{item.target} ") else reason


def _of_targets(machine: str, family: str, targets: Sequence[str]) -> str:
    """Return a family with its targets in words; the kind of targets stands once."""
    kinds: dict[str, list[str]] = {}
    alone = []
    for target in targets:
        kind, _, which = target.rpartition(" ")
        if kind:
            kinds.setdefault(kind, []).append(which)
        else:
            alone.append(effect_label(machine, family, target))
    said = [effect_label(machine, family, f"{kind} {', '.join(which)}") for kind, which in kinds.items()]
    return ", ".join([*said, *alone])


def smallest(value: float, unit: str) -> str:
    """Return the smallest size that would have been seen; "" for one that no machine can have."""
    if not isfinite(value):
        return "none: no size shows"
    most, words = _BEYOND.get(unit, (float("inf"), ""))
    return words if value > most else amount(value, unit)
