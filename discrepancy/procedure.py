"""`explain`: fit -> test -> where -> name -> add -> refit -> validate -> verdict, on one set of measured data."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, Note
from calibench.core.process import one_thread
from calibench.discrepancy import report as reports
from calibench.discrepancy.checks.validate import Asked, refuse_mistaken, refuse_unused, validate
from calibench.discrepancy.diagnostics import noise as noises
from calibench.discrepancy.diagnostics.far_readings import Pattern, Standing, standing_out
from calibench.discrepancy.diagnostics.score import smallest_amplitude, uncancelled
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, joint_terms, smooth_columns, smooth_terms
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import (
    Fit,
    ResidualProblem,
    at_any_scale,
    fit,
    fit_at,
    fit_from_several,
    keeping_fits,
    readings_of,
    thinned,
)
from calibench.discrepancy.fitting.rank import Held, Undetermined, determined, spread
from calibench.discrepancy.formula import with_formula
from calibench.discrepancy.labels import quantity_of
from calibench.discrepancy.model.effect import Catalogue, Effect, has_free_period
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import PLACE, DataError, MeasuredData, blamable
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import roles_of, unknown_noise_of, words_of
from calibench.discrepancy.noise.laws import OF_NOISE, NoiseFinding
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.remarks import Search, notes_of
from calibench.discrepancy.search import stepwise
from calibench.discrepancy.search.finding import FREE_PERIOD, also_told_by, parted_by, with_sizes
from calibench.discrepancy.search.select import Tests, best_of_each, delta_bic
from calibench.discrepancy.search.smoother import NEAR, fit_smooth, unnamed_of
from calibench.discrepancy.search.standing import renewed
from calibench.discrepancy.thresholds import THRESHOLDS, Thresholds, thresholds as current_thresholds, using
from calibench.discrepancy.validation import beside_steps, gap_of, times_left

GAP_OF_FITTED = (
    "no rows are held out, and without a part of them the rest does not determine what was added: the gap is that of "
    "the fitted readings"
)
_LEARNED = 3  # times that unknown noise is learned again at most: names and noise settle together, or never
_STRETCH = 20  # rows that follow each other, which are searched all or not at all
_OTHERS = (0.5, 2.0)  # times the stated noise: the search is repeated there where no repeats tell the noise
_NO_NOISE = 100.0  # times the stated noise: repeats that scatter so are rows or columns out of place
_WORSE = 2.0  # times the error of unseen readings: names that make it larger than this are none


def explain(
    machine: str | Machine, data: MeasuredData, *, seed: int = 0, level: float = 0.01,
    thresholds: Thresholds = THRESHOLDS,
) -> reports.Report:  # fmt: skip
    """Return what is missing from the machine's model according to `data`, with error rates held at `level`.

    The same data and seed give the same report. Raises `DataError` for data that cannot be of this machine.
    """
    if not isinstance(data, MeasuredData):
        raise TypeError(
            f"data is a {type(data).__name__}: MeasuredData(columns, machine) or bench.read_measured is needed"
        )
    if not isinstance(level, int | float) or not 0 < level < 1:
        raise ValueError(f"level={level}: must lie between 0 and 1")
    machine = machines.make(machine) if isinstance(machine, str) else machine
    try:
        with one_thread(), using(thresholds), keeping_fits():
            return _explained(machine, data, seed, level)
    except np.linalg.LinAlgError:
        refuse_mistaken(machine, data)
        raise DataError(
            f"{data.name}: calibration leaves the machine so far from the readings that nothing can be searched; does "
            "each row hold one reading of all columns?"
        ) from None


def _explained(machine: Machine, data: MeasuredData, seed: int, level: float) -> reports.Report:
    began, rng = time.process_time(), np.random.default_rng(seed)
    asked = Asked(data.metadata)
    data = replace(data, metadata=asked)
    whole = validate(machine, data)
    split = np.asarray(whole.data["split"]) if whole.data.has("split") else np.full(len(whole.data), "train")
    hold = ~searched(whole.data, split != "hold")
    searching = bool((hold & (split != "hold")).any())  # some of the rows that may be fitted, not all
    # fit: the machine without effects, under the noise that repeats show
    parameters = {p.name: p for p in whole.parameters}
    first = calibrated(whole, ~hold)
    whole, base, lacking, suspects = first.whole, first.base, first.lacking, first.suspects
    # test, and where: every name of the catalogue, and smooth terms over each column
    terms, known = smooth_terms(base), catalogue(whole)
    refuse_unused(machine.name, data, asked)
    # name, add, refit: until what remains looks like noise
    selection, base, suspects, notes_of_noise = _selected(
        base, known.candidates, terms, suspects, first.notes_of_noise, rng, level
    )
    # names of order that shuffled rows lose, and what each set is beside all others
    selection, orders = stepwise.held_by_order(selection, base, known.candidates, terms)
    selection = replace(selection, sets=renewed(selection.sets, selection.fit, known.candidates))
    selection = replace(selection, sets=stepwise.with_alternatives(selection.sets, base, known.alternatives))
    free = (*terms, *joint_terms(base))
    verdict, findings, selection = stepwise.judge(selection, base, terms, suspects, level, known.candidates, free)
    findings = stepwise.with_orders(findings, selection, known.candidates, orders)
    # validate: on rows that were not fitted; names that help nothing there are none
    final, unseen = selection.fit, None
    if verdict in ("none", "unknown"):
        final = base if verdict == "none" else fit_smooth(base, free)
    if hold.any():  # with the columns of the smooth terms
        unseen = base.model.formulation.on(whole.data.rows(hold))
        unseen = unseen.on(unseen.data.with_columns(smooth_columns(unseen, base.x)))
    gap, lone = gap_of(base, final, unseen, suspects, rng)
    noisy = any(f.family == s.family for f in findings for s in suspects)  # a law of the noise moves no mean
    if not noisy and _carried_by_nothing(findings, gap):
        verdict, findings, final = "unknown", (), fit_smooth(base, free)
        gap, lone = gap_of(base, final, unseen, suspects, rng)
    # none and noise mean small: not where far more is left, where readings far off are no noise, or rows stand out
    standing = standing_out(final if findings else base, unseen)
    if verdict in ("none", "noise"):
        untold = any(map(np.ndim, base.noise.extra.values())) and all(s.family == "outlier" for s in suspects)
        if standing is None and (untold or _is_large(final, gap, unseen, suspects, None)):
            standing = noises.rows_far_off(base, whole.on(whole.data.with_columns(smooth_columns(whole, base.x))))
        # a burst of noise ends: what goes on to an end of the run, some rows long, may be there still
        ends = {*whole.data.row_numbers[[0, -1]].tolist()}
        lasts = standing is not None and any(len(run) > 2 and ends & {*run} for run in standing.runs)
        if _is_large(final, gap, unseen, suspects, standing) or (first.no_noise and standing is None) or lasts:
            verdict, final = "unknown", fit_smooth(base, free)
            gap, lone = gap_of(base, final, unseen, suspects, rng)
        elif standing is not None:
            verdict = "noise"
    # verdict
    rest = _rest(gap, final, selection.last) if not all(f.family in OF_NOISE for f in findings) else None
    verdict = _short_of(verdict, rest)
    if findings and final.noise.profiled and not final.exact and selection.last.still < level:
        verdict = "partly"  # without repeats the noise is unknown, so only the tests can say whether something is left
    formula: reports.Formula | None = None
    if verdict in ("unknown", "partly"):
        refuse_mistaken(machine, data)
        after, formula = with_formula(selection.fit if findings else base, final, free, whole, seed)
        if formula is not None:  # beside which names have other sizes
            final = after
            findings = _sized(findings, selection, final)
            gap, lone = gap_of(base, final, unseen, suspects, rng)
            rows, kept = len(base.at.misclosure), len(thinned(base).at.misclosure)
            text = f"the formula was looked for on {kept} of {rows} rows, evenly spaced, and fitted to all of them"
            note = Note(Code.ROWS_THINNED, text, values={"kept": kept, "rows": rows})
            notes_of_noise = (*notes_of_noise, note) if kept < rows else notes_of_noise
    if standing is not None and verdict in ("unknown", "partly"):
        standing = standing.beside(standing_out(final, unseen))
    doubted = base.noise.profiled and not unknown_noise_of(base.model.formulation)
    others = _at_other_noise(base, known.candidates, terms, suspects, rest, seed, level) if doubted else ()
    # the sizes of all rows; the gap stays that of names and sizes of the searched rows, on rows that were not fitted
    sized = None
    if searching and findings and final is selection.fit:
        sized = _of_all_rows(final, base, whole.data.rows(split != "hold"))
    if sized is not None:
        findings = _sized(findings, selection, sized)
        final = fit_at(final.model, final.noise, sized.x, readings_of(final.at.model), True)
    doubt = reports.Doubt.UNCONFIRMED  # of a wave of fitted period, until another set confirms it
    waves = {f.effect for f in findings if FREE_PERIOD in (c.name for c in f.coefficients)}
    findings = tuple(
        replace(f, caution=(*f.caution, reports.Caution(doubt, also_told_by(f, final)))) if f.effect in waves else f
        for f in findings
    )
    search = Search(
        machine=machine.name, base=base, final=final, selection=selection, verdict=verdict, findings=findings,
        gap=gap, lone=lone, standing=standing, no_noise=first.no_noise,
    )  # fmt: skip
    # the notes of the data as they hold now that the search is done
    of_data = []
    if searching:
        kept, rows = int((~hold).sum()), int((split != "hold").sum())
        how = ("searched", ", and then sizes fitted to all") if sized else ("fitted and searched", "")
        text = f"{kept} of {rows} rows, spread over the run, were {how[0]}; the others are held out{how[1]}"
        of_data.append(Note(Code.ROWS_THINNED, text, values={"kept": kept, "rows": rows}))
    for note in whole.data.notes:
        if note.code is Code.NOT_HELD_OUT and searching:
            continue
        if note.code is Code.NOT_HELD_OUT and not gap.cross_validated:
            note = Note(Code.GAP_OF_FITTED, GAP_OF_FITTED)
        if note.code is Code.NOISE_LEARNED and base.noise.from_repeats:
            text = f"the noise is not stated: that of {', '.join(note.columns)} is told by repeats"
            note = Note(Code.NOISE_UNSTATED, text, note.columns)
        of_data.append(note)
    held = [u.note(parameters[u.name]) for u in lacking]
    at_end = getattr(whole, "at_end", None)  # of `Predicted`: what it has to say when the search is done
    given = (*held, *first.notes_of_fit, *of_data, *first.misstated, *notes_of_noise, *(at_end() if at_end else ()))
    names, sd = [p.name for p in base.model.formulation.parameters], spread(sized or final, lacking)
    changes = {
        n: reports.ParameterChange(float(base.x[k]), float(final.x[k]), float(sd[k])) for k, n in enumerate(names)
    }
    for name in (u.name for u in lacking):
        value = float(final.model.formulation.fixed[name])
        changes[name] = reports.ParameterChange(value, value, float("nan"))
    return replace(
        _report(search, whole, known), parameters=changes, notes=notes_of(search, given), left=rest,
        other_noise=others, formula=formula,
        fitted=reports.Fitted(ResidualProblem(final.model, final), ResidualProblem(base.model, base), machine),
        seconds=time.process_time() - began,
    )  # fmt: skip


def _sized(
    findings: Sequence[reports.Finding], selection: stepwise.Selection, found: Fit
) -> tuple[reports.Finding, ...]:  # fmt: skip
    """Return the findings with the sizes that their effects have in another fit."""
    effects = {own[0].name: own[0].effect for own in selection.sets}
    return tuple(with_sizes(f, effects[f.effect], found) if f.effect in effects else f for f in findings)


def searched(data: MeasuredData, fitted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which rows of those to be `fitted`, (n,), a search fits: of very many some, the others tell the error.

    An effect that matters is far beyond chance in a few thousand rows. Poses stay whole, and so do stretches of rows
    that follow each other where no poses are told: repeats, and noise that is carried on, are in both.
    """
    rows, most = np.flatnonzero(fitted), current_thresholds().searched_rows
    if len(rows) <= most:
        return fitted
    name = next((name for name in ("shared_id", "pose_id", "visit_id") if data.has(name)), None)
    group = np.arange(len(rows)) // _STRETCH
    if name is not None:
        _, first, own = np.unique(np.asarray(data[name])[rows], return_index=True, return_inverse=True)
        if np.bincount(own).max() <= most / _STRETCH:
            group = np.argsort(np.argsort(first))[own]  # in the order in which they were met
    count = int(group.max()) + 1
    chosen = np.linspace(0, count - 1, max(1, count * most // len(rows))).round().astype(int)
    some = np.zeros(len(fitted), dtype=bool)
    some[rows[np.isin(group, chosen)]] = True
    return some


def _of_all_rows(final: Fit, base: Fit, data: MeasuredData) -> Fit | None:
    """Return a fit of some rows of `data` made of all of them; None where noise of single rows was added, or it fails.

    `base` has the parameters at which smooth columns were computed.
    """
    if any(np.ndim(variance) for variance in final.noise.extra.values()):
        return None
    there = final.model.formulation.on(data.rows(beside_steps(final, data)))
    there = there.on(there.data.with_columns(smooth_columns(there, base.x)))
    found = fit(Model(there, final.model.effects), final.noise, final.x)
    return found if found.converged else None


@final
@dataclass(frozen=True, eq=False)
class Calibrated:
    """A machine without effects fitted to rows of `whole`, under the noise that they show, and what was seen there.

    `lacking` are the parameters that the rows do not determine: they are held in `whole`. `suspects` are laws of the
    noise, and `no_noise` far readings that something carries.
    """

    whole: Formulation
    base: Fit
    lacking: tuple[Undetermined, ...]
    suspects: tuple[NoiseFinding, ...]
    no_noise: tuple[Pattern, ...]
    notes_of_fit: tuple[Note, ...]
    misstated: tuple[Note, ...]
    notes_of_noise: tuple[Note, ...]


def calibrated(whole: Formulation, rows: NDArray[np.bool_]) -> Calibrated:
    """Return the machine without effects fitted to `rows` (n,) of `whole`."""
    fitted = whole.on(whole.data.rows(rows))
    plain, notes_of_fit = fit_from_several(fitted)
    fitted, plain, lacking = determined(fitted, plain)
    if lacking and notes_of_fit:  # the parameters that led the fit away from the nominal machine may be held now
        plain, notes_of_fit = fit_from_several(fitted)
    whole = Held(whole, frozenset(u.name for u in lacking)) if lacking else whole
    sound, suspects, no_noise, misstated = noises.sound_fit(plain)
    noise, notes_of_noise = noises.noise_at(sound, suspects, whole)
    base = sound if noise == sound.noise else fit(Model(plain.model.formulation), noise, sound.x, about=sound)
    # the columns of the smooth terms, which no constraint reads
    columns = smooth_columns(base.at.model.formulation, base.x)
    model, there = (
        replace(one, formulation=one.formulation.on(one.formulation.data.with_columns(columns)))
        for one in (base.model, base.at.model)
    )
    return Calibrated(
        whole=whole, base=replace(base, model=model, at=replace(base.at, model=there)), lacking=lacking,
        suspects=suspects, no_noise=no_noise, notes_of_fit=notes_of_fit, misstated=misstated,
        notes_of_noise=notes_of_noise,
    )  # fmt: skip


def _report(search: Search, whole: Formulation, known: Catalogue) -> reports.Report:
    """Return what a report says of a search by itself: its verdict, names and places, what it could and could not see.

    `whole` has the held-out rows too.
    """
    first, machine, t = search.selection.first, search.machine, current_thresholds()
    hidden, table = [], []
    ranked = best_of_each(first.names, first.on)
    for s in ranked:
        effect, seen = s.effect, s.seen.visible * uncancelled(s.effect, search.base)
        least, span = smallest_amplitude(effect, s.energies, s.m, len(ranked)), getattr(effect, "span", np.nan)
        if not s.m or s.seen.visible < t.visible or seen < t.invisible:
            hidden.append(reports.Invisible(s.name, effect.family, effect.target, seen, least, effect.unit, span))
        gain = delta_bic(s, first.on)
        table.append(
            reports.Candidate(
                effect=s.name, family=effect.family, target=effect.target, gain=gain, p=s.p, visible_fraction=seen,
                minimum_detectable=least, unit=effect.unit, span=span,
            )
        )  # fmt: skip
    named: dict[str, Any] = {"where": ()}
    if search.verdict not in ("none", "noise"):
        time_ = "t_s" if whole.data.has("t_s") else "row"
        columns = [
            time_ if one.column == PLACE else "place" if one.column.startswith("place_") else one.column
            for one in search.no_noise
        ]
        by = [reports.Place(one.target, column, one.p) for one, column in zip(search.no_noise, columns)]
        named["where"] = (*_places(first), *by) if search.verdict == "unknown" else _places(first)
    if search.verdict == "unknown":
        # the formula that explains most of the excess over the noise, and its share
        nearest: reports.Nearest | None = None
        excess = first.on.total - first.on.degrees
        if ranked and ranked[0].m and not excess <= 0:
            best = ranked[0]
            part = float(np.clip((best.T - best.m) / excess, 0.0, 1.0))
            nearest = reports.Nearest(best.name, best.effect.family, best.effect.target, part)
        # the other kinds of readings that would part what was found, and the nearest formula, from their twins
        sets = [[o.effect for o in own] for own in search.selection.sets]
        if nearest is not None and nearest.share >= NEAR:
            sets.append([s.effect for s in ranked[:1]])
        parted = tuple(dict.fromkeys(kind for own in sets if (kind := parted_by(own, machine))))
        named |= {"unnamed": unnamed_of(search.final), "nearest": nearest, "parted_by": parted}
    # for each column in which waves of any period are searched for, the shortest period
    shortest: dict[str, reports.Shortest] = {}
    for effect in (e for e in known.candidates if has_free_period(e)):
        period = effect.period(np.zeros(len(effect.coefficients)))  # type: ignore[attr-defined]
        column = effect.columns[0]
        if column not in shortest or period < shortest[column].period:
            shortest[column] = reports.Shortest(column, float(period), effect.period_unit)  # type: ignore[attr-defined]
    # the standard deviation of each kind of reading, the median over the rows, alike to three digits
    formulation = search.final.model.formulation
    kinds: dict[tuple[str, str], tuple[float, list[str]]] = {}
    for sensor in formulation.sensors:
        unit = sensor.unit or quantity_of(formulation.data.machine, sensor.column).unit
        size = float(np.median(formulation.sigma[sensor.column]))
        kinds.setdefault((f"{size:.3g}", unit), (size, []))[1].append(sensor.column)
    noise = [reports.ReadingNoise(tuple(columns), size, unit) for (_, unit), (size, columns) in kinds.items()]
    return reports.Report(
        case=whole.data.name, machine=machine, verdict=search.verdict, findings=search.findings, gap=search.gap,
        not_testable=known.untestable, invisible=tuple(hidden), p=search.selection.p,
        shortest=tuple(shortest.values()), reading_noise=tuple(noise),
        words={n: words for n, words in words_of(roles_of(whole)).items() if not quantity_of(machine, n).label},
        candidates=tuple(table), **named,
    )  # fmt: skip


def _places(tests: Tests) -> tuple[reports.Place, ...]:
    ranked = sorted(tests.smooth, key=lambda s: s.p)
    return tuple(
        reports.Place(s.effect.target, s.effect.covariate, s.p) for s in ranked if isinstance(s.effect, SmoothTerm)
    )


def _selected(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], suspects: tuple[NoiseFinding, ...],
    notes: tuple[Note, ...], rng: np.random.Generator, level: float,
) -> tuple[stepwise.Selection, Fit, tuple[NoiseFinding, ...], tuple[Note, ...]]:  # fmt: skip
    """Return the selection, the fit without effects, the suspects that remain, and notes on the noise."""
    model = Model(base.model.formulation)
    found = stepwise.select_stepwise(base, candidates, terms, rng, level)
    # noise that is carried on looks like errors over the time; where as much as may be explains the alarm, it is none
    untold = found.alarm and base.noise.profiled and not base.noise.autocorrelation
    for share in noises.carried(found.fit) if untold else ():
        there = fit(model, replace(base.noise, autocorrelation=share), base.x)
        if stepwise.is_calm(there, candidates, terms, rng, level):
            calm = stepwise.select_stepwise(there, candidates, terms, rng, level)
            text = f"no pose is read again; {100 * share:.0f} % of the noise may be carried on, and is taken to be"
            return calm, there, suspects, (*notes, Note(Code.NOISE_CARRIED, text, values={"part": share}))
    # a misfit that readings far off explain by themselves, wherever they are, is none of the machine
    far = base.noise.profiled and not found.sets and stepwise.judge(found, base, terms, suspects, level)[0] == "unknown"
    if outside := noises.outlying_untold(base) if far else ():
        there = noises.beside_outlying(base, outside)
        if stepwise.is_calm(there, candidates, terms, rng, level):
            parts = {sensor.part for sensor in blamable(model.formulation.sensors)}
            suspects = (*suspects, *(one for one in outside if one.target in parts))
            return stepwise.select_stepwise(there, candidates, terms, rng, level), there, suspects, notes
    # repeats that were approached from both sides differ by the play of a joint, which looks like wild readings: a
    # suspect that has less than one such reading beside the effects is cleared
    at, wild = found.fit, [s for s in suspects if s.family == "outlier"] if found.sets else []
    cleared = [s for s in wild if float(noises.outliers_under(at.model, at.x, s.target).weights.sum()) < 1.0]
    if cleared:
        suspects = tuple(s for s in suspects if s not in cleared)
        extra = dict(base.noise.extra)
        for name, variance in (item for suspect in cleared for item in suspect.extra.items()):
            extra[name] = extra[name] - variance
        extra = {name: variance for name, variance in extra.items() if np.any(variance)}
        law, _, notes = noises.law_at(fit(at.model, Noise(extra=extra), at.x))
        noise = replace(law, extra=extra, profiled=law.profiled or base.noise.profiled)
        base = fit(model, noise, base.x)
        found = stepwise.select_stepwise(base, candidates, terms, rng, level)
    if (calmer := _relearned(found, base.noise)) is not None:
        noise, notes = calmer
        base = fit(model, noise, base.x)
        found = stepwise.select_stepwise(base, candidates, terms, rng, level)
    for _ in range(_LEARNED if unknown_noise_of(base.model.formulation) else 0):
        verdict, _, standing = stepwise.judge(found, base, terms, suspects, level, doubts=False)
        if verdict == "unknown" or not found.sets or found.fit.exact:
            break
        formulation, noise, notes_now = noises.learned_beside(standing.fit, suspects)
        at = fit(Model(formulation), noise, base.x)
        again = stepwise.select_stepwise(at, candidates, terms, rng, level) if at.converged else None
        if again is None or not again.sets:
            break
        same = {own[0].name for own in found.sets} == {own[0].name for own in again.sets}
        found, base, notes = again, at, notes_now
        if same:
            break
    return found, base, suspects, notes


def _relearned(found: stepwise.Selection, noise: Noise) -> tuple[Noise, tuple[Note, ...]] | None:
    """Return a smaller noise, with notes, where the found effects explain the differences of the repeats; else None."""
    as_stated = noise.scale <= 1 and not np.isfinite(noise.t_degrees)
    if not found.sets or noise.autocorrelation > 0 or as_stated:
        return None
    at = fit(found.fit.model, Noise(extra=noise.extra), found.fit.x)
    law, _, notes = noises.law_at(at)
    calmer = noise.scale > 1 and law.scale < current_thresholds().calmer * noise.scale
    thinner = np.isfinite(noise.t_degrees) and not np.isfinite(law.t_degrees)
    if calmer or (thinner and law.scale <= max(noise.scale, 1.0)):  # a wider law would absorb what was found
        return replace(law, extra=noise.extra), notes
    return None


def _short_of(verdict: reports.Verdict, left: reports.Left | None, noise: float = 1.0) -> reports.Verdict:
    """Return the verdict, or "partly" where the remaining error is above `floors_left` noise floors."""
    many = left is not None and left.times > noise * current_thresholds().floors_left
    return "partly" if many and verdict in ("named", "ambiguous", "negligible") else verdict


def _is_large(
    final: Fit, gap: reports.Gap, unseen: Formulation | None, suspects: Sequence[NoiseFinding],
    standing: Standing | None,
) -> bool:  # fmt: skip
    """Return whether a fit leaves more than `floors_left` times the noise, without the rows that stand out."""
    if final.exact or (final.noise.profiled and unknown_noise_of(final.model.formulation)):
        return False  # nothing tells the noise but what the fit leaves
    if final.noise.scale > _NO_NOISE and not unknown_noise_of(final.model.formulation):
        return True
    most, n = current_thresholds().floors_left, len(final.model.formulation.data)
    scores = np.asarray(final.noise.scores(final.r)).reshape(n, -1)
    scores = scores if standing is None else scores[standing.others]
    freedom = scores.size - final.J.shape[1]
    if freedom >= current_thresholds().few_degrees and float(np.sum(scores**2)) > most**2 * freedom:
        return True
    if standing is not None:
        return False
    if suspects and unseen is not None:
        return times_left(final, unseen, suspects) > most
    kept = unseen is not None and not np.isfinite(final.noise.t_degrees)
    held = gap.held_out_before if kept else gap.held_out_ci95[0]
    surely = gap.held_out_ci95[0] > gap.noise_floor  # few rows, of which one is far off by noise, are large by chance
    return bool(surely and held > most * gap.noise_floor)


def _carried_by_nothing(findings: Sequence[reports.Finding], gap: reports.Gap) -> bool:
    """Return whether names make unseen readings far worse, or no nearer, and no size is surely not 0."""
    sized = [f.amplitude.ci95 for f in findings if np.all(np.isfinite(f.amplitude.ci95))]
    unsure = len(sized) == len(findings) > 0 and all(low <= 0 <= high for low, high in sized)
    worse = bool(gap.held_out_after > _WORSE * gap.held_out_before)
    return bool(findings) and (worse or (unsure and bool(gap.held_out_after >= gap.held_out_before)))


def _at_other_noise(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], suspects: Sequence[NoiseFinding],
    left: reports.Left | None, seed: int, level: float,
) -> tuple[reports.OtherNoise, ...]:  # fmt: skip
    """Return the verdict and the names of the search at half and at twice the stated noise."""
    others = []
    for factor in _OTHERS:
        at = replace(base, noise=replace(base.noise, scale=factor * base.noise.scale))
        with at_any_scale():
            found = stepwise.select_stepwise(at, candidates, terms, np.random.default_rng(seed), level)
            verdict, findings, _ = stepwise.judge(found, at, terms, suspects, level)
        others.append(reports.OtherNoise(factor, _short_of(verdict, left, factor), tuple(f.effect for f in findings)))
    return tuple(others)


def _rest(gap: reports.Gap, final: Fit, last: Tests) -> reports.Left:
    """Return the error that remains with the names: on held-out rows, or else on all fitted rows."""
    most = current_thresholds().floors_left
    kept = np.isfinite(gap.held_out_after) and not gap.cross_validated
    surely = gap.held_out_ci95[0] > most * gap.noise_floor
    times = gap.held_out_after / gap.noise_floor if kept or surely else gap.train_after / final.noise.scale
    place = min(_places(last), key=lambda p: p.p, default=None)
    shows = place is not None and place.p < current_thresholds().p_calm
    return reports.Left(float(times), place if shows else None)
