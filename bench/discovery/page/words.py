"""A verdict in an engineer's words: the same sentences on the terminal and on the page.

They are made from the `Report` alone, so one that was read from a file reads as a fresh one. So is what to measure
next: where to repeat readings, which columns to add. Sizes have a suitable prefix, as many digits as their interval
allows, and degrees beside radians. Which notes stand first is decided by their codes.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from math import ceil, degrees, floor, isfinite, isnan, log10, pi

import numpy as np
from numpy.typing import ArrayLike

from calibench.core.notes import Code, Note
from calibench.core.tables.columns import ANY
from calibench.core.words import plain
from calibench.discrepancy.effects import families
from calibench.discrepancy.labels import effect_label, part_label, quantity_label, quantity_of
from calibench.discrepancy.model.effect import IN_ROWS
from calibench.discrepancy.model.roles import RATE
from calibench.discrepancy.noise.laws import OF_NOISE
from calibench.discrepancy.remarks import NOISE_UNSTATED
from calibench.discrepancy.report import Amplitude, Doubt, Finding, Place, Report, Rival
from calibench.discrepancy.search.finding import BEGINS, FREE_PERIOD
from calibench.discrepancy.search.smoother import NEAR

_BELOW = 0.9  # of what noise alone leaves: an error below it was measured in a noise that is too wide
_ALL = 0.99  # of what is more than noise
_NO_MORE = 1.15  # times the noise: what a reader would see as 1.1 times is no more than it
_TAKES = 0.3  # of what is more than noise: smooth functions that take less tell nothing
_TURN = {"rad": 2 * pi, "deg": 360.0}
FEW_NAMES = 3  # at most: more are told without intervals, or by what they share, and not one by one again
_NTH = ("second", "third")
_HALF = 0.5  # of the weight of a set: what its likeliest names are to hold together; of an excess: the most of it
_SHOWS = 0.01  # p below which a place is reported
_LESS = 0.8  # of the weight of the last name told: a next one above it is as likely
TRUSTED_LESS = "these readings are trusted less; no error of the machine was corrected."
UNTOUCHED = "no error of the machine was corrected."
_NOISE = {"outlier": "spread", "quantisation": "step", "heavy_tails": "excess kurtosis"}  # and what their size is


def headline(report: Report) -> str:
    """Return the verdict in one sentence, with amplitude and interval where an effect is named.

    Of more than three names the page has the intervals alone: the sentence would be a table in words.
    """
    machine, findings = report.machine, report.findings
    brief = len(findings) > FEW_NAMES
    if report.verdict == "none":
        return "Nothing is missing from the model that these data could show."
    if report.verdict == "noise" and not findings:
        odd = "but rows stand out as no noise makes them"
        return f"Nothing is missing from the model that these data could show, {odd}."
    if report.verdict == "negligible":
        which = f": {_join([_claim(machine, f) for f in findings])}" if findings else ""
        return f"Something is missing, but it is too small to matter against the noise{which}."
    if report.verdict == "unknown":
        where = ""
        if place := clearest_place(report):
            where = f"; the clearest sign is at {_where(report, place.target)}, {_over(report, place.covariate)}"
        beside = f" beside {_join([_claim(machine, f) for f in findings])}" if findings else ""
        if not families(machine) and not findings:
            return f"Something is missing{where}. No effect is entered for {machine}, so none can be named."
        fits = f"; a formula does: {report.formula.text}" if report.formula else where
        return f"Something is missing that no effect of the catalogue explains{beside}{fits}."
    claims = [_claim(machine, f, brief) for f in findings if not is_noise(f)]
    laws = [_claim(machine, f, brief) for f in findings if is_noise(f)]
    one = "A part of what is missing has a name" if len(claims) == 1 else "Parts of what is missing have names"
    missing = one if report.verdict == "partly" else "Missing from the model"
    said = [f"{missing}: {'; and '.join(claims)}."] if claims else []
    said += [f"The noise is not as stated: {'; and '.join(laws)}."] if laws else []
    return " ".join([*said, *([left_sentence(report)] if report.verdict == "partly" else [])])


def left_sentence(report: Report) -> str:
    """Return the error that remains without a name, in times the noise, and its place; "" without such an error."""
    left = report.left
    if left is None or not isfinite(left.times):
        return ""
    at = ""
    if left.place:
        at = f": clearest at {_where(report, left.place.target)}, {_over(report, left.place.covariate)}"
    if left.times < _NO_MORE:
        return f"What is left is no larger than the noise, but it is not random{at}."
    return f"{left.times:.1f} times the noise is left, unnamed{at}."


def unnamed_sentences(report: Report) -> list[str]:
    """Return sentences on an error without a name: which number errs, over what, how much, the nearest formula."""
    said = formula_sentences(report)
    if report.verdict != "unknown":
        return said
    for one in report.unnamed if not report.gap.excess_shrink < _TAKES else ():
        over = "over its own range" if one.covariate == one.quantity else _over(report, one.covariate)
        course = f": {one.course}" if one.course else ""
        size = amount(one.size, one.unit)
        said.append(f"{_where(report, one.quantity)} errs {over} by {size} from its least to its largest{course}.")
    if (near := report.nearest) is not None and near.share >= NEAR and report.formula is None:
        name = effect_label(report.machine, near.family, near.target)
        enough = near.share >= _ALL
        rest = "yet these readings do not tell that it is this" if enough else "what it leaves is still no noise"
        first = " Look there first." * (near.share > _HALF)
        said.append(f"Of the formulas {name} is the nearest: it explains {100 * near.share:.0f} % of what is more than "
                    f"noise, and {rest}.{first}")  # fmt: skip
    if report.shortest and not said:
        said.append(f"{shortest_words(report)}.")
    return said


def formula_sentences(report: Report) -> list[str]:
    """Return sentences on the formula that was added where no name fits: its numbers, what it explains, its rivals."""
    if (one := report.formula) is None:
        return []
    named = [*one.sizes, *one.numbers]
    numbers = []
    for c, size in zip(named, one.intervals):
        if size.unit in _STEPS and size.unit != "1":
            text = amount(size.value, size.unit, size.ci95)
        else:
            low, high = size.ci95
            unit = "" if size.unit == "1" else f" {size.unit}"
            text = f"{plain(size.value, 4)}{unit} (95 %: {plain(low, 4)} to {plain(high, 4)})"
        numbers.append(f"{c.name} = {text}")
    most = [f"{_where(report, name)} by {_bare(a.value, a.unit)} at most" for name, a in zip(one.changes, one.largest)]
    of = "what the names leave" if report.findings else "what is more than noise"
    rest = ", and smooth curves take a part of the rest" if one.smooth_beside else ""
    said = [f"No cause of the catalogue; {one.text}: {', '.join(numbers)}."]
    explains = "" if isnan(one.share) else f" and explains {share(one.share)} of {of}{rest}"
    said.append(f"The formula changes {_join(most)}{explains}; it is in the model.")
    if one.over_time:
        said.append("It follows the time of this run: another run need not repeat it.")
    if one.rivals:
        said.append(f"Nearly as likely: {'; or '.join(rival.text for rival in one.rivals[:FEW_NAMES])}.")
    return said


def shortest_words(report: Report) -> str:
    """Return the shortest waves that were looked for; "" where none were."""
    waves = [f"{_bare(one.period, one.unit)} over {_where(report, one.column)}" for one in report.shortest]
    if not waves:
        return ""
    return f"Waves shorter than {_join(waves, 'or')} were not looked for: that takes readings closer together"


def _where(report: Report, column: str) -> str:
    """Return a column with its words, where these add something."""
    label = quantity_label(report.machine, column, report.words)
    return column if label == column.replace("_", " ") else f"{column} ({label})"


def doubt_sentences(report: Report) -> list[str]:
    """Return the doubts on the names, and which names hold if the noise is not as stated."""
    machine = report.machine
    alike: dict[tuple[str, str], list[Finding]] = {}
    for f in (f for f in report.findings if f.caution):
        alone = "" if [one.code for one in f.caution] == [Doubt.UNCONFIRMED] else f.effect
        doubts = []
        for one in f.caution:
            over = " and ".join(_over(report, name).removeprefix("over ") for name in one.columns)
            part = part_label(machine, one.part) or "the readings"
            as_names = " as all these names" if len(report.findings) > 1 else ""
            said_of = {
                Doubt.FORMULA_ERROR: "may be the error of the first formula",
                Doubt.OTHER_CAUSE: f"may be another cause: beside it the same part errs over {over}",
                Doubt.ONE_CAUSE: f"may be another cause: one error of {part} over {over} explains as much{as_names}",
                Doubt.UNCONFIRMED: "is periodic over these readings"
                + f", in which a curve over {over} tells the same" * bool(one.columns)
                + "; another set (across=) tells whether it always is",
                Doubt.NOT_ELSEWHERE: f"is periodic over these readings, and not over those of {', '.join(one.cases)}",
            }
            doubts.append(said_of[one.code])
        alike.setdefault((alone, "; ".join(doubts)), []).append(f)
    doubted = []
    for (_, doubt), (first, *more) in alike.items():
        doubtful = _join([_label(machine, f) for f in (first, *more)])
        doubted.append(f"{doubtful}{': each' if more else ',' if first.form else ''} {doubt}.")
    said = [f"{line[:1].upper()}{line[1:]}" for line in doubted]
    names = [f for f in report.findings if not is_noise(f)]
    known = {f.effect for f in report.findings}  # the headline has their full words
    noises = []
    for other in report.other_noise:
        labels = [effect_label(machine, *e.partition(" ")[::2], again=e in known) for e in other.effects]
        held = [_label(machine, f) for f in names if f.effect in other.effects]
        lost = [_label(machine, f) for f in names if f.effect not in other.effects]
        partly = ", with something left that has no name" if other.verdict == "partly" else ""
        if not names:
            known |= set(other.effects)
            lacks = "as much would be without a name" if other.verdict == "unknown" else "nothing would be missing"
            which = f"{_join(labels)} would be named" if labels else lacks
        elif len(names) > FEW_NAMES and len(lost) < len(held):
            which = f"all of these names{f' but {_join(lost)}' if lost else ''} would be found{partly}"
        else:
            which = f"{_join(held)} would be named{partly}" if held else "none of these names would be found"
        times = {0.5: "half", 2.0: "twice"}.get(other.factor, f"{other.factor:g} times")
        noises.append(f"at {times} {noise_words(report)}, {which}")
    if noises:
        said.append(f"Repeats do not tell the noise. A{'; '.join(noises)[1:]}.")
    return said


def control_sentences(report: Report) -> list[str]:
    """Return of the names that live on order, direction or time how often shuffled rows explain as much."""
    alike: dict[tuple[str, int, int], list[str]] = {}
    for finding in report.findings:
        if (one := finding.shuffled) is not None:
            label = effect_label(report.machine, finding.family, finding.target, again=True)
            alike.setdefault((one.by, one.as_much, one.times), []).append(label)
    return [
        f"With the {by} shuffled among rows that are alike otherwise, as much as by {_join(labels)} is explained in "
        f"{as_much} of {times} cases."
        for (by, as_much, times), labels in alike.items()
    ]


_CARRY = {
    "carries": "carries to {}", "does not carry": "does not carry to {}",
    "not testable there": "could not be tested in {}",
}  # fmt: skip


def across_sentences(report: Report) -> list[str]:
    """Return a sentence on the other sets of the machine: which of them carry each finding, with its size there."""
    said = []
    for finding in report.findings:
        parts = []
        for verdict, words in _CARRY.items():
            cases = []
            for row in report.across:
                if (row.effect, row.verdict) == (finding.effect, verdict):
                    size = amplitude_words(row.there, row.target, brief=True)
                    cases.append(f"{row.case} ({'; '.join(filter(None, (row.why, f'{size} there' if size else '')))})")
            parts += [words.format(_join(cases))] if cases else []
        if parts:
            said.append(f"{_label(report.machine, finding)} {', '.join(parts)}")
    return [f"Of other sets of this machine: {'; '.join(said)}."] if said else []


def _label(machine: str, finding: Finding) -> str:
    """Return an effect in words after the headline; one of another form is "like" it."""
    words = effect_label(machine, finding.family, finding.target, again=True)
    return f"{words}, or what is like it" if finding.form else words


# codes of notes that stand before the verdict, because they could make it worthless
FIRST = frozenset({
    Code.ONE_READING, Code.OUTSIDE_BOUNDS, Code.EXACT_READINGS, Code.FAR_FROM_MODEL, Code.FEW_EQUATIONS,
    Code.ROWS_COPIED, Code.ROWS_EQUAL, Code.COLUMN_STILL, Code.ROWS_STAND_OUT,
})  # fmt: skip
# and of those that say what the sizes of the findings, or the error that they leave, are worth
SIZES = frozenset({Code.AGAINST_EACH_OTHER, Code.MOSTLY_UNSEEN, Code.ONE_UNSEEN, Code.NEGATIVE_SIZE})
LAST = frozenset(Code) - FIRST - SIZES


def notes_among(notes: Iterable[Note], codes: Collection[Code]) -> list[str]:
    return [note.text for note in notes if note.code in codes]


def noise_words(report: Report) -> str:
    """Return the words for the noise of a reading: stated, or estimated from the data."""
    return "the noise" if any(note.code in NOISE_UNSTATED for note in report.notes) else "the stated noise"


def floor_holds_the_gap(report: Report) -> bool:
    """Tell whether the noise estimate contains the gap as well, so that it does not bound what a model could reach."""
    gap = report.gap
    after = gap.held_out_after if isfinite(gap.held_out_before) else gap.train_after
    learned = any(note.code is Code.NOISE_LEARNED for note in report.notes)  # from the rest that is compared with it
    unstated = any(note.code in NOISE_UNSTATED for note in report.notes)
    return unstated and (learned or after < _BELOW * gap.noise_floor)


def is_noise(finding: Finding) -> bool:
    """Tell whether a finding blames the noise: it changes no mean, and tells which readings to trust less."""
    return finding.family in OF_NOISE


def gap_sentence(report: Report) -> str:
    """Return what adding the effect does to the error on readings that were not fitted."""
    gap = report.gap
    unseen = isfinite(gap.held_out_before)
    before = gap.held_out_before if unseen else gap.train_before
    after = gap.held_out_after if unseen else gap.train_after
    if isnan(before) or isnan(gap.noise_floor):
        return "The gap between model and data could not be measured."
    left_out = "On readings left out of the fit in turn" if gap.cross_validated else "On readings that were not fitted"
    where = left_out if unseen else "On the fitted readings (none were held out)"
    low, high = gap.held_out_ci95
    ends = f" (95 %: {low:.2f} to {high:.2f})" if isfinite(low) and isfinite(high) else ""
    noises = report.reading_noise  # of one size for all readings, or none is told
    alike = len(noises) == 1 and noises[0].size > 0 and noises[0].unit not in ("", "1")
    size = f" of {_bare(noises[0].size, noises[0].unit)}" if alike else ""
    said = f"{where} the error is {before:.2f} times {noise_words(report)}{size}"
    if report.verdict == "none" or (report.verdict != "noise" and (isnan(after) or after == before)):
        return f"{said}{ends}; noise alone leaves {gap.noise_floor:.2f}."
    if floor_holds_the_gap(report):
        least, most = low / before, high / before
        ends = f" (95 %: {least:.2f} to {most:.2f})" if isfinite(least) and isfinite(most) else ""
        return (
            f"{where} what was added brings the error to {after / before:.2f} times what it was{ends}; "
            "nobody stated the noise, and nothing tells how much of the rest is noise."
        )
    if report.verdict == "noise":
        return f"{said}{ends}, and stays so: {TRUSTED_LESS if report.findings else UNTOUCHED}"
    without, with_it = compared(report)
    shrunk = isfinite(gap.excess_shrink) and after < before
    share = f"; of what is more than noise, {100 * gap.excess_shrink:.0f} % (in squares) is gone" if shrunk else ""
    share = "; what was added makes it no smaller" if after >= before else share
    return f"{said} {without} and {after:.2f}{ends} {with_it}; noise alone leaves {gap.noise_floor:.2f}{share}."


def _bare(value: float, unit: str) -> str:
    return amount(value, unit).partition(" (")[0]


def compared(report: Report) -> tuple[str, str]:
    """Return in words which readings the two errors of the gap are of."""
    if report.verdict == "unknown" and report.formula is not None:
        return "for the model as it is", "with the formula"
    if report.verdict == "unknown":
        return "for the model as it is", "with a smooth correction without a name"
    many = sum(not is_noise(f) for f in report.findings) > 1
    without, them = ("without the effects", "with them") if many else ("without the effect", "with it")
    return without, f"{them} and the formula" if report.formula is not None else them


def moved_sentence(report: Report, units: Mapping[str, str]) -> str:
    """Return which calibrated parameter moves furthest, in its standard errors, when the effect is added."""
    moves = {
        name: ((p.after - p.before) / p.sd, p.after - p.before)
        for name, p in report.parameters.items()
        if isfinite(p.after - p.before) and p.sd > 0
    }
    if report.verdict in ("none", "noise", "unknown") or not moves:
        return ""
    name = max(moves, key=lambda key: abs(moves[key][0]))
    in_sd, moved = moves[name]
    if abs(in_sd) < 0.05:
        return ""
    size = _bare(moved, units.get(name, "1"))
    which = f"{name} ({words})" if (words := quantity_of(report.machine, name).label) else name
    return f"Of the calibrated parameters, {which} moves furthest: by {size}, {abs(in_sd):.1f} standard errors."


def chance_sentence(report: Report) -> str:
    """Return the probability of such data if nothing were missing, as a sentence."""
    p = report.p
    if isnan(p):
        return ""
    if p >= 0.01 and report.findings and all(is_noise(f) for f in report.findings):
        return f"Beside this noise nothing missing shows: {100 * p:.0f} of 100 sound machines look at least so odd."
    if p >= 0.01:
        return f"If nothing were missing, data would look at least so odd in {100 * p:.0f} of 100 cases: no alarm."
    often = "fewer than 1 of 100 000" if p < 1e-5 else f"1 of {round(1 / p, -1 if p < 0.002 else 0):.0f}"
    return f"If nothing were missing, data would look so odd in {often} cases."


def size_of(finding: Finding, brief: bool = False) -> str:
    """Return a finding's amplitude with its interval (without it where `brief`); "" where it has none."""
    unit = "" if finding.family == "heavy_tails" else finding.amplitude.unit  # a kurtosis is no share
    return amplitude_words(replace(finding.amplitude, unit=unit), finding.target, brief)


def amplitude_words(size: Amplitude, target: str, brief: bool = False) -> str:
    """Return a size with its interval; of what grows evenly with the column of its `target`, that of one unit of it."""
    if not isfinite(size.value):
        return ""
    column = target.partition(" over ")[2]
    of_unit = f" per {ANY.numbers.get(column) or f'unit of {column}'}" if isfinite(size.span) else ""
    each = size.span if of_unit else 1.0
    low, high = (end / each for end in size.ci95)
    ends = None if brief or not isfinite(low) or not isfinite(high) else (low, high)
    return amount(size.value / each, size.unit, ends) + of_unit


def coefficients_of(finding: Finding) -> str:
    """Return the numbers of a finding's formula, where they are several, its period, and from where on it acts."""
    numbers = [c for c in finding.coefficients if c.name != BEGINS]
    many = numbers if len(numbers) > 1 else []
    free = _free_period(finding)
    many = many[:-1] if free else many
    parts = [f"{c.name} {_bare(c.value, c.unit)}" for c in many if isfinite(c.value)]
    if free:
        parts.append(free)
    elif isfinite(finding.period) and finding.period > 0:
        parts.append(f"period {amount(finding.period, 'rad')}")
    parts += [begins] if (begins := _begins(finding)) else []
    return ", ".join(parts)


def _begins(finding: Finding) -> str:
    """Return from where of its column on an effect acts, where that was searched for."""
    for c in finding.coefficients:
        if c.name == BEGINS:
            where = f"row {ceil(c.value) + 1}" if c.unit == IN_ROWS else amount(c.value, c.unit)
            return f"{BEGINS} {where} on"
    return ""


def _free_period(finding: Finding, brief: bool = False) -> str:
    """Return a period that was fitted, in the unit of its column, with its interval; "" for any other finding."""
    last = finding.coefficients[-1] if finding.coefficients else None
    if last is None or last.name != FREE_PERIOD or not finding.period > 0:
        return ""
    reach = 1.96 * last.sd
    ends = None if brief else (finding.period - reach, finding.period + reach)
    here = "periodic over these readings: " if Doubt.UNCONFIRMED in (c.code for c in finding.caution) else ""
    words, turn = f"{here}period {amount(finding.period, last.unit, ends)}", _TURN.get(last.unit, 0.0)
    if turn <= finding.period:
        return words
    often = f"{turn / finding.period:#.3g} a turn"
    return often if brief else f"{words}, {often}"


def next_sentences(report: Report) -> list[str]:
    """Return what to measure next, once each."""
    parting = [finding.separated_by for finding in report.findings if finding.separated_by]
    said = [f"{what}." for what in (*parting, *report.parted_by)]
    if report.verdict in ("unknown", "partly"):
        place = clearest_place(report)
        spread = f"spread evenly {_over(report, place.covariate)}" if place else ""
        if place and place.covariate.startswith(RATE):
            spread = f"in which {place.covariate.removeprefix(RATE)} changes at many speeds"
        said.append(
            f"readings with repeats, {spread}, would show the shape of what is missing."
            if place
            else "more poses, each with repeats: these readings do not tell where it sits."
        )
        if columns := column_sentence(report):
            said.append(columns)
    return list(dict.fromkeys(said))


def column_sentence(report: Report) -> str:
    """Return which columns would let more effects be tested; empty where none is missing.

    Columns that the same effects need are together; of names one that repeats another more narrowly is left out.
    """
    by_column: dict[str, list[str]] = {}
    for item in report.not_testable:
        for column in item.columns if item.missing else ():
            by_column.setdefault(column, []).append(effect_label(report.machine, item.family, ""))
    by_labels: dict[tuple[str, ...], list[str]] = {}
    for column, of_column in by_column.items():
        by_labels.setdefault(tuple(dict.fromkeys(of_column)), []).append(column)
    groups = []
    for labels, columns in by_labels.items():
        widest = [one for one in labels if not any(one.startswith(f"{other} ") for other in labels)]
        groups.append(f"{', '.join(columns)} ({_join(widest)})")
    return f"columns that would let more effects be tested: {'; '.join(groups)}." if groups else ""


def _claim(machine: str, finding: Finding, brief: bool = False) -> str:
    """Return a finding with its size: one name, or the set that the data cannot tell apart; `brief`: no intervals."""
    rivals = finding.set or (Rival(finding.effect, finding.family, finding.target, 1.0),)
    own = (finding.family, finding.target)  # the name whose size is told
    size = size_of(finding, brief)
    about = f", {_NOISE.get(finding.family, '')} {size}".replace("  ", " ") if size else ""
    about += "".join(f", {words}" for words in (_free_period(finding, brief), _begins(finding)) if words)

    def member(rival: Rival) -> str:
        """Return a member of a set in words; one of another form is "like" its name."""
        name = effect_label(machine, rival.family, rival.target)
        is_form = finding.form and (rival.family, rival.target) == own
        return f"something like {name}, whose {finding.form}" if is_form else name

    if len(rivals) == 1:
        return f"{member(rivals[0])}{about}"
    first, others = rivals[0], ""
    if len(rivals) <= FEW_NAMES:
        which = f"{_join([member(r) for r in rivals], 'or')} (these data cannot tell which)"
        sizes = [
            (r.amplitude and amplitude_words(r.amplitude, r.target, brief=True), nth)
            for r, nth in zip(rivals[1:], _NTH)
        ]
        others = "".join(f", {size} if the {nth}" for size, nth in sizes if size)  # the page has their intervals
    else:
        # the likeliest members: two, or three where two hold no more than half of the weight
        ranked = sorted(rivals, key=lambda rival: -rival.weight if isfinite(rival.weight) else 0.0)
        likeliest = ranked[: 2 if sum(rival.weight for rival in ranked[:2]) > _HALF else 3]
        first = likeliest[0]
        names = []
        for rival in likeliest:
            percent = "below 1 %" if rival.weight < 0.005 else f"{100 * rival.weight:.0f} %"
            names.append(f"{member(rival)} ({percent})" if isfinite(rival.weight) else member(rival))
        ahead = "most likely" if ranked[len(likeliest)].weight < _LESS * likeliest[-1].weight else "such as"
        # the family or the parts of the machine that they share; one of the whole machine is of no part
        many, kinds = f"{len(rivals)} effects", {rival.family for rival in rivals}
        parts = list(dict.fromkeys(part_label(machine, rival.target) for rival in ranked))
        if len(kinds) == 1:
            many = f"{many} of one kind, {effect_label(machine, kinds.pop(), '')}"
        elif all(parts):
            many = f"{many} of {_join(parts, 'or') if len(parts) <= FEW_NAMES else f'{len(parts)} parts'}"
        which = f"one of {many} (these data cannot tell which), {ahead} {_join(names, 'or')}"
    is_first = (first.family, first.target) == own
    its = f"the first{others}" if is_first else _label(machine, finding)
    return which + (f": {about.removeprefix(', ')} if it is {its}" if about else "")


def _over(report: Report, covariate: str) -> str:
    label = quantity_label(report.machine, covariate, report.words)
    named = label == covariate.replace("_", " ") and not covariate.startswith(RATE)  # no words of ours: without article
    bare = named or label == "time"
    return f"over {label}" if bare else f"over the {label}"


def _join(parts: Sequence[str], last: str = "and") -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def clearest_place(report: Report) -> Place | None:
    """Return where an unnamed disagreement is strongest; None where nothing shows."""
    places = sorted((place for place in report.where if not isnan(place.p)), key=lambda place: place.p)
    return places[0] if places and places[0].p <= _SHOWS else None


_STEPS = {
    "rad": ((1e-3, "mrad"), (1e-6, "µrad")), "mm": ((1.0, "mm"), (1e-3, "µm")),
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")), "1": ((1e-2, "%"), (1e-6, "ppm")), "1/K": ((1e-6, "ppm/K"),),
    "rad/K": ((1e-3, "mrad/K"), (1e-6, "µrad/K")), "mm/K": ((1e-3, "µm/K"),), "mm/N": ((1e-3, "µm/N"),),
    "rad/(N mm)": ((1e-6, "mrad/(N m)"), (1e-9, "µrad/(N m)")),
    "rad/(N mm2)": ((1e-9, "mrad/(N m²)"), (1e-12, "µrad/(N m²)")), "rad/s": ((1e-3, "mrad/s"), (1e-6, "µrad/s")),
    "mm/s": ((1.0, "mm/s"), (1e-3, "µm/s"), (1e-6, "nm/s")),
}  # fmt: skip
_DASH = "–"
_DRAWN = {  # units in which errors are drawn, the usual one first
    "rad": ((1e3, "mrad"), (1e6, "µrad"), (1e9, "nrad")), "mm": ((1e3, "µm"), (1e6, "nm"), (1e9, "pm")),
}  # fmt: skip


def amount(value: float, unit: str, interval: tuple[float, float] | None = None) -> str:
    """Return a value with its unit, and its 95 % interval where there is one.

    >>> amount(1.52e-4, "rad")
    '0.152 mrad (0.00871°)'
    >>> amount(1.52e-4, "rad", (1.31e-4, 1.73e-4))
    '0.152 mrad (95 %: 0.131 to 0.173 mrad; 0.0087°)'
    >>> amount(3.76e-5, "rad/K", (3.06e-5, 4.46e-5))
    '37.6 µrad/K (95 %: 30.6 to 44.6 µrad/K)'
    >>> amount(5.2e-5, "rad")
    '52.0 µrad (0.00298°)'
    >>> amount(2.4e-3, "mm", (1.9e-3, 2.9e-3))
    '2.40 µm (95 %: 1.90 to 2.90 µm)'
    """
    if value is None or not isfinite(value):
        return _DASH
    steps = _STEPS.get(unit, ((1.0, "" if unit == "1" else unit),))
    # the largest step of the unit that leaves at least a tenth before the point
    scale, name = next((step for step in steps if abs(value) >= 0.1 * step[0]), steps[-1])
    if interval is not None and not all(end is not None and isfinite(end) for end in interval):
        interval = None
    spread = None if interval is None else (interval[1] - interval[0]) / 2
    if spread is not None and spread < 1e-4 * abs(value):  # as good as exact
        spread = interval = None
    places = _places(value / scale, spread / scale if spread else None)
    shown = f"{value / scale:.{places}f} {name}".rstrip()
    turned = f"{degrees(value):.{_places(degrees(value), degrees(spread) if spread else None)}f}°"
    in_degrees = turned if unit == "rad" else ""
    if spread is None or interval is None:
        return shown + (f" ({in_degrees})" if in_degrees else "")
    low, high = (f"{end / scale:.{places}f}" for end in interval)
    return f"{shown} (95 %: {low} to {high} {name}".rstrip() + (f"; {in_degrees})" if in_degrees else ")")


def in_small_units(unit: str, errors: ArrayLike) -> tuple[float, str]:
    """Return the factor and the name of the unit in which `errors`, one or more, are drawn.

    It is the usual one, or of smaller errors the first in which the largest has at least a tenth before the point.

    >>> in_small_units("rad", 2e-3), in_small_units("mm", [1e-5]), in_small_units("mm", 0.0), in_small_units("K", 1e-9)
    ((1000.0, 'mrad'), (1000000.0, 'nm'), (1000.0, 'µm'), (1.0, 'K'))
    """
    steps, sizes = _DRAWN.get(unit, ((1.0, unit),)), np.abs(np.asarray(errors, dtype=float))
    largest = float(np.max(sizes, where=np.isfinite(sizes), initial=0.0))
    return next((step for step in steps if largest * step[0] >= 0.1), steps[-1] if largest else steps[0])


def share(fraction: float) -> str:
    """Return a part of one in per cent.

    An effect of several numbers can leave a little more than its parts by themselves; that is all of it, 100 %.

    >>> share(0.994), share(0.0216), share(4e-16), share(1.09)
    ('99 %', '2.2 %', '0 %', '100 %')
    """
    fraction = min(fraction, 1.0)
    return f"{100 * fraction:.0f} %" if fraction >= 0.0995 or fraction < 1e-6 else f"{plain(100 * fraction, 2)} %"


def _places(value: float, spread: float | None) -> int:
    """Return how many decimals say two digits of the spread; without one, three of the value."""
    by, digits = (spread, 2) if spread else (abs(value), 3)
    return 0 if not by else min(8, max(0, digits - 1 - floor(log10(by))))
