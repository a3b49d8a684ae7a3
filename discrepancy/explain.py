"""`explain`: fit -> test -> where -> name -> add -> refit -> validate -> verdict, on one set of measured data."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibench.core.process import one_thread
from calibench.core.words import counted, plain
from calibench.discrepancy.checks.validate import CROSSED, NOT_CROSSED, listening, refuse_unused, validated
from calibench.discrepancy.checks.wild import far_words, outside_bounds
from calibench.discrepancy.diagnostics.noise import (
    exact_readings,
    few_equations,
    law_at,
    learned_beside,
    less_than_stated,
    noise_at,
    one_reading,
    outliers_under,
    sound_fit,
)
from calibench.discrepancy.diagnostics.score import uncancelled
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, joint_terms, smooth_columns, smooth_terms
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.effects.general.columns import measured_columns
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.fitting.fit import PLACE, Fit, fit, with_columns
from calibench.discrepancy.fitting.kept import fit_from_several, keeping_fits
from calibench.discrepancy.fitting.rank import Held, Undetermined, determined, nominal_of, spread
from calibench.discrepancy.fitting.residual_problem import ResidualProblem
from calibench.discrepancy.labels import effect_label, part_label, quantity_of
from calibench.discrepancy.model.effect import Effect, is_possible
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import LEARNED, MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import roles_of, unknown_noise_of, words_of
from calibench.discrepancy.noise.laws import NoiseFinding
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.report import (
    Candidate,
    Finding,
    Fitted,
    Gap,
    Invisible,
    Left,
    Nearest,
    OtherNoise,
    ParameterChange,
    Place,
    ReadingNoise,
    Report,
    Verdict,
)
from calibench.discrepancy.search.finding import cancelling, mostly_unseen, negative_size, parted_by
from calibench.discrepancy.search.select import Tests, best_of_each, delta_bic
from calibench.discrepancy.search.smoother import NEAR, nearest_of, shortest_of, smoothed, unnamed_of
from calibench.discrepancy.search.stepwise import Selection, judged, select_stepwise, with_alternatives
from calibench.discrepancy.thresholds import THRESHOLDS, Thresholds, using
from calibench.discrepancy.thresholds import thresholds as current_thresholds
from calibench.discrepancy.validation import gap_of
from calibench.problems.base import Array

_FAR_OFF = 20.0  # times the noise
_MANY = 3  # waves of one part
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
        return _explained(machine, data, seed, level)


def _explained(machine: str | Machine, data: MeasuredData, seed: int, level: float) -> Report:
    began = time.process_time()
    rng = np.random.default_rng(seed)
    machine = machines.make(machine) if isinstance(machine, str) else machine
    data, asked = listening(data)
    whole = validated(machine, data, _in_order)
    data = whole.data
    train, hold = _parts(data)
    plain, lacking, started = _calibrated(whole.on(data.rows(train)))
    parameters = {p.name: p for p in whole.parameters}
    held = tuple(u.told(parameters[u.name]) for u in lacking)
    whole = Held(whole, frozenset(u.name for u in lacking)) if lacking else whole
    sound, suspects, misstated = sound_fit(plain)
    noise, remarks = noise_at(sound, suspects, whole)
    formulation = plain.model.formulation
    base = sound if noise == sound.noise else fit(Model(formulation), noise, sound.x, about=sound)
    base = with_columns(base, smooth_columns(base.at.model.formulation, base.x))
    formulation = base.model.formulation
    terms = smooth_terms(base)
    known = catalogue(whole)
    refuse_unused(machine.name, data, asked)

    found, base, suspects, remarks = _searched(base, known.candidates, terms, suspects, remarks, rng, level)
    found = replace(found, sets=with_alternatives(found.sets, base, known.alternatives))
    verdict, findings, found = judged(found, base, terms, suspects, level)
    final = found.fit
    if verdict in ("none", "unknown"):
        final = base if verdict == "none" else smoothed(base, (*terms, *joint_terms(base)))
    unseen = base.model.formulation.on(data.rows(hold)) if hold.any() else None
    if unseen is not None:
        unseen = unseen.on(unseen.data.with_columns(smooth_columns(unseen, base.x)))
    gap, lone = gap_of(base, final, unseen, suspects, rng)
    named = not any(f.family == s.family for f in findings for s in suspects)  # a law of the noise moves no mean
    if named and _carried_by_nothing(findings, gap):
        verdict, findings, final = "unknown", (), smoothed(base, (*terms, *joint_terms(base)))
        gap, lone = gap_of(base, final, unseen, suspects, rng)
    left = _left(gap, final, found.last) if findings else None
    verdict = _short_of(verdict, left)
    if findings and final.noise.profiled and not final.exact and found.last.still < level:
        verdict = "partly"  # without repeats the noise is unknown, so only the tests can say whether something is left
    doubted = base.noise.profiled and not unknown_noise_of(base.model.formulation)
    others = _at_other_noise(base, known.candidates, terms, suspects, left, seed, level) if doubted else ()
    invisible, table = _table(found.first, base)
    nearest = nearest_of(found.first) if verdict == "unknown" else None
    return Report(
        case=data.name,
        machine=machine.name,
        verdict=verdict,
        findings=findings,
        gap=gap,
        where=_where(found.first) if verdict != "none" else (),
        not_testable=known.untestable,
        invisible=invisible,
        parameters=_parameters(base, final, lacking),
        seconds=time.process_time() - began,
        p=found.p,
        notes=(
            *_beyond(final),
            *(far_words(formulation, base.x) if _lost(verdict, gap) else ()),
            *(lone if findings else ()),
            *held,
            *started,
            *_told_notes(whole.data.notes, gap, base.noise),
            *misstated,
            *remarks,
            *one_reading(base),
            *exact_readings(base),
            *less_than_stated(final),
            *_scarce(base),
            *(few_equations(base) if findings else ()),
            *negative_size(final, findings),
            *mostly_unseen(final, findings),
            *cancelling(final, findings),
            *_many_waves(findings, machine.name),
            *_unfollowed(formulation),
            *_impossible(found, machine.name),
        ),
        left=left,
        other_noise=others,
        unnamed=unnamed_of(final) if verdict == "unknown" else (),
        nearest=nearest,
        shortest=shortest_of(known.candidates),
        parted_by=_parted_by(found, nearest, machine.name) if verdict == "unknown" else (),
        reading_noise=_reading_noise(final.model.formulation),
        words={n: words for n, words in words_of(roles_of(whole)).items() if not quantity_of(machine.name, n).label},
        candidates=table,
        fitted=Fitted(ResidualProblem(final.model, final), ResidualProblem(base.model, base), machine),
    )


def _reading_noise(formulation: Formulation) -> tuple[ReadingNoise, ...]:
    """Return the standard deviation of each kind of reading, the median over the rows, alike to three digits."""
    kinds: dict[tuple[str, str], tuple[float, list[str]]] = {}
    for sensor in formulation.sensors:
        unit = sensor.unit or quantity_of(formulation.data.machine, sensor.column).unit
        size = float(np.median(formulation.sigma[sensor.column]))
        kinds.setdefault((f"{size:.3g}", unit), (size, []))[1].append(sensor.column)
    return tuple(ReadingNoise(tuple(columns), size, unit) for (_, unit), (size, columns) in kinds.items())


def _calibrated(formulation: Formulation) -> tuple[Fit, tuple[Undetermined, ...], tuple[str, ...]]:
    """Return the fit without effects, the parameters that these data do not determine, and notes on other starts."""
    plain, started = fit_from_several(formulation)
    formulation, plain, lacking = determined(formulation, plain)
    if lacking and started:  # the parameters that led the fit away from the nominal machine may be held now
        plain, started = fit_from_several(formulation)
    return plain, lacking, started


def _many_waves(findings: Sequence[Finding], machine: str) -> tuple[str, ...]:
    """Return a note for each part with three or more waves of unstated periods: any shape is a sum of some."""
    count = Counter(one.target for one in findings if one.family in PERIODIC)
    return tuple(
        f"the {many} waves of {part_label(machine, target)} tell together what its "
        "error is like over its way, and not what causes it: an error at one place is a sum of waves as well"
        for target, many in count.items()
        if many >= _MANY
    )


def _searched(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], suspects: tuple[NoiseFinding, ...],
    remarks: tuple[str, ...], rng: np.random.Generator, level: float,
) -> tuple[Selection, Fit, tuple[NoiseFinding, ...], tuple[str, ...]]:  # fmt: skip
    """Return the selection, the fit without effects, the suspects that remain, and remarks on the noise.

    The search is repeated where what was found explains a suspect, or why repeats scattered so much, and where noise
    that nobody states was learned with the found effects in the residuals.
    """
    model = Model(base.model.formulation)
    found = select_stepwise(base, candidates, terms, rng, level)
    if cleared := _cleared(found, suspects):
        suspects = tuple(s for s in suspects if s not in cleared)
        noise, remarks = _without(cleared, found, base.noise)
        base = fit(model, noise, base.x)
        found = select_stepwise(base, candidates, terms, rng, level)
    if (calmer := _relearned(found, base.noise)) is not None:
        noise, remarks = calmer
        base = fit(model, noise, base.x)
        found = select_stepwise(base, candidates, terms, rng, level)
    for _ in range(_LEARNED if unknown_noise_of(base.model.formulation) else 0):
        verdict, _, standing = judged(found, base, terms, suspects, level)
        if verdict == "unknown" or not found.sets or found.fit.exact:
            break
        formulation, noise, told = learned_beside(standing.fit, suspects)
        at = fit(Model(formulation), noise, base.x)
        again = select_stepwise(at, candidates, terms, rng, level) if at.converged else None
        if again is None or not again.sets:
            break
        before, found, base, remarks = _names(found), again, at, told
        if _names(found) == before:
            break
    return found, base, suspects, remarks


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


def _without(cleared: Sequence[NoiseFinding], found: Selection, noise: Noise) -> tuple[Noise, tuple[str, ...]]:
    """Return the noise given what was found, without the variance of the `cleared` suspects, and remarks on it."""
    extra = dict(noise.extra)
    for suspect in cleared:
        for name, variance in suspect.extra.items():
            extra[name] = extra[name] - variance
    extra = {name: variance for name, variance in extra.items() if np.any(variance)}
    at = fit(found.fit.model, Noise(extra=extra), found.fit.x)
    law, _, remarks = law_at(at)
    return replace(law, extra=extra, profiled=law.profiled or noise.profiled), remarks


def _relearned(found: Selection, noise: Noise) -> tuple[Noise, tuple[str, ...]] | None:
    """Return a smaller noise, with remarks, where the found effects explain the differences of the repeats; else None.

    Repeats some time apart also differ by a drift. If the drift were taken for noise, it would stay hidden and widen
    all intervals.
    """
    as_stated = noise.scale <= 1 and not np.isfinite(noise.t_degrees)
    if not found.sets or noise.autocorrelation > 0 or as_stated:
        return None
    at = fit(found.fit.model, Noise(extra=noise.extra), found.fit.x)
    law, _, remarks = law_at(at)
    calmer = noise.scale > 1 and law.scale < current_thresholds().calmer * noise.scale
    thinner = np.isfinite(noise.t_degrees) and not np.isfinite(law.t_degrees)
    if calmer or (thinner and law.scale <= max(noise.scale, 1.0)):  # a wider law would absorb what was found
        return replace(law, extra=noise.extra), remarks
    return None


def _impossible(found: Selection, machine: str) -> tuple[str, ...]:
    """Return a note where the best explanation was excluded because its size is impossible."""
    if not found.alarm:
        return ()
    best = best_of_each(found.first.names, found.first.on)[:1]
    sizes = [(s, s.effect.amplitude(s.coefficients)) for s in best if s.m]
    return tuple(
        f"{effect_label(machine, s.effect.family, s.effect.target)} would explain most, but it would have to be "
        f"{_sized(abs(size), s.effect.unit)}: taken for impossible"
        for s, size in sizes
        if not is_possible(s.effect, size)
    )


def _sized(size: float, unit: str) -> str:
    return f"{plain(100 * size)} %" if unit == "1" else f"{plain(size)} {unit}"


def _where(tests: Tests) -> tuple[Place, ...]:
    ranked = sorted(tests.smooth, key=lambda s: s.p)
    return tuple(Place(s.effect.target, s.effect.covariate, s.p) for s in ranked if isinstance(s.effect, SmoothTerm))


def _short_of(verdict: Verdict, left: Left | None, noise: float = 1.0) -> Verdict:
    """Return the verdict, or "partly" where the remaining error is above `floors_left` noise floors.

    `noise` is the factor at which the stated noise is multiplied in this search.
    """
    many = left is not None and left.times > noise * current_thresholds().floors_left
    return "partly" if many and verdict in ("named", "ambiguous", "negligible") else verdict


def _told_notes(notes: Sequence[str], gap: Gap, noise: Noise) -> tuple[str, ...]:
    """Return the notes of the data, as they hold now that the search is done."""
    told = [NOT_CROSSED if note == CROSSED and not gap.cross_validated else note for note in notes]
    return tuple(note.replace(LEARNED, "is told by repeats") if noise.from_repeats else note for note in told)


def _carried_by_nothing(findings: Sequence[Finding], gap: Gap) -> bool:
    """Return whether no finding has a size that is surely not 0, and unseen readings are no nearer with them.

    Of few readings a name can explain a part with a free form beside it: then neither its size nor its sign is known.
    """
    sized = [f.amplitude.ci95 for f in findings if np.all(np.isfinite(f.amplitude.ci95))]
    unsure = len(sized) == len(findings) > 0 and all(low <= 0 <= high for low, high in sized)
    return unsure and bool(gap.held_out_after >= gap.held_out_before)


def _parted_by(found: Selection, nearest: Nearest | None, machine: str) -> tuple[str, ...]:
    """Return the other kinds of readings that would part what was found, and the nearest formula, from their twins."""
    sets = [[o.effect for o in own] for own in found.sets]
    if nearest is not None and nearest.share >= NEAR:
        sets.append([o.effect for o in best_of_each(found.first.names, found.first.on)[:1]])
    return tuple(dict.fromkeys(kind for own in sets if (kind := parted_by(own, machine))))


def _at_other_noise(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], suspects: Sequence[NoiseFinding],
    left: Left | None, seed: int, level: float,
) -> tuple[OtherNoise, ...]:  # fmt: skip
    """Return the verdict and the names of the search at half and at twice the stated noise."""
    told = []
    for factor in _OTHERS:
        at = replace(base, noise=replace(base.noise, scale=factor * base.noise.scale))
        found = select_stepwise(at, candidates, terms, np.random.default_rng(seed), level)
        verdict, findings, _ = judged(found, at, terms, suspects, level)
        told.append(OtherNoise(factor, _short_of(verdict, left, factor), tuple(f.effect for f in findings)))
    return tuple(told)


def _left(gap: Gap, final: Fit, last: Tests) -> Left:
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
            s.name,
            s.effect.family,
            s.effect.target,
            delta_bic(s, tests.on),
            s.p,
            seen[s.name],
            s.detectable(len(best)),
            s.effect.unit,
        )
        for s in best
    )
    return hidden, table


def _parameters(base: Fit, final: Fit, lacking: tuple[Undetermined, ...]) -> dict[str, ParameterChange]:
    sd = spread(final, lacking)
    names = [p.name for p in base.model.formulation.parameters]
    told = {n: ParameterChange(float(base.x[k]), float(final.x[k]), float(sd[k])) for k, n in enumerate(names)}
    held = nominal_of(final.model.formulation, lacking)
    return told | {name: ParameterChange(value, value, float("nan")) for name, value in held.items()}


def _beyond(final: Fit) -> tuple[str, ...]:
    parameters = final.model.formulation.parameters
    return outside_bounds(parameters, {p.name: float(final.x[k]) for k, p in enumerate(parameters)})


def _scarce(base: Fit) -> tuple[str, ...]:
    """Return a note where calibration leaves so few equations that the verdict "none" has little weight."""
    left = len(base.r) - base.J.shape[1]
    if left > current_thresholds().few_degrees:
        return ()
    return (
        f"{counted(left, 'equation')} left after calibration, too few to show a missing effect; take more readings",
    )


def _unfollowed(formulation: Formulation) -> tuple[str, ...]:
    """Return a note on further columns of a machine that reads joints alone: no named error depends on them."""
    columns = roles_of(formulation).columns
    if not columns or measured_columns(formulation):
        return ()
    one = f'Joint(temperature="{columns[0]}")'
    return (
        f"columns {', '.join(columns)}: nothing but joints is read, so no trend over them has a name; "
        f"a joint's own are declared with it, such as {one}",
    )


def _lost(verdict: Verdict, gap: Gap) -> bool:
    """Tell whether a model is so far off that the readings may be of another machine.

    Noise alone does not cause that.
    """
    return verdict == "unknown" and gap.train_before > _FAR_OFF


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
