"""``report.html``: one search for a missing effect as a page that an engineer reads alone, offline.

Words first; each statistic is explained in a line where it stands. No script, nothing fetched: the drawings are inside.
Tables have the sets of the findings, the calibrated parameters, and what went untested or unseen; on a small screen a
row becomes a block of lines with the heads of its columns, so that nothing is cut off.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, final

from calibench.bench.discovery.page import words
from calibench.bench.discovery.page.shown import Shown, series_of, shown_by
from calibench.bench.discovery.store import SearchRecord
from calibench.bench.gate.processes import CAN_FORK, WorkerPool, at_once
from calibench.bench.report.shared.page import Head, Table, inline_svg, macros, render
from calibench.bench.store.atomic_file import write_whole
from calibench.core.notes import Note, once
from calibench.core.words import as_sentence, plain
from calibench.discrepancy.design.detectability import Detectability
from calibench.discrepancy.effects import families
from calibench.discrepancy.labels import effect_label, quantity_of
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.model.machine import Correction, last_word
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.registries import description_of, family_of
from calibench.discrepancy.report import Amplitude, Candidate, Finding, Invisible, Report, Rival

_MARKS = {
    "none": ("✓", "nothing missing"), "negligible": ("≈", "too small to matter"), "named": ("●", "named"),
    "ambiguous": ("◐", "a set that cannot be told apart"), "partly": ("◑", "named in part"),
    "noise": ("~", "the noise, and nothing else"), "unknown": ("?", "unknown"),
}  # fmt: skip
_PALE = 1e-3  # p of the strongest place above which a map shows nothing by itself
_ENOUGH = {
    "named": "Nothing more is needed to tell the name: it stands alone.",
    "negligible": "Nothing: what is missing is too small to matter.",
    "noise": "Nothing for the model: look at the readings that are told, and at what gives them.",
    "none": "Smaller effects take more readings of this kind: four times as many show half the size.",
}
_CAPTIONS = {
    "outlier": "What the misfit of each reading would be as an error of this sensor. The quarter of the readings that "
    "know it least is left out.",
    "quantisation": "Readings of a sensor without steps lie anywhere between two steps (dashed); these lie on them.",
    "heavy_tails": "How many residuals are at least so large. Gaussian noise would follow the dashed line and has an "
    "excess kurtosis of 0; rare shocks reach beyond it and raise that number.",
}
_CELLS = "discovery/page/templates/cells.html.j2"  # macros of cells that are more than text
_HARDLY = 0.05  # visible share below which an effect is all but invisible
_BEYOND = {  # sizes that no machine has
    "rad": (1.0, "none below 1 rad"), "1": (1.0, "none below 100 %"), "arcsec": (206265.0, "none below 1 rad"),
}  # fmt: skip
_ANY = "each of them"  # the subject of a reason that is the same for several targets


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
        report = self.report
        mark, word = _MARKS[report.verdict]
        moved = any(p.before != p.after for p in report.parameters.values())
        strongest = min((place.p for place in report.where if isfinite(place.p)), default=1.0)
        next_said = words.next_sentences(report)
        advice = next_said or [_ENOUGH[v] for v in (report.verdict,) if v in _ENOUGH]
        if (columns := words.column_sentence(report)) and columns not in advice:
            advice = [*advice, columns]
        blamed = [finding.family for finding in report.findings if words.is_noise(finding)]
        captions = {f"noise_{k}": _CAPTIONS.get(name, "") for k, name in enumerate(blamed, start=1)}
        return render(
            "discovery/page/templates/discovery.html.j2",
            title=f"{report.case}: is anything missing from the model of {report.machine}?",
            verdict=report.verdict, formula=report.formula is not None, mark=mark, word=word,
            moved=moved, correction=self.correction, noise=self.noise,
            about=" · ".join(f"{key} {value}" for key, value in self.about_data.items()),
            first=[as_sentence(note, report.parameters) for note in words.notes_among(report.notes, words.FIRST)],
            headline=words.headline(report),
            said=[
                *words.unnamed_sentences(report), words.gap_sentence(report), *words.across_sentences(report),
                *words.doubt_sentences(report), *words.control_sentences(report),
                *map(as_sentence, words.notes_among(report.notes, words.SIZES)),
                words.moved_sentence(report, self.units), words.chance_sentence(report),
            ],
            first_advice=as_sentence(next_said[0]) if next_said else "",
            pale=strongest > _PALE,
            set_table=set_table(report, self.causes), across_table=across_table(report),
            score_table=score_table(report), limits=limits(report),
            sets=any(len(finding.set) > 1 for finding in report.findings),
            several=len(report.findings) > 1,
            many=sum(not words.is_noise(finding) for finding in report.findings) > 1,
            noises={name: caption for name, caption in captions.items() if name in self.drawings},
            residuals=[name for name in self.drawings if name.startswith("residuals_")],
            crossed=report.gap.cross_validated, called=words.noise_words(report),
            bounded=not words.floor_holds_the_gap(report), parameters=parameter_table(report, self.units, moved),
            advice=[as_sentence(line) for line in advice],
            notes=[as_sentence(text) for text in words.notes_among(self.notes, words.LAST)],
            provenance={key: value for key, value in self.provenance.items() if value},
            drawings={name: inline_svg(svg, name) for name, svg in self.drawings.items()},
        )  # fmt: skip


Draw = Callable[[Sequence[Shown], Path], list[Path]]


@contextmanager
def drawing(beside: bool) -> Iterator[Draw]:
    """Yield what writes drawings into a folder and returns their SVGs; `beside`, a process does it on all cores, which
    loads Matplotlib while this one searches."""
    if not beside or not CAN_FORK:
        yield lambda shown, folder: [draw() for draw in _draws((shown, folder))]
        return
    with WorkerPool(lambda job: at_once(_draws(job)), 1) as pool:
        pool.begin([((), Path())])

        def draw(shown: Sequence[Shown], folder: Path) -> list[Path]:
            pool.begin([(shown, folder)])
            paths: list[Path] = pool.take()
            return paths

        yield draw


def _draws(job: tuple[Sequence[Shown], Path]) -> list[Callable[[], Path]]:
    from calibench.bench.discovery.page.figures import written

    shown, folder = job
    return [partial(written, one, folder) for one in shown]


def write_report(record: SearchRecord, report: Report, data: MeasuredData, folder: Path, draw: Draw) -> Path:
    """Write ``figures/`` and ``report.html`` of a finished search into `folder`; return the page's path."""
    paths = draw([*shown_by(report, series_of(report))], folder / "figures")
    drawings = {path.stem: path.read_text(encoding="utf-8") for path in paths}
    formulation = report.before.model.formulation
    written = description_of(report.machine).corrected
    correction = None if written is None else written(report)
    origin = record.provenance
    dirty = " (with changes)" if origin.get("git_dirty") else ""
    moment = str(origin.get("started_at") or "")
    page = Page(
        report, drawings,
        about_data={"readings": str(len(data)), "of them fitted": str(len(formulation.data))},
        notes=once((*data.notes, *report.notes)),
        units={p.name: p.unit for p in formulation.parameters},
        causes={family.name: (family.cause, family.formula) for family in families(report.machine)},
        provenance={
            "case": record.case,
            "searched": f"{datetime.fromisoformat(moment).astimezone(UTC):%Y-%m-%d %H:%M} UTC" if moment else "",
            "commit": f"{origin.get('git_commit', '')}{dirty}",
            "platform": origin.get("platform"),
            "versions": ", ".join(f"{k} {v}" for k, v in json.loads(origin.get("versions") or "{}").items() if v),
            "options": record.options, "digest of the data": record.data_id,
            "digest of data and options": record.case_id,
            "computing time": f"{record.seconds:.2f} s" if isfinite(record.seconds) else None,
        },
        noise="; ".join(
            f"{words.amount(one.size, one.unit).partition(' (')[0]} ({', '.join(one.columns)})"
            for one in report.reading_noise
        ),
        correction=correction,
    )  # fmt: skip
    if correction is not None:
        write_whole(folder / correction.file, lambda file: file.write(correction.text.encode()))
    text = page.html().encode()
    return write_whole(folder / "report.html", lambda file: file.write(text))


def set_table(report: Report, causes: Mapping[str, tuple[str, str]]) -> Table:
    """Return the shortlists of all findings, the most likely first; no row without findings.

    The first of a list has the finding's size and coefficients; where a list has many members, each has its weight.
    `causes` are family -> what it is in words, and its formula.
    """
    cell, rows = macros(_CELLS), []
    weighted = any(len(f.set) > words.FEW_NAMES for f in report.findings)
    for finding, rival, first, weight in _members(report):
        cause, formula = causes.get(rival.family, ("", ""))
        name = f"{'●' if first else '◐'} {effect_label(report.machine, rival.family, rival.target)}"
        size = "" if rival.amplitude is None else words.amplitude_words(rival.amplitude, rival.target)
        size = f"{size} if it is this" if size else ""
        if first:
            name = cell.strong(name)
            size = cell.cause(words.size_of(finding), words.coefficients_of(finding))
        rows.append([name, *([weight] if weighted else []), cell.cause(cause, formula), size])
    if not weighted:
        return _table(("effect", "what it is", "size"), rows, "wide")
    return _table(("effect", "weight", "what it is", "size"), rows, "wide", right=("weight",))


def across_table(report: Report) -> Table:
    """Return what other sets of the machine say of each finding; no row where none was asked."""
    cell, rows = macros(_CELLS), []
    for row in report.across:
        numbers = [f"{round(v, digits) + 0.0:.{digits}f}" if isfinite(v) else "–" for v, digits in (
            (row.apart, 1), (row.gain, 0), (row.held_out_gain, 0),
        )]  # fmt: skip
        verdict = cell.cause(cell.strong(row.verdict) if row.verdict == "carries" else row.verdict, row.why)
        sizes = [words.amplitude_words(size, row.target) or "–" for size in (row.size, row.there)]
        rows.append([effect_label(report.machine, row.family, row.target), row.case, verdict, *sizes, *numbers])
    numbers = ["apart", "gain", "gain, poses left out"]
    return _table(("effect", "set", "verdict", "size here", "size there", *numbers), rows, "wide", right=numbers)


def score_table(report: Report) -> Table:
    """Return the decisive numbers: the weight of each member of a shortlist, and the gain of its first."""
    rows = []
    for finding, rival, first, weight in _members(report):
        gain = "–" if not isfinite(finding.gain) else f"{finding.gain:.{0 if abs(finding.gain) >= 20 else 1}f}"
        rows.append([effect_label(report.machine, rival.family, rival.target), weight, gain if first else ""])
    return _table(("effect", "weight", "gain"), rows, "fit", right=("weight", "gain"))


def _members(report: Report) -> list[tuple[Finding, Rival, bool, str]]:
    """Return the members of all shortlists: finding, rival, whether it is the finding's own name, weight in words."""
    members = []
    for finding in report.findings:
        listed = finding.set or (Rival(finding.effect, finding.family, finding.target, 1.0),)
        # the most likely first; those without a weight come last
        for rival in sorted(listed, key=lambda rival: -rival.weight if isfinite(rival.weight) else 0.0):
            first = (rival.family, rival.target) == (finding.family, finding.target)
            weight = f"{100 * rival.weight:.0f} %" if isfinite(rival.weight) else ""
            members.append((finding, rival, first, weight))
    return members


def parameter_table(report: Report, units: Mapping[str, str], moved: bool) -> Table:
    """Return the parameters before, after and how far they moved; where nothing was added, their values."""
    macro, rows = macros(_CELLS), []
    for name, p in report.parameters.items():
        unit = units.get(name, "")
        cell = macro.parameter(f"{name} [{unit}]" if unit else name, quantity_of(report.machine, name).label)
        error = "–" if not isfinite(p.sd) else plain(p.sd, 2) if p.sd >= 10 else f"{p.sd:#.2g}"
        if not moved:
            rows.append([cell, _fixed(p.before, p.sd), error])
            continue
        shift = p.after - p.before
        in_sd = shift / p.sd if isfinite(shift) and isfinite(p.sd) and p.sd else None
        by, far = _fixed(shift, p.sd, "+"), in_sd is not None and abs(in_sd) > 2
        rows.append([
            cell, _fixed(p.before, p.sd), _fixed(p.after, p.sd), error, macro.strong(by) if far else by,
            "" if in_sd is None else _fixed(in_sd, 1.0, "+"),
        ])  # fmt: skip
    heads: tuple[str, ...] = ("value", "standard error")
    if moved:
        heads = ("before", "after", "standard error", "moved", "in standard errors")
    return _table(("parameter", *heads), rows, "fit", right=heads)


def _fixed(value: float, sd: float, sign: str = "") -> str:
    """Return a value with the digits its standard error allows, and one more."""
    if not isfinite(value):
        return "–"
    places = next((k for k in range(9) if sd * 10**k >= 3), 9) if sd and isfinite(sd) else 6
    number = f"{value:{sign}.{places}f}"
    return number.lstrip("+-") if not number.strip("+-0.") else number  # no sign before 0


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], kind: str, right: Sequence[str] = ()) -> Table:
    """Return the table of these cells, with the numbers to the `right`; on a small screen a row is a block of lines."""
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, kind, blocks=True)


def limits(report: Report) -> dict[str, Any]:
    """Return the section of the page: what went `untested`, a line a reason; what is `hidden` from any calibration,
    fully or nearly; the smallest size `seen` of all; the `shortest` waves that were looked for."""

    def sizes(items: Sequence[Candidate | Invisible]) -> Table:
        rows = [
            [
                effect_label(report.machine, item.family, item.target),
                words.share(item.visible_fraction) if isfinite(item.visible_fraction) else "–",
                smallest(item),
            ]
            for item in items
        ]
        heads = ("effect", "visible share", "smallest size seen")
        return _table(heads, rows, "fit", right=heads[1:])

    invisible = {(item.family, item.target) for item in report.invisible}
    candidates = sorted(report.candidates, key=lambda c: (c.family, c.target))
    hardly = [c for c in candidates if c.visible_fraction < _HARDLY and (c.family, c.target) not in invisible]
    return {
        "untested": untested_lines(report.machine, report.not_testable),
        "hidden": sizes([*report.invisible, *hardly]),
        "seen": sizes([c for c in candidates if isfinite(c.minimum_detectable)]),
        "shortest": words.shortest_words(report), "hardly": f"{100 * _HARDLY:.0f} %",
    }  # fmt: skip


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
        family, last = family_of(machine, item.family), last_word(item.target)
        kinds = {pattern.format(i=last): pattern.format(i="i") for pattern in (family.columns if family else ())}
        general = ", ".join(kinds.get(column, column) for column in item.columns)
        reason = item.reason.replace(", ".join(item.columns), general) if general else item.reason
        if reason.startswith(f"{item.target} "):  # of any target that is the subject of its reason
            reason = f"{_ANY} {reason.removeprefix(f'{item.target} ')}"
        by_reason.setdefault(reason, []).append(item)
    lines = []
    for reason, alike in by_reason.items():
        targets: dict[str, list[str]] = {}
        for item in alike:
            targets.setdefault(item.family, []).append(item.target)
        which = []
        for family_name, of in targets.items():  # a family with its targets in words; the kind of targets stands once
            parted = [target.rpartition(" ") for target in of]
            by_kind = {kind: [last for other, _, last in parted if other == kind] for kind, *_ in parted if kind}
            words_of = [f"{kind} {', '.join(numbers)}" for kind, numbers in by_kind.items()]
            words_of += [last for kind, _, last in parted if not kind]
            which.append(", ".join(effect_label(machine, family_name, target) for target in words_of))
        one = len({item.target for item in alike}) == 1 and reason.startswith(_ANY)
        lines.append(f"{', '.join(which)}: {alike[0].reason if one else reason}")
    return lines


def smallest(of: Candidate | Invisible | Detectability) -> str:
    """Return the smallest size that would have been seen; "" for one that no machine can have."""
    value, unit = of.minimum_detectable, of.unit
    if not isfinite(value):
        return "none: no size shows"
    most, text = _BEYOND.get(unit, (float("inf"), ""))
    return text if value > most else words.amplitude_words(Amplitude(value, unit, span=of.span), of.target)
