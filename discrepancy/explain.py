"""`explain`: fit -> test -> where -> name -> add -> refit -> validate -> verdict, on one set of measured data."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.process import one_thread
from calibench.discrepancy.checks.validate import listen, refuse_unused, validate
from calibench.discrepancy.diagnostics.noise import law_at, learned_beside, noise_at, outliers_under, sound_fit
from calibench.discrepancy.diagnostics.score import uncancelled
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, joint_terms, smooth_columns, smooth_terms
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import PLACE, Fit, fit, with_columns
from calibench.discrepancy.fitting.kept import fit_from_several, keeping_fits
from calibench.discrepancy.fitting.rank import Held, Undetermined, determined, nominal_of, spread
from calibench.discrepancy.fitting.residual_problem import ResidualProblem
from calibench.discrepancy.labels import quantity_of
from calibench.discrepancy.model.effect import Catalogue, Effect
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import roles_of, unknown_noise_of, words_of
from calibench.discrepancy.noise.laws import NoiseFinding
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.remarks import Search, notes_of
from calibench.discrepancy.report import (
    Candidate,
    Finding,
    Fitted,
    Gap,
    Invisible,
    Left,
    OtherNoise,
    ParameterChange,
    Place,
    ReadingNoise,
    Report,
    Verdict,
)
from calibench.discrepancy.search.finding import parted_by
from calibench.discrepancy.search.select import Tests, best_of_each, delta_bic
from calibench.discrepancy.search.smoother import NEAR, fit_smooth, nearest_of, shortest_of, unnamed_of
from calibench.discrepancy.search.stepwise import Selection, judge, select_stepwise, with_alternatives
from calibench.discrepancy.thresholds import THRESHOLDS, Thresholds, using
from calibench.discrepancy.thresholds import thresholds as current_thresholds
from calibench.discrepancy.validation import gap_of
from calibench.problems.base import Array

GAP_OF_FITTED = (
    "no rows are held out, and without a part of them the rest does not determine what was added: the gap is that of "
    "the fitted readings"
)
_LEARNED = 3  # times that unknown noise is learned again at most: names and noise settle together, or never
_OTHERS = (0.5, 2.0)  # times the stated noise: the search is repeated there where no repeats tell the noise


def explain(
    machine: str | Machine, data: MeasuredData, *, seed: int = 0, level: float = 0.01,
    thresholds: Thresholds = THRESHOLDS,
) -> Report:  # fmt: skip
    """Return what is missing from the machine's model according to `data`, with error rates held at `level`.

    The same data and seed give the same report. Raises `DataError` for data that cannot be of this machine.
    """
    if not isinstance(data, MeasuredData):
        raise TypeError(
            f"data is a {type(data).__name__}: MeasuredData(columns, machine) or bench.read_measured is needed"
        )
    if not isinstance(level, int | float) or not 0 < level < 1:
        raise ValueError(f"level={level}: must lie between 0 and 1")
    with one_thread(), using(thresholds), keeping_fits():
        return _explained(machines.make(machine) if isinstance(machine, str) else machine, data, seed, level)


def _explained(machine: Machine, data: MeasuredData, seed: int, level: float) -> Report:
    began, rng = time.process_time(), np.random.default_rng(seed)
    data, asked = listen(data)
    whole = validate(machine, data, _in_order)
    train, hold = _parts(whole.data)
    # fit: the machine without effects, under the noise that repeats show
    plain, lacking, notes_of_fit = _calibrated(whole.on(whole.data.rows(train)))
    parameters = {p.name: p for p in whole.parameters}
    whole = Held(whole, frozenset(u.name for u in lacking)) if lacking else whole
    sound, suspects, misstated = sound_fit(plain)
    noise, notes_of_noise = noise_at(sound, suspects, whole)
    base = sound if noise == sound.noise else fit(Model(plain.model.formulation), noise, sound.x, about=sound)
    base = with_columns(base, smooth_columns(base.at.model.formulation, base.x))
    # test, and where: every name of the catalogue, and smooth terms over each column
    terms, known = smooth_terms(base), catalogue(whole)
    refuse_unused(machine.name, data, asked)
    # name, add, refit: until what remains looks like noise
    selection, base, suspects, notes_of_noise = _selected(
        base, known.candidates, terms, suspects, notes_of_noise, rng, level
    )
    selection = replace(selection, sets=with_alternatives(selection.sets, base, known.alternatives))
    verdict, findings, selection = judge(selection, base, terms, suspects, level)
    # validate: on rows that were not fitted; names that help nothing there are none
    final = base if verdict == "none" else _smooth(base, terms) if verdict == "unknown" else selection.fit
    unseen = _unseen(base, whole.data.rows(hold)) if hold.any() else None
    gap, lone = gap_of(base, final, unseen, suspects, rng)
    noisy = any(f.family == s.family for f in findings for s in suspects)  # a law of the noise moves no mean
    if not noisy and _carried_by_nothing(findings, gap):
        verdict, findings, final = "unknown", (), _smooth(base, terms)
        gap, lone = gap_of(base, final, unseen, suspects, rng)
    # verdict
    rest = _rest(gap, final, selection.last) if findings else None
    verdict = _short_of(verdict, rest)
    if findings and final.noise.profiled and not final.exact and selection.last.still < level:
        verdict = "partly"  # without repeats the noise is unknown, so only the tests can say whether something is left
    doubted = base.noise.profiled and not unknown_noise_of(base.model.formulation)
    others = _at_other_noise(base, known.candidates, terms, suspects, rest, seed, level) if doubted else ()
    search = Search(
        machine=machine.name, base=base, final=final, selection=selection, verdict=verdict, findings=findings,
        gap=gap, lone=lone,
    )  # fmt: skip
    held = [u.note(parameters[u.name]) for u in lacking]
    given = (*held, *notes_of_fit, *_settled(whole.data.notes, gap, base.noise), *misstated, *notes_of_noise)
    report = _report(search, whole, known)
    return replace(
        report,
        parameters=_parameters(base, final, lacking),
        notes=notes_of(search, given),
        left=rest,
        other_noise=others,
        fitted=Fitted(ResidualProblem(final.model, final), ResidualProblem(base.model, base), machine),
        seconds=time.process_time() - began,
    )


def _report(search: Search, whole: Formulation, known: Catalogue) -> Report:
    """Return what a report says of a search by itself: its verdict, names and places, what it could and could not see.

    `whole` has the held-out rows too.
    """
    first, machine = search.selection.first, search.machine
    invisible, table = _table(first, search.base)
    named: dict[str, Any] = {"where": _where(first) if search.verdict != "none" else ()}
    if search.verdict == "unknown":
        nearest = nearest_of(first)
        # the other kinds of readings that would part what was found, and the nearest formula, from their twins
        found = search.selection
        sets = [[o.effect for o in own] for own in found.sets]
        if nearest is not None and nearest.share >= NEAR:
            sets.append([o.effect for o in best_of_each(found.first.names, found.first.on)[:1]])
        parted = tuple(dict.fromkeys(kind for own in sets if (kind := parted_by(own, machine))))
        named |= {"unnamed": unnamed_of(search.final), "nearest": nearest, "parted_by": parted}
    # the standard deviation of each kind of reading, the median over the rows, alike to three digits
    formulation = search.final.model.formulation
    kinds: dict[tuple[str, str], tuple[float, list[str]]] = {}
    for sensor in formulation.sensors:
        unit = sensor.unit or quantity_of(formulation.data.machine, sensor.column).unit
        size = float(np.median(formulation.sigma[sensor.column]))
        kinds.setdefault((f"{size:.3g}", unit), (size, []))[1].append(sensor.column)
    return Report(
        case=whole.data.name,
        machine=machine,
        verdict=search.verdict,
        findings=search.findings,
        gap=search.gap,
        not_testable=known.untestable,
        invisible=invisible,
        p=search.selection.p,
        shortest=shortest_of(known.candidates),
        reading_noise=tuple(ReadingNoise(tuple(columns), size, unit) for (_, unit), (size, columns) in kinds.items()),
        words={n: words for n, words in words_of(roles_of(whole)).items() if not quantity_of(machine, n).label},
        candidates=table,
        **named,
    )


def _smooth(base: Fit, terms: Sequence[SmoothTerm]) -> Fit:
    return fit_smooth(base, (*terms, *joint_terms(base)))


def _unseen(base: Fit, hold: MeasuredData) -> Formulation:
    """Return the formulation over rows that were not fitted, with the columns of the smooth terms."""
    unseen = base.model.formulation.on(hold)
    return unseen.on(unseen.data.with_columns(smooth_columns(unseen, base.x)))


def _calibrated(formulation: Formulation) -> tuple[Fit, tuple[Undetermined, ...], tuple[Note, ...]]:
    """Return the fit without effects, the parameters that these data do not determine, and notes on other starts."""
    plain, started = fit_from_several(formulation)
    formulation, plain, lacking = determined(formulation, plain)
    if lacking and started:  # the parameters that led the fit away from the nominal machine may be held now
        plain, started = fit_from_several(formulation)
    return plain, lacking, started


def _selected(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], suspects: tuple[NoiseFinding, ...],
    notes: tuple[Note, ...], rng: np.random.Generator, level: float,
) -> tuple[Selection, Fit, tuple[NoiseFinding, ...], tuple[Note, ...]]:  # fmt: skip
    """Return the selection, the fit without effects, the suspects that remain, and notes on the noise.

    The search is repeated where what was found explains a suspect, or why repeats scattered so much, and where noise
    that nobody states was learned with the found effects in the residuals.
    """
    model = Model(base.model.formulation)
    found = select_stepwise(base, candidates, terms, rng, level)
    if cleared := _cleared(found, suspects):
        suspects = tuple(s for s in suspects if s not in cleared)
        noise, notes = _without(cleared, found, base.noise)
        base = fit(model, noise, base.x)
        found = select_stepwise(base, candidates, terms, rng, level)
    if (calmer := _relearned(found, base.noise)) is not None:
        noise, notes = calmer
        base = fit(model, noise, base.x)
        found = select_stepwise(base, candidates, terms, rng, level)
    for _ in range(_LEARNED if unknown_noise_of(base.model.formulation) else 0):
        verdict, _, standing = judge(found, base, terms, suspects, level)
        if verdict == "unknown" or not found.sets or found.fit.exact:
            break
        formulation, noise, notes_now = learned_beside(standing.fit, suspects)
        at = fit(Model(formulation), noise, base.x)
        again = select_stepwise(at, candidates, terms, rng, level) if at.converged else None
        if again is None or not again.sets:
            break
        before, found, base, notes = _names(found), again, at, notes_now
        if _names(found) == before:
            break
    return found, base, suspects, notes


def _names(found: Selection) -> set[str]:
    return {own[0].name for own in found.sets}


def _cleared(found: Selection, suspects: Sequence[NoiseFinding]) -> tuple[NoiseFinding, ...]:
    """Return the suspects of outlying readings that have less than one such reading beside the effects that were found.

    Repeats that were approached from both sides differ by the play of a joint. That looks like wild readings: half of
    them are far off.
    """
    if not found.sets:
        return ()
    wild = [s for s in suspects if s.family == "outlier"]
    beside = [outliers_under(found.fit.model, found.fit.x, s.target) for s in wild]
    return tuple(s for s, now in zip(wild, beside, strict=True) if float(now.weights.sum()) < 1.0)


def _without(cleared: Sequence[NoiseFinding], found: Selection, noise: Noise) -> tuple[Noise, tuple[Note, ...]]:
    """Return the noise given what was found, without the variance of the `cleared` suspects, and notes on it."""
    extra = dict(noise.extra)
    for suspect in cleared:
        for name, variance in suspect.extra.items():
            extra[name] = extra[name] - variance
    extra = {name: variance for name, variance in extra.items() if np.any(variance)}
    at = fit(found.fit.model, Noise(extra=extra), found.fit.x)
    law, _, notes = law_at(at)
    return replace(law, extra=extra, profiled=law.profiled or noise.profiled), notes


def _relearned(found: Selection, noise: Noise) -> tuple[Noise, tuple[Note, ...]] | None:
    """Return a smaller noise, with notes, where the found effects explain the differences of the repeats; else None.

    Repeats some time apart also differ by a drift. If the drift were taken for noise, it would stay hidden and widen
    all intervals.
    """
    as_stated = noise.scale <= 1 and not np.isfinite(noise.t_degrees)
    if not found.sets or noise.autocorrelation > 0 or as_stated:
        return None
    at = fit(found.fit.model, Noise(extra=noise.extra), found.fit.x)
    law, _, notes = law_at(at)
    calmer = noise.scale > 1 and law.scale < current_thresholds().calmer * noise.scale
    thinner = np.isfinite(noise.t_degrees) and not np.isfinite(law.t_degrees)
    if calmer or (thinner and law.scale <= max(noise.scale, 1.0)):  # a wider law would absorb what was found
        return replace(law, extra=noise.extra), notes
    return None


def _where(tests: Tests) -> tuple[Place, ...]:
    ranked = sorted(tests.smooth, key=lambda s: s.p)
    return tuple(Place(s.effect.target, s.effect.covariate, s.p) for s in ranked if isinstance(s.effect, SmoothTerm))


def _short_of(verdict: Verdict, left: Left | None, noise: float = 1.0) -> Verdict:
    """Return the verdict, or "partly" where the remaining error is above `floors_left` noise floors.

    `noise` is the factor at which the stated noise is multiplied in this search.
    """
    many = left is not None and left.times > noise * current_thresholds().floors_left
    return "partly" if many and verdict in ("named", "ambiguous", "negligible") else verdict


def _settled(notes: Iterable[Note], gap: Gap, noise: Noise) -> Iterator[Note]:
    """Yield the notes of the data as they hold now that the search is done."""
    for note in notes:
        if note.code is Code.NOT_HELD_OUT and not gap.cross_validated:
            note = Note(Code.GAP_OF_FITTED, GAP_OF_FITTED)
        if note.code is Code.NOISE_LEARNED and noise.from_repeats:
            text = f"the noise is not stated: that of {', '.join(note.columns)} is told by repeats"
            note = Note(Code.NOISE_UNSTATED, text, note.columns)
        yield note


def _carried_by_nothing(findings: Sequence[Finding], gap: Gap) -> bool:
    """Return whether no finding has a size that is surely not 0, and unseen readings are no nearer with them.

    Of few readings a name can explain a part with a free form beside it: then neither its size nor its sign is known.
    """
    sized = [f.amplitude.ci95 for f in findings if np.all(np.isfinite(f.amplitude.ci95))]
    unsure = len(sized) == len(findings) > 0 and all(low <= 0 <= high for low, high in sized)
    return unsure and bool(gap.held_out_after >= gap.held_out_before)


def _at_other_noise(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], suspects: Sequence[NoiseFinding],
    left: Left | None, seed: int, level: float,
) -> tuple[OtherNoise, ...]:  # fmt: skip
    """Return the verdict and the names of the search at half and at twice the stated noise."""
    others = []
    for factor in _OTHERS:
        at = replace(base, noise=replace(base.noise, scale=factor * base.noise.scale))
        found = select_stepwise(at, candidates, terms, np.random.default_rng(seed), level)
        verdict, findings, _ = judge(found, at, terms, suspects, level)
        others.append(OtherNoise(factor, _short_of(verdict, left, factor), tuple(f.effect for f in findings)))
    return tuple(others)


def _rest(gap: Gap, final: Fit, last: Tests) -> Left:
    """Return the error that remains with the names: on held-out rows, or else on all fitted rows.

    On fitted rows it is corrected for the number of parameters. Where only a few poses are left out in turn, an excess
    counts only if its whole interval is above the limit.
    """
    most = current_thresholds().floors_left
    kept = np.isfinite(gap.held_out_after) and not gap.cross_validated
    surely = gap.held_out_ci95[0] > most * gap.noise_floor
    times = gap.held_out_after / gap.noise_floor if kept or surely else gap.train_after / final.noise.scale
    place = min(_where(last), key=lambda p: p.p, default=None)
    shows = place is not None and place.p < current_thresholds().p_calm
    return Left(float(times), place if shows else None)


def _table(tests: Tests, base: Fit) -> tuple[tuple[Invisible, ...], tuple[Candidate, ...]]:
    best = best_of_each(tests.names, tests.on)
    seen = {s.name: s.visible * uncancelled(s.effect, base) for s in best}
    hidden = tuple(
        Invisible(s.name, s.effect.family, s.effect.target, seen[s.name], s.detectable(len(best)), s.effect.unit)
        for s in best
        if not s.m or s.visible < current_thresholds().visible or seen[s.name] < current_thresholds().invisible
    )
    table = tuple(
        Candidate(
            effect=s.name,
            family=s.effect.family,
            target=s.effect.target,
            gain=delta_bic(s, tests.on),
            p=s.p,
            visible_fraction=seen[s.name],
            minimum_detectable=s.detectable(len(best)),
            unit=s.effect.unit,
        )
        for s in best
    )
    return hidden, table


def _parameters(base: Fit, final: Fit, lacking: tuple[Undetermined, ...]) -> dict[str, ParameterChange]:
    sd = spread(final, lacking)
    names = [p.name for p in base.model.formulation.parameters]
    changes = {n: ParameterChange(float(base.x[k]), float(final.x[k]), float(sd[k])) for k, n in enumerate(names)}
    held = nominal_of(final.model.formulation, lacking)
    return changes | {name: ParameterChange(value, value, float("nan")) for name, value in held.items()}


def _in_order(data: MeasuredData) -> MeasuredData:
    """Return the rows in the order of time, each with its place."""
    n = len(data)
    time_ = np.asarray(data["t_s"]) if data.has("t_s") else np.arange(n)
    order = np.argsort(time_, kind="stable")
    places = np.empty(n)
    places[order] = np.arange(n)
    return data.with_columns({PLACE: places}).rows(order)


def _parts(data: MeasuredData) -> tuple[Array, Array]:
    if not data.has("split"):
        return np.ones(len(data), dtype=bool), np.zeros(len(data), dtype=bool)
    hold = np.asarray(data["split"]) == "hold"
    return ~hold, hold
