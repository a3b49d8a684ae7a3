"""The notes on a finished search: what has to be seen of it, under which code, and in which words.

A new note is a code in `core.notes.Code` and a sentence here. How often some of them are right was counted on a
measured arm (`docs/arm-rates.md`): from 30 random poses, 87 equations for 25 parameters, 21 searches told names, and 8
of these made the error of the other poses larger; from 45 poses and more it was 3 of 41.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.words import counted, plain
from calibench.discrepancy.checks.wild import as_far_as_shuffled
from calibench.discrepancy.diagnostics.far_readings import Pattern, Standing
from calibench.discrepancy.diagnostics.noise import exact_readings, less_than_stated, one_reading
from calibench.discrepancy.effects.general.columns import measured_columns
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.labels import effect_label, part_label, quantity_label
from calibench.discrepancy.model.effect import is_possible, name_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import inputs_of, roles_of, unknown_noise_of, words_of
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
_RUNS = 8  # places of rows that stand out, told one by one
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
    standing: Standing | None = None
    no_noise: tuple[Pattern, ...] = ()


def notes_of(search: Search, given: Iterable[Note]) -> tuple[Note, ...]:
    """Return the notes of a finished search: those on the whole, those `given` by its data and fits, all others."""
    notes: list[Note] = []
    formulation = search.base.model.formulation
    at = search.final if search.findings else search.base  # smooth curves without a name may take a parameter's part
    ends = {p.name: float(at.x[k]) for k, p in enumerate(at.model.formulation.parameters)}
    out, where = outside_bounds(at.model.formulation.parameters, ends)
    if out:
        text = (
            f"{where}: the fit is free of bounds, and found the machine elsewhere than its owner "
            "did; are the units, the start, and the bounds right?"
        )
        notes.append(Note(Code.OUTSIDE_BOUNDS, text, values={name: ends[name] for name in out}))
    lost = search.verdict == "unknown" and search.gap.train_before > _FAR_OFF  # noise alone does not cause that
    # where the noise is learned, that of columns that do not belong together is as large as they are
    learned = search.verdict in ("none", "noise") and unknown_noise_of(formulation) and inputs_of(formulation)
    if (lost or learned) and as_far_as_shuffled(formulation, search.base.x):
        text = (
            "the calibrated model is hardly nearer to the readings than to shuffled ones: are these readings of this "
            "machine, is each column under its own name, and is each row of one reading?"
        )
        notes.append(Note(Code.FAR_FROM_MODEL, text))
    if search.findings and search.lone is not None:
        unseen, row, times = search.lone
        reading, names, rows = _told_of(unseen, row)
        text = (
            f"one reading ({reading}) makes most of the error of the readings that were not fitted: without it what "
            f"was added brings that error to {plain(times, 2)} times what it was; was it misread, or is no other "
            "reading near it?"
        )
        notes.append(Note(Code.ONE_UNSEEN, text, names, rows, {"times": times}))
    notes += (*given, *_on_the_readings(search), *on_the_findings(search))
    columns, first = roles_of(formulation).columns, search.selection.first
    if columns and not measured_columns(formulation):
        text = (
            f"columns {', '.join(columns)}: nothing but joints is read, so no trend over them has a name; a joint's "
            f'own are declared with it, such as Joint(temperature="{columns[0]}")'
        )
        notes.append(Note(Code.NO_TRENDS, text, columns))
    for s in best_of_each(first.names, first.on)[:1] if search.selection.alarm else ():
        size = s.effect.amplitude(s.coefficients)
        if s.m and np.isfinite(size) and not is_possible(s.effect, size):
            unit = s.effect.unit
            shown = f"{plain(100 * abs(size))} %" if unit == "1" else f"{plain(abs(size))} {unit}"
            name = effect_label(search.machine, s.effect.family, s.effect.target)
            text = f"{name} would explain most, but it would have to be {shown}: taken for impossible"
            notes.append(Note(Code.IMPOSSIBLE_SIZE, text, values={"effect": s.name, "size": abs(size), "unit": unit}))
    return tuple(notes)


def outside_bounds(parameters: Iterable[Parameter], ends: Mapping[str, float]) -> tuple[tuple[str, ...], str]:
    """Return the names of the parameters that end outside their bounds, the furthest first, and where, in words.

    Of many only the first have numbers, as a table has them all.
    """
    beyond = {}  # in widths of their box
    for p in parameters:
        end = ends.get(p.name, p.lower)
        beyond[p] = max(p.lower - end, end - p.upper) / max(p.upper - p.lower, _NARROW)
    out = sorted((p for p in beyond if beyond[p] > 0), key=lambda p: -beyond[p])
    first, others = (out[:_SHOWN], out[_SHOWN:]) if len(out) > _SHOWN + 1 else (out, [])
    at = {p: f"{ends[p.name]:.6g} {p.unit}".strip() for p in first}
    shown = [f"{p.name} ends at {at[p]}, outside {p.lower:g} to {p.upper:g}" for p in first]
    if others:
        shown.append(f"outside theirs are {len(others)} more: {', '.join(p.name for p in others)}")
    return tuple(p.name for p in out), "; ".join(shown)


def _told_of(formulation: Formulation, row: int) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Return a reading in words, its columns, inputs and then readings, and its row in the file."""
    data, label = formulation.data, np.array([row])
    names = [name for name in dict.fromkeys((*inputs_of(formulation), *formulation.readings)) if name in data]
    reading = ", ".join(f"{name} {plain(float(np.asarray(data[name])[row]), 5)}" for name in names[:_COLUMNS])
    return f"{data.rows_named(label)}: {reading}", tuple(names), data.labels(label)


def _on_the_readings(search: Search) -> Iterator[Note]:
    formulation = search.base.model.formulation
    if (one := one_reading(search.base)) is not None:
        row, times = one
        reading, names, rows = _told_of(formulation, row)
        text = (
            f"one reading ({reading}) makes nearly all of what the calibrated model leaves: without it the others lie "
            f"{plain(times, 2)} times nearer; look at it, and leave its row out if it was misread"
        )
        yield Note(Code.ONE_READING, text, names, rows, {"times": times})
    if (standing := search.standing) is not None:
        # the rows that stand out, runs of them as "94 to 106"
        runs = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in standing.runs]
        shown = ", ".join(runs[:_RUNS])
        shown += f" and {counted(len(runs) - _RUNS, 'place')} more" if len(runs) > _RUNS else ""
        count, by = sum(map(len, standing.runs)), ""
        if standing.sensor:
            [sensor] = [s for s in formulation.sensors if s.column == standing.sensor]
            scale, unit = _LIKE_A_READING.get(sensor.unit, (1.0, sensor.unit))
            size = f"{plain(scale * standing.size, 2)} {unit}".rstrip()
            by = f", as errors of {standing.sensor} of {size} would make them"
        text = (
            f"row{'s' * (count > 1)} {shown} stand{'s' * (count == 1)} out: {plain(standing.times, 2)} times the noise "
            f"off where no other rows are{by}; were they misread, or did something happen then?"
        )
        rows = tuple(str(k) for run in standing.runs for k in run)
        columns = (standing.sensor,) if standing.sensor else ()
        yield Note(Code.ROWS_STAND_OUT, text, columns, rows, {"times": standing.times})
    if levels := exact_readings(search.base):
        name, (count, times) = max(levels.items(), key=lambda one: one[1][1])
        inputs, measured = ", ".join(inputs_of(formulation)), ", ".join(formulation.readings)
        text = (
            f"{name} comes in {count} levels, and moves {plain(times, 2)} times less within one than its prediction "
            f"does, as what was commanded does: the noise is that of the inputs ({inputs}); predict these from "
            f"{measured}, else their error is told as what is missing"
        )
        yield Note(Code.EXACT_READINGS, text, (name,), values={"levels": count, "times": times})
    if (less := less_than_stated(search.final)) is not None:
        text = (
            f"what is left is {plain(less, 2)} times the stated noise, which is too large: what is small beside it is "
            "not found; state it as it is, or leave it out to have it learned"
        )
        yield Note(Code.NOISE_TOO_WIDE, text, values={"times": less})
    equations, calibrated = search.base.J.shape
    left = len(search.base.r) - calibrated
    if left <= thresholds().few_degrees:
        words = f"{counted(left, 'equation')} left after calibration, too few to show a missing effect"
        yield Note(Code.FEW_LEFT, f"{words}; take more readings", values={"equations": left})
    unstated = any(note.code in NOISE_UNSTATED for note in formulation.data.notes)
    if search.findings and unstated and equations < thresholds().equations_each * calibrated:
        text = (
            f"{counted(equations, 'equation')} for {counted(calibrated, 'calibrated parameter')}, and the noise is not "
            "stated: names found from so few equations often do not hold for other readings; take more, and keep some "
            "of them out of the fit (split=hold) to test the names"
        )
        yield Note(Code.FEW_EQUATIONS, text, values={"equations": equations, "parameters": calibrated})


def on_the_findings(search: Search) -> Iterator[Note]:
    """Yield notes on findings whose size does not mean what it seems to."""
    words = words_of(roles_of(search.base.model.formulation))
    effects = {name_of(e): e for e in search.final.model.effects}
    labels = {one.effect: effect_label(search.machine, one.family, one.target) for one in search.findings}
    for one in search.findings:
        family = family_of(search.machine, one.family)
        names = effects[one.effect].columns if one.effect in effects else ()
        if family and family.never_negative and max(one.amplitude.ci95) < 0:
            followed = " and ".join(f"the {quantity_label(search.machine, name, words)}" for name in names)
            text = (
                f"the size of {labels[one.effect]} is negative, and a {family.never_negative} never is: either "
                f"{followed or 'a column'} has the other sign, or another cause acts like it"
            )
            yield Note(Code.NEGATIVE_SIZE, text, names, values={"effect": one.effect, "size": one.amplitude.value})
    # of several terms over a part of a turn most nearly cancel, or are a constant that calibration takes up
    moved: dict[str, list[tuple[Finding, Array]]] = {}
    final, data = search.final, search.final.model.formulation.data
    numbers = {name_of(effect): (effect, c) for effect, c in final.model.coefficients(final.x)}
    for one in search.findings:
        changes: dict[str, Array] = {}  # by how much a finding, with its form, moves what was read; none of the noise
        if one.effect in numbers:
            parts = [numbers[one.effect][0], *forms_of(numbers[one.effect][0], final.model.effects)]
            shifts = [part.shift(final.at.recorded, data, numbers[name_of(part)][1]) for part in parts]
            changes = {n: np.asarray(sum(np.asarray(s[n]) for s in shifts if n in s)) for n in shifts[0]}
        for name, change in changes.items():
            moved.setdefault(name, []).append((one, change))
        swing = max((float(np.ptp(change)) / 2 for change in changes.values()), default=0.0)
        effect = effects.get(one.effect)
        unit = effect.unit if effect is not None and len(effect.coefficients) > 1 else ""
        if unit in _LIKE_A_READING and 0 < swing < _SEEN * abs(one.amplitude.value):
            scale, shown = _LIKE_A_READING[unit]
            text = (
                f"{labels[one.effect]}: over what was read it goes up and down by {plain(scale * swing, 2)} {shown} "
                "alone; its terms cancel there, or calibration takes them up: the size is that of the formula, which "
                "tells nothing of other places"
            )
            about = {"effect": one.effect, "size": one.amplitude.value, "swing": swing, "unit": unit}
            yield Note(Code.MOSTLY_UNSEEN, text, values=about)
    # the error of a formula is taken up by another name on the same part, with the other sign
    words = words_of(roles_of(search.final.model.formulation))
    for name, those in moved.items():
        together = float(np.ptp(sum(change for _, change in those)))
        large = [one.effect for one, change in those if float(np.ptp(change)) > _AGAINST * together > 0]
        if len(large) > 1:
            text = (
                f"{' and '.join(labels[effect] for effect in large)} move "
                f"{quantity_label(search.machine, name, words)} against each other, more than {_AGAINST:g} times as "
                "far as together: beside each other none of them has the size of a cause"
            )
            yield Note(Code.AGAINST_EACH_OTHER, text, (name,), values={"effects": large})
    count = Counter(one.target for one in search.findings if one.family in PERIODIC)
    for target, many in count.items():
        if many >= _MANY:
            text = (
                f"the {many} waves of {part_label(search.machine, target)} tell together what its error is like over "
                "its way, and not what causes it: an error at one place is a sum of waves as well"
            )
            yield Note(Code.MANY_WAVES, text, values={"waves": many, "target": target})
