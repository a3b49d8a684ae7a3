"""The stepwise search: test, select, test again; then the verdict from what was selected and what is left.

Some causes are too unlikely to be searched for, or have nearly the signature of a likelier one. They are tried only
beside a selected effect: where such a cause explains the data as well, the name alone would be a guess, and the set
holds both.

A name that only imitates an unnamed cause explains a part of it, and smooth functions explain more. A named cause that
is there explains more than any smooth function of one covariate, because it shows in all readings at once; and it still
gains beside all smooth functions together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import ProjectedScores, columns, projected_scores, score_all, subspaces
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import Alternative, Effect, name_of, still_open
from calibench.discrepancy.noise.laws import NoiseFinding
from calibench.discrepancy.noise.repeats import excess_p
from calibench.discrepancy.report import Finding, Verdict
from calibench.discrepancy.search.exchange import (
    NOTHING,
    Kept,
    Picked,
    beside,
    energy_of,
    exchange,
    predicts_better,
    settled,
)
from calibench.discrepancy.search.finding import blamed_noise, finding_of, with_cautions
from calibench.discrepancy.search.form import FORM_DIFFERS, Modulated, form_words, residuals_within, share, unlike
from calibench.discrepancy.search.off_form import bonus
from calibench.discrepancy.search.select import (
    Option,
    Tests,
    delta_bic,
    fit_with,
    gains_of_any_phase,
    option,
    options,
    penalty,
    run_tests,
)
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_MARGIN = 20.0  # delta BIC: where gains are small, a ratio of them says nothing
_NOTHING_LEFT = 2  # degrees of freedom: with fewer left nothing could check a name


@final
@dataclass(frozen=True, eq=False)
class Selection:
    """The result of the search: the fit with all picks and their `forms`, the fit of the picks `alone`, and the sets.

    `first` and `last` are the tests of the model without effects and with all; `p` and `left` are those of "nothing is
    missing" and of "nothing is left".
    """

    fit: Fit
    alone: Fit
    sets: tuple[tuple[Option, ...], ...]
    forms: tuple[Effect, ...]
    first: Tests
    last: Tests
    p: float
    alarm: bool
    left: float
    smooth_explains: bool


def select_stepwise(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], rng: np.random.Generator, level: float
) -> Selection:
    """Select effects beside `base` one after the other, until the residual test at `level` passes.

    Whether anything is missing is asked without the tails of heavy-tailed noise, so that a few readings far off are no
    alarm; what is left beside a name is asked with them, so that a name is no claim to the whole while they are there.
    A further effect must also predict poses that are left out. Where the noise is not known, two effects that hide each
    other are taken at once. Picks are exchanged, one at a time and in pairs. Where the size of a pick depends on a
    covariate, that form is part of the pick. Then neither it nor the picks beside it are exchanged any more, because
    the form may explain a part of what they explain.
    """
    picked, ground = Picked(base, ()), base
    forms: tuple[Effect, ...] = ()
    kept = NOTHING
    first: Tests | None = None
    first_p = 1.0
    while True:
        current, picks = picked.fit, [s[0].effect for s in picked.sets]
        taken = {name_of(e) for e in picks}
        tests = run_tests(current, still_open(candidates, taken), terms, rng, spared=first is None)
        p = 1.0 if current.exact else _overall(current, tests)
        if first is None:
            first, first_p = tests, p
        more = p < level and len(picks) < thresholds().effects_most
        form = unlike(current, picks, forms, terms, tests, level) if p < 1.0 and len(forms) < len(picks) else None
        form = None if form is not None and _smoother_by_far(tests, form.gain) else form
        if not more and form is None:
            break
        enough = thresholds().further_gain if picks else 0.0
        many = len(current.at.misclosure) >= thresholds().many_readings  # then an exact fit is slow
        hopeless = many and tests.named < thresholds().linear_hope * enough
        # misfit alone gives no name, unless the degrees of freedom are so few that no other test can
        significant = tests.p_names < level or (not picks and _few(current))
        found = options(current, tests) if more and significant and not hopeless else ()
        if form is not None and not (found and found[0].gain > form.gain):
            with_form = fit_with(base, (*forms, form.effect))
            after = exchange(picks, (), with_form, candidates, picked.by_name)
            if not np.isfinite(after.fit.cost):
                break  # no fit with names and form converges: the names stay as they are
            forms, ground = (*forms, form.effect), with_form
            kept, picked = picked.by_name, after  # a form explains a part of what names explain
            continue
        short = bool(found) and 0 < found[0].gain <= enough and current.noise.profiled and not many
        if not found or (found[0].gain <= enough and not short):
            break
        by_far = _smoother_by_far(tests, _gain_of_any_phase(found[0], current, tests))
        if by_far and _stand(picked.sets, base, terms) is None:
            break
        if picks and not predicts_better(current, found[0]):
            break
        if _slight(found[0], picked):  # a pick that may be the error of a formula must not replace a name
            kept = {**kept, **picked.by_name}
        after = beside(picked, found, ground, candidates, kept)
        if short:
            after = _with_another(after, ground, candidates, kept)
        if len(after.fit.r) - len(after.fit.x) < _NOTHING_LEFT or not np.isfinite(after.fit.cost):
            break
        if len(after.sets) > 1 and min(s[0].gain for s in after.sets) < thresholds().further_gain:
            break  # after the exchange one of them explains nothing beside the others
        picked = after
    picked = _needed(settled(picked, ground, candidates, kept), base, ground)
    current = picked.fit
    alone = fit_with(base, picked.effects) if forms else current
    smooth_explains = _smooth_explains(base, picked, forms, terms, first)
    return Selection(
        fit=current,
        alone=alone,
        sets=picked.sets,
        forms=forms,
        first=first,
        last=tests,
        p=first_p,
        alarm=first_p < level,
        left=p,
        smooth_explains=smooth_explains,
    )


def _smooth_explains(
    base: Fit, picked: Picked, forms: Sequence[Effect], terms: Sequence[SmoothTerm], first: Tests
) -> bool:
    """Return whether smooth terms, as many as there are names and forms, explain clearly more than these.

    Each side is judged by its BIC; `first` are the tests before anything was picked.
    """
    sets = picked.sets
    paid = sum(penalty(found[0].effect, found[0].rank, first.on) for found in sets)
    paid += sum(penalty(form, len(form.coefficients), first.on) for form in forms)
    smooth, several = first.smooth_gain, len(sets) + len(forms)
    if several > 1:  # several names against several smooth terms
        free = with_smooth_terms(base, terms, several)
        smooth = _gained(base, free) - float(np.log(len(base.r))) * (len(free.x) - len(base.x))
    named = _gained(base, picked.fit) - paid
    if smooth > named + thresholds().smooth_clearly:  # a curve may win only because a formula is not exact
        named += sum(bonus(found[0]) for found in sets)
    return smooth > named + thresholds().smooth_clearly


def _smoother_by_far(tests: Tests, gain: float) -> bool:
    """Return whether a smooth term gains so much more than `gain` that no name is looked for."""
    return tests.smooth_gain > thresholds().smooth_far * gain + _MARGIN


def _gain_of_any_phase(found: Option, current: Fit, tests: Tests) -> float:
    """Return the gain of an option, or of the wave of which it is the sine or the cosine, if that is larger.

    A smooth function has the right phase at once, a term the wrong one.
    """
    return max([found.gain, *gains_of_any_phase(current, tests.on, [found]).values()])


def _slight(found: Option, picked: Picked) -> bool:
    """Return whether a further effect is so small that it may be the error of the formulas of those before it.

    Where nothing tells the noise that is a part of their whole traces, as sets are then made of what forms may leave.
    """
    count = found.fit.at.misclosure.size

    def energy(o: Option) -> float:
        return o.fit.noise.size_of(o.gain, count) ** 2

    def whole(o: Option) -> float:
        alike = found.fit.noise.profiled and o.effect.target == found.effect.target
        return max(energy(o), energy_of(o) / count) if alike else energy(o)

    return energy(found) < thresholds().formula_error * sum(whole(s[0]) for s in picked.sets)


def _with_another(picked: Picked, ground: Fit, candidates: Sequence[Effect], kept: Kept) -> Picked:
    """Return the picks with one more, where the last of them gained too little alone; as they are where none is found.

    Where the noise is not known, an effect that is missing is taken for noise, so of two missing effects each hides the
    other. Then both must gain beside each other.
    """
    taken = {name_of(e) for e in picked.effects}
    if len(taken) >= thresholds().effects_most:
        return picked
    found = options(picked.fit, run_tests(picked.fit, still_open(candidates, taken), (), None))
    if not found or found[0].gain <= thresholds().further_gain or not predicts_better(picked.fit, found[0]):
        return picked
    return exchange([*picked.effects, found[0].effect], found, ground, candidates, kept)


def _needed(picked: Picked, base: Fit, ground: Fit) -> Picked:
    """Return the picks without those that explain nothing beside the others, with the forms of `ground` and without.

    They were found before the others, and were not tested again once a form was in the model.
    """
    while ground is not base and len(picked.sets) > 1:
        alone = fit_with(base, picked.effects)
        worth = {name_of(e): max(_worth(at, e) for at in (picked.fit, alone)) for e in picked.effects}
        least = min(worth, key=lambda name: worth[name])
        if worth[least] >= 0:
            break
        sets = tuple(own for own in picked.sets if own[0].name != least)
        picked = Picked(fit_with(ground, [own[0].effect for own in sets]), sets)
    return picked


def _worth(at: Fit, effect: Effect) -> float:
    """Return the gain of an effect of a fit, to first order."""
    own = at.model.place_of(effect)
    c = at.x[own]
    explained = float(c @ np.linalg.pinv(at.covariance(stated=True)[own, own], hermitian=True) @ c)
    gained = at.noise.gained(at.cost + explained, at.cost, at.degrees)
    return gained - len(c) * float(np.log(len(at.r)))


def _gained(base: Fit, at: Fit) -> float:
    return base.noise.gained(base.cost, at.cost, at.degrees)


def _overall(at: Fit, tests: Tests) -> float:
    """Return the p of "nothing is left": the smallest of names, smooth terms and lack of fit, each over its share."""
    return min(tests.still, _lack_of_fit(tests, at) / thresholds().share_misfit)


def _lack_of_fit(tests: Tests, at: Fit) -> float:
    """Return the probability under the noise alone of a misfit as large as that of a fit."""
    on = tests.on
    return excess_p(on.total / on.degrees, on.degrees, at.noise.known, on.excess_kurtosis)


def verdict_of(
    selection: Selection, base: Fit, suspects: Sequence[NoiseFinding], level: float
) -> tuple[Verdict, tuple[Finding, ...]]:
    """Return the verdict and the findings; `suspects` are findings about the noise."""
    blamed = tuple(blamed_noise(s) for s in suspects)
    if not selection.alarm:
        return _said(blamed), blamed
    explained = _explained(base, selection.fit) + _doubt(base, selection.fit)
    if not selection.sets and not _worth_it(selection, base):
        return _said(blamed), blamed
    short = selection.left < level and explained < (
        thresholds().explained if selection.left > thresholds().p_plain else thresholds().explained_plain
    )
    smooth = selection.smooth_explains
    little = short and explained < thresholds().explained
    bent = explained >= thresholds().explained_part and _excess(selection.fit) < _form_errors(selection)
    by_form = _by_large_forms(selection, base)
    if not selection.sets or by_form or (little and smooth):
        return "unknown", ()
    plainly = smooth or (little and not _is_quiet(selection, level))
    if plainly and not bent and not _by_far(selection, explained):
        return "unknown", ()
    whole = {own[0].name: energy_of(own[0]) / len(selection.fit.r) for own in selection.sets}
    found = [_formed(finding_of(selection.fit, own), own[0].effect, selection) for own in selection.sets]
    named = with_cautions(found, whole)
    if plainly:
        named = (replace(named[0], form=named[0].form or FORM_DIFFERS), *named[1:])
    findings = tuple(sorted((*named, *blamed), key=lambda f: -f.gain))
    if short or smooth:
        return "partly", findings
    if np.sqrt(sum(f.visible**2 for f in findings)) < thresholds().matters:
        return "negligible", findings
    return _said(findings), findings


def judge(
    selection: Selection, base: Fit, terms: Sequence[SmoothTerm], suspects: Sequence[NoiseFinding], level: float
) -> tuple[Verdict, tuple[Finding, ...], Selection]:
    """Return the verdict, the findings and their selection: where names explain too little, the names that still stand.

    A name that still explains something beside smooth functions is right, but not the whole: the verdict is partly.
    """
    verdict, findings = verdict_of(selection, base, suspects, level)
    if verdict != "unknown" or (part := _stand(selection.sets, base, terms)) is None:
        return verdict, findings, selection
    kept = replace(selection, fit=part.fit, alone=part.fit, sets=part.sets, forms=())
    whole = {own[0].name: energy_of(own[0]) / len(part.fit.r) for own in part.sets}
    named = with_cautions([finding_of(part.fit, own) for own in part.sets], whole)
    blamed = (blamed_noise(s) for s in suspects)
    return "partly", tuple(sorted((*named, *blamed), key=lambda f: -f.gain)), kept


def _stand(sets: Sequence[tuple[Option, ...]], base: Fit, terms: Sequence[SmoothTerm]) -> Picked | None:
    """Return the names that stand beside smooth functions; None where these do not explain most of the misfit."""
    held = standing(sets, base, terms)
    part = Picked(fit_with(base, [own[0].effect for own in held]), held)
    return part if held and _explained(base, part.fit) >= thresholds().explained else None


def _is_quiet(selection: Selection, level: float) -> bool:
    """Return whether nothing tells the noise, and no test of a name or a smooth function shows anything that is left.

    Then what is more than the assumed noise may be noise: of heavy tails, for example.
    """
    return selection.fit.noise.profiled and selection.last.still >= level


def _by_far(selection: Selection, explained: float) -> bool:
    """Return whether the first name gains so much more than any smooth function that it stands, whatever remains.

    An unnamed cause is nearer to some smooth function than to a wrong name. Where smooth functions explain nothing at
    all, there is nothing to compare the name with.
    """
    smooth = selection.first.smooth_gain
    named = max(own[0].gain for own in selection.sets)
    by_far = smooth > 0 and named > thresholds().smooth_far * smooth + _MARGIN
    return by_far and explained > thresholds().explained_by_far


def _by_large_forms(selection: Selection, base: Fit) -> bool:
    """Return whether names explain the excess only with forms that differ from formulas by more than usual.

    What an effect leaves relative to a Zero is mostly the change of its size on the way, and little of the size itself.
    So there a form as large as usual may help; elsewhere names must explain the excess without one.
    """
    at = selection.fit
    forms = [form for form in selection.forms if isinstance(form, Modulated)]
    large = [form for form in forms if share(at, form) >= thresholds().form_share]
    if not large:
        return False
    if all(form.acts_along for form in large):
        r = residuals_within(at, forms, thresholds().form_share)
    else:
        at, r = selection.alone, selection.alone.r
    return _explained(base, at, r) + _doubt(base, at, r) < thresholds().explained_part


def _form_errors(selection: Selection) -> float:
    """Return the excess that the names would leave if their formulas were off by as much as formulas may be.

    Calibration may absorb nearly all of an effect, and nothing of the error of its form. So that error is relative to
    the whole effect, not to its visible part.
    """
    at = selection.fit
    whole = sum(max(energy_of(option) for option in own) for own in selection.sets)
    return thresholds().formula_error * whole / at.degrees


def _formed(finding: Finding, effect: Effect, selection: Selection) -> Finding:
    return replace(finding, form=form_words(effect, selection.forms, selection.fit.model.formulation))


def _said(findings: Sequence[Finding]) -> Verdict:
    """Return the verdict that follows from findings."""
    if not findings:
        return "none"
    sure = [f for f in findings if not f.caution]  # a finding that may be the error of a formula is no second claim
    return "ambiguous" if any(len(f.set) > 1 for f in sure) else "named"


def _worth_it(selection: Selection, base: Fit) -> bool:
    """Return whether a smooth term gains anything, or the misfit is clear: without either an alarm does not count."""
    return selection.first.smooth_gain > 0 or _lack_of_fit(selection.first, base) < thresholds().p_plain


def _explained(base: Fit, at: Fit, r: Array | None = None) -> float:
    """Return the part of the excess over the noise that a fit explains; with other residuals `r` than its own."""
    before = _excess(base)
    return 1 - max(_excess(at, r), 0.0) / before if before > 0 else 1.0


def _few(at: Fit) -> bool:
    """Return whether degrees of freedom are left, but so few that their scatter says little about the noise."""
    return bool(_NOTHING_LEFT < len(at.r) - at.J.shape[1] <= thresholds().few_degrees)


def _doubt(base: Fit, at: Fit, r: Array | None = None) -> float:
    """Return by how much the explained part may be underestimated, because degrees of freedom are few.

    It is 0 if they are many, else two standard deviations of the rest, which is a noncentral chi-square.
    """
    before = _excess(base)
    if not _few(base) or before <= 0:
        return 0.0
    degrees = len(at.r) - at.J.shape[1]
    rest = max(_excess(at, r), 0.0) * degrees
    return float(2 * np.sqrt(2 * (degrees + 2 * rest)) / degrees / before)


def _excess(at: Fit, r: Array | None = None) -> float:
    y = at.noise.scores(at.r if r is None else r)
    return float(y @ y) / int(len(y) - at.J.shape[1]) - 1.0


Sets = tuple[tuple[Option, ...], ...]


def with_alternatives(sets: Sets, base: Fit, beside: Sequence[Alternative]) -> Sets:
    """Return the sets of all picks, each with those of `beside` that gain nearly as much as its first name, or more."""
    if not beside:
        return sets
    limits = {b.effect: b.largest for b in beside}
    found = []
    for one in sets:
        without = fit_with(base, [s[0].effect for s in sets if s is not one])
        on = projected_scores(without)
        first = one[0].gain
        scored = [
            s
            for s, _ in score_all(without, on, list(limits))
            if s.m and delta_bic(s, on) > first - thresholds().refit_within
        ]
        fitted = [option(without, s, on) for s in scored]
        close = [o for o in fitted if o.gain > first - thresholds().close and o.amplitude <= limits[o.effect]]
        found.append((*one, *close))
    return tuple(found)


def with_smooth_terms(base: Fit, terms: Sequence[SmoothTerm], most: int) -> Fit:
    """Return the fit with the smooth terms that gain, at most as many as names, with which they are compared."""
    current = base
    for _ in range(max(most, thresholds().smooth_beside)):
        tests = run_tests(current, (), terms, None)
        if not tests.smooth_gain > 0:
            break
        best = tests.smooth[0].effect
        if not isinstance(best, SmoothTerm) or len(best.quantities) > 1:
            break
        [seen] = subspaces(tests.on, columns(current, best)[None], thresholds().smooth_visible)
        kept = replace(best, mix=seen.back)
        [(scored, _)] = score_all(current, tests.on, [kept])
        trial = option(current, scored, tests.on)
        if not (trial.gain > 0 and trial.fit.converged):
            break
        current = trial.fit
    return current


def standing(
    sets: Sequence[tuple[Option, ...]], base: Fit, terms: Sequence[SmoothTerm]
) -> tuple[tuple[Option, ...], ...]:
    """Return the sets that stand, each beside those before it, in the order of their gains.

    The first name of a set must gain more than the best smooth term, and beside all smooth terms as much as a further
    name must. `base` is the fit without effects. Of very many readings, where sets have no fits of their own, none
    stands.
    """
    if len(base.r) >= thresholds().drawn_rows:
        return ()
    held: list[tuple[Option, ...]] = []
    at, free = base, None
    for own in sorted(sets, key=lambda own: -own[0].gain):
        tests = run_tests(at, (), terms, None)
        beside = _with(at, own[0])
        if beside is None or _gain(at, beside, own[0], tests.on) <= tests.smooth_gain:
            continue
        free = free or with_smooth_terms(base, terms, len(sets))
        smooth = _with(free, own[0])
        if smooth is not None and _gain(free, smooth, own[0], tests.on) >= thresholds().further_gain:
            held.append(own)
            at = beside
    return tuple(held)


def _with(at: Fit, one: Option) -> Fit | None:
    """Return a fit with one more name; None where it does not converge."""
    found = fit_with(at, [one.effect])
    return found if found.converged and np.isfinite(found.cost) else None


def _gain(without: Fit, beside: Fit, one: Option, on: ProjectedScores) -> float:
    gained = without.noise.gained(without.cost, beside.cost, beside.degrees)
    return gained - penalty(one.effect, one.rank, on)
