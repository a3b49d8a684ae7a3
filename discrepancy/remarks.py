"""The notes on a finished search, as a table: what has to be seen of it, under which code, and in which words.

`notes_of` asks each `Remark` what it sees of a `Search`, and words a note for each `Sight`. A new note is a code in
`core.notes.Code` and a row here. How often some of them are right was counted on a measured arm (`docs/arm-rates.md`):
from 30 random poses, 87 equations for 25 parameters, 21 searches told names, and 8 of these made the error of the other
poses larger; from 45 poses and more it was 3 of 41. One of the 21 named a compliance that gives way against its load,
and one a negative play; both made that error larger.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.words import counted, plain
from calibench.discrepancy.checks.wild import as_far_as_shuffled
from calibench.discrepancy.diagnostics.noise import exact_readings, less_than_stated, one_reading
from calibench.discrepancy.effects.general.columns import measured_columns
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.labels import effect_label, part_label, quantity_label
from calibench.discrepancy.model.effect import is_possible, name_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import inputs_of, roles_of, words_of
from calibench.discrepancy.registries import family_of
from calibench.discrepancy.report import Finding, Gap, Verdict
from calibench.discrepancy.search.form import forms_of
from calibench.discrepancy.search.select import best_of_each
from calibench.discrepancy.search.stepwise import Selection
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import Lone
from calibench.problems.base import Array, Parameter

NOISE_UNSTATED = frozenset({Code.NOISE_UNSTATED, Code.NOISE_LEARNED})  # codes of notes that nobody stated the noise
_FAR_OFF = 20.0  # times the noise: above it a model without a name may be that of another machine
_COLUMNS = 4  # by which a reading is described
_SHOWN = 3  # parameters outside their bounds, with their numbers
_NARROW = 1e-300  # bounds that leave no room
_MANY = 3  # waves of one part: any shape is a sum of some
_SEEN = 0.1  # of the size of a formula, half the way up and down: below it the terms cancel
_AGAINST = 3.0  # times as far as together
_LIKE_A_READING = {"rad": (1e3, "mrad"), "mm": (1.0, "mm")}  # units of sizes that compare with what is read


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """A search as it ended: the fits without effects and with what was found, and what was made of them."""

    machine: str
    base: Fit
    final: Fit
    selection: Selection
    verdict: Verdict
    findings: tuple[Finding, ...]
    gap: Gap
    lone: Lone | None

    @property
    def formulation(self) -> Formulation:
        """Return the formulation without effects."""
        return self.base.model.formulation


@final
@dataclass(frozen=True)
class Sight:
    """What one note is about: the words that its sentence needs, and columns, rows and numbers."""

    words: Mapping[str, str] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    rows: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Remark:
    """A row of the table: `seen` yields what a search shows of `code`, and `wording` says it."""

    code: Code
    seen: Callable[[Search], Iterable[Sight]]
    wording: str

    def notes(self, search: Search) -> Iterator[Note]:
        """Yield a note for each sight."""
        for sight in self.seen(search):
            yield Note(self.code, self.wording.format(**sight.words), sight.columns, sight.rows, sight.values)


def notes_of(search: Search, given: Iterable[Note]) -> tuple[Note, ...]:
    """Return the notes of a finished search: those on the whole, those `given` by its data and fits, all others."""
    whole, others = (
        [note for remark in table for note in remark.notes(search)] for table in (ON_THE_WHOLE, ON_THE_ANSWER)
    )
    return *whole, *given, *others


def _outside_bounds(search: Search) -> Iterator[Sight]:
    parameters = search.final.model.formulation.parameters
    ends = {p.name: float(search.final.x[k]) for k, p in enumerate(parameters)}
    if out := outside_bounds(parameters, ends):
        yield Sight({"ends": bounds_in_words(out, ends)}, values={p.name: ends[p.name] for p in out})


def bounds_in_words(out: Sequence[Parameter], ends: Mapping[str, float]) -> str:
    """Return where parameters end, and their bounds; of many only the first have numbers, as a table has them all."""
    many = len(out) > _SHOWN + 1
    first, others = (out[:_SHOWN], out[_SHOWN:]) if many else (out, ())
    shown = "; ".join(
        f"{p.name} ends at {ends[p.name]:.6g} {p.unit}, outside {p.lower:g} to {p.upper:g}" for p in first
    )
    return shown + (f"; outside theirs are {len(others)} more: {', '.join(p.name for p in others)}" if many else "")


def outside_bounds(parameters: Iterable[Parameter], ends: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the parameters that end outside their bounds, those first that are furthest in widths of their box."""

    def far(p: Parameter) -> float:
        at = ends.get(p.name, p.lower)
        return 0.0 if p.lower <= at <= p.upper else max(p.lower - at, at - p.upper) / max(p.upper - p.lower, _NARROW)

    return tuple(sorted((p for p in parameters if far(p) > 0), key=lambda p: -far(p)))


def _far(search: Search) -> Iterator[Sight]:
    lost = search.verdict == "unknown" and search.gap.train_before > _FAR_OFF  # noise alone does not cause that
    if lost and as_far_as_shuffled(search.formulation, search.base.x):
        yield Sight()


def _one_unseen(search: Search) -> Iterator[Sight]:
    if search.findings and (lone := search.lone) is not None:
        yield _of_one(lone.unseen, lone.row, lone.times)


def _one_reading(search: Search) -> Iterator[Sight]:
    if (one := one_reading(search.base)) is not None:
        yield _of_one(search.formulation, *one)


def _of_one(formulation: Formulation, row: int, times: float) -> Sight:
    """Return one reading: its row in the file, and its first columns with their numbers, inputs and then readings."""
    data, label = formulation.data, np.array([row])
    names = [name for name in dict.fromkeys((*inputs_of(formulation), *formulation.readings)) if name in data]
    reading = ", ".join(f"{name} {plain(float(np.asarray(data[name])[row]), 5)}" for name in names[:_COLUMNS])
    words = {"reading": f"{data.rows_named(label)}: {reading}", "times": plain(times, 2)}
    return Sight(words, tuple(names), data.labels(label), {"times": times})


def _exact_readings(search: Search) -> Iterator[Sight]:
    if found := exact_readings(search.base):
        name, (count, times) = max(found.items(), key=lambda one: one[1][1])
        inputs, names = inputs_of(search.formulation), search.formulation.readings
        words = {"name": name, "count": str(count), "times": plain(times, 2), "inputs": ", ".join(inputs)}
        yield Sight(words | {"names": ", ".join(names)}, (name,), values={"levels": count, "times": times})


def _less_than_stated(search: Search) -> Iterator[Sight]:
    if (times := less_than_stated(search.final)) is not None:
        yield Sight({"times": plain(times, 2)}, values={"times": times})


def _few_left(search: Search) -> Iterator[Sight]:
    left = len(search.base.r) - search.base.J.shape[1]
    if left <= thresholds().few_degrees:
        yield Sight({"equations": counted(left, "equation")}, values={"equations": left})


def _few_equations(search: Search) -> Iterator[Sight]:
    equations, calibrated = search.base.J.shape
    unstated = any(note.code in NOISE_UNSTATED for note in search.formulation.data.notes)
    if search.findings and unstated and equations < thresholds().equations_each * calibrated:
        words = {"equations": counted(equations, "equation"), "for_": counted(calibrated, "calibrated parameter")}
        yield Sight(words, values={"equations": equations, "parameters": calibrated})


def _negative_size(search: Search) -> Iterator[Sight]:
    """Yield each finding whose whole interval is negative, though the size of its family never is."""
    words, columns = words_of(roles_of(search.formulation)), {name_of(e): e.columns for e in search.final.model.effects}
    for one in search.findings:
        family, names = family_of(search.machine, one.family), columns.get(one.effect, ())
        if family and family.never_negative and max(one.amplitude.ci95) < 0:
            followed = " and ".join(f"the {quantity_label(search.machine, name, words)}" for name in names)
            size, what = _label(search, one), family.never_negative
            yield Sight({"name": size, "what": what, "columns": followed or "a column"}, names, values=_about(one))


def _mostly_unseen(search: Search) -> Iterator[Sight]:
    """Yield each finding of several terms of which the fitted readings see less than `_SEEN` of its size.

    Over a part of a turn its terms nearly cancel, or are a constant that calibration takes up.
    """
    units = {name_of(effect): effect.unit for effect in search.final.model.effects if len(effect.coefficients) > 1}
    for one in search.findings:
        swing = max((float(np.ptp(change)) / 2 for change in _changes(search.final, one).values()), default=0.0)
        unit = units.get(one.effect, "")
        if unit in _LIKE_A_READING and 0 < swing < _SEEN * abs(one.amplitude.value):
            scale, shown = _LIKE_A_READING[unit]
            words = {"name": _label(search, one), "swing": f"{plain(scale * swing, 2)} {shown}"}
            yield Sight(words, values=_about(one) | {"swing": swing, "unit": unit})


def _against_each_other(search: Search) -> Iterator[Sight]:
    """Yield each quantity that findings move to and fro against each other, `_AGAINST` times as far as together.

    The error of a formula is taken up by another name on the same part, with the other sign.
    """
    words = words_of(roles_of(search.final.model.formulation))
    moved: dict[str, list[tuple[Finding, Array]]] = {}
    for one in search.findings:
        for name, change in _changes(search.final, one).items():
            moved.setdefault(name, []).append((one, change))
    for name, those in moved.items():
        together = float(np.ptp(sum(change for _, change in those)))
        large = [one for one, change in those if float(np.ptp(change)) > _AGAINST * together > 0]
        if len(large) > 1:
            labels, quantity = [_label(search, one) for one in large], quantity_label(search.machine, name, words)
            values = {"effects": [one.effect for one in large]}
            yield Sight({"names": " and ".join(labels), "quantity": quantity}, (name,), values=values)


def _changes(final: Fit, one: Finding) -> dict[str, Array]:
    """Return quantity -> (n,): by how much a finding, with its form, moves what was read; {} for a law of the noise."""
    data = final.model.formulation.data
    numbers = {name_of(effect): (effect, c) for effect, c in final.model.coefficients(final.x)}
    if one.effect not in numbers:
        return {}
    parts = [numbers[one.effect][0], *forms_of(numbers[one.effect][0], final.model.effects)]
    moved = [part.shift(final.at.recorded, data, numbers[name_of(part)][1]) for part in parts]
    return {name: np.asarray(sum(np.asarray(part[name]) for part in moved if name in part)) for name in moved[0]}


def _many_waves(search: Search) -> Iterator[Sight]:
    count = Counter(one.target for one in search.findings if one.family in PERIODIC)
    for target, many in count.items():
        if many >= _MANY:
            words = {"many": str(many), "part": part_label(search.machine, target)}
            yield Sight(words, values={"waves": many, "target": target})


def _no_trends(search: Search) -> Iterator[Sight]:
    columns = roles_of(search.formulation).columns
    if columns and not measured_columns(search.formulation):
        yield Sight({"columns": ", ".join(columns), "first": columns[0]}, columns)


def _impossible_size(search: Search) -> Iterator[Sight]:
    first = search.selection.first
    for s in best_of_each(first.names, first.on)[:1] if search.selection.alarm else ():
        if s.m and not is_possible(s.effect, size := s.effect.amplitude(s.coefficients)):
            unit = s.effect.unit
            shown = f"{plain(100 * abs(size))} %" if unit == "1" else f"{plain(abs(size))} {unit}"
            words = {"name": effect_label(search.machine, s.effect.family, s.effect.target), "size": shown}
            yield Sight(words, values={"effect": s.name, "size": abs(size), "unit": unit})


def _label(search: Search, one: Finding) -> str:
    return effect_label(search.machine, one.family, one.target)


def _about(one: Finding) -> dict[str, Any]:
    return {"effect": one.effect, "size": one.amplitude.value}


ON_THE_WHOLE = (
    Remark(
        Code.OUTSIDE_BOUNDS,
        _outside_bounds,
        "{ends}: the fit is free of bounds, and found the machine elsewhere than its owner did; are the units, the "
        "start, and the bounds right?",
    ),
    Remark(
        Code.FAR_FROM_MODEL,
        _far,
        "the calibrated model is hardly nearer to the readings than to shuffled ones: are these readings of this "
        "machine, is each column under its own name, and is each row of one reading?",
    ),
    Remark(
        Code.ONE_UNSEEN,
        _one_unseen,
        "one reading ({reading}) makes most of the error of the readings that were not fitted: without it what was "
        "added brings that error to {times} times what it was; was it misread, or is no other reading near it?",
    ),
)
ON_THE_ANSWER = (
    Remark(
        Code.ONE_READING,
        _one_reading,
        "one reading ({reading}) makes nearly all of what the calibrated model leaves: without it the others lie "
        "{times} times nearer; look at it, and leave its row out if it was misread",
    ),
    Remark(
        Code.EXACT_READINGS,
        _exact_readings,
        "{name} comes in {count} levels, and moves {times} times less within one than its prediction does, as what was "
        "commanded does: the noise is that of the inputs ({inputs}); predict these from {names}, else their error is "
        "told as what is missing",
    ),
    Remark(
        Code.NOISE_TOO_WIDE,
        _less_than_stated,
        "what is left is {times} times the stated noise, which is too large: what is small beside it is not found; "
        "state it as it is, or leave it out to have it learned",
    ),
    Remark(
        Code.FEW_LEFT,
        _few_left,
        "{equations} left after calibration, too few to show a missing effect; take more readings",
    ),
    Remark(
        Code.FEW_EQUATIONS,
        _few_equations,
        "{equations} for {for_}, and the noise is not stated: names found from so few equations often do not hold for "
        "other readings; take more, and keep some of them out of the fit (split=hold) to test the names",
    ),
    Remark(
        Code.NEGATIVE_SIZE,
        _negative_size,
        "the size of {name} is negative, and a {what} never is: either {columns} has the other sign, or another cause "
        "acts like it",
    ),
    Remark(
        Code.MOSTLY_UNSEEN,
        _mostly_unseen,
        "{name}: over what was read it goes up and down by {swing} alone; its terms cancel there, or calibration takes "
        "them up: the size is that of the formula, which tells nothing of other places",
    ),
    Remark(
        Code.AGAINST_EACH_OTHER,
        _against_each_other,
        f"{{names}} move {{quantity}} against each other, more than {_AGAINST:g} times as far as together: beside each "
        "other none of them has the size of a cause",
    ),
    Remark(
        Code.MANY_WAVES,
        _many_waves,
        "the {many} waves of {part} tell together what its error is like over its way, and not what causes it: an "
        "error at one place is a sum of waves as well",
    ),
    Remark(
        Code.NO_TRENDS,
        _no_trends,
        "columns {columns}: nothing but joints is read, so no trend over them has a name; a joint's own are declared "
        'with it, such as Joint(temperature="{first}")',
    ),
    Remark(
        Code.IMPOSSIBLE_SIZE,
        _impossible_size,
        "{name} would explain most, but it would have to be {size}: taken for impossible",
    ),
)
