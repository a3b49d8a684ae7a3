"""The stepwise search: test, select, test again; then the verdict from what was selected and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import columns, score_all, subspaces
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import Effect, name_of, still_open
from calibench.discrepancy.noise.mixture import NoiseFinding
from calibench.discrepancy.noise.repeats import excess_p
from calibench.discrepancy.report import Finding, Verdict
from calibench.discrepancy.search.finding import blamed_noise, finding_of
from calibench.discrepancy.search.select import Option, Tests, option, options, penalty, run_tests, sets_of
from calibench.discrepancy.thresholds import thresholds


@final
@dataclass(frozen=True, eq=False)
class Selection:
    """What the search ended with: the fit with all picks, their sets, the first tests, and p of "nothing is left"."""

    fit: Fit
    sets: tuple[tuple[Option, ...], ...]
    first: Tests
    p: float
    alarm: bool
    left: float
    smooth_explains: bool


def select_stepwise(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], rng: np.random.Generator, level: float
) -> Selection:
    """Select effects beside `base` one after the other, until the residual test at `level` passes."""
    current = base
    picks: list[Effect] = []
    sets: tuple[tuple[Option, ...], ...] = ()
    first: Tests | None = None
    first_p = 1.0
    while True:
        taken = {name_of(e) for e in picks}
        tests = run_tests(current, still_open(candidates, taken), terms, rng)
        p = _overall(current, tests)
        if first is None:
            first, first_p = tests, p
        if p >= level:
            break
        enough = thresholds().further_gain + thresholds().further_share * sum(s[0].gain for s in sets) if sets else 0.0
        many = len(current.at.misclosure) >= thresholds().many_readings  # then exact fits take their time
        hopeless = many and tests.named < thresholds().linear_hope * enough
        found = options(current, tests) if tests.p_names < level and not hopeless else ()  # misfit alone names nothing
        if (
            found
            and found[0].gain > enough
            and len(picks) < thresholds().effects_most
            and not tests.smooth_gain > thresholds().smooth_far * found[0].gain + 20
        ):
            picks.append(found[0].effect)
            picked = sets_of(picks, found, base, candidates)
            if len(picked.sets) > 1 and min(s[0].gain for s in picked.sets) < thresholds().further_gain:
                break  # beside the others, exchanged for better ones, one of them explains nothing any more
            picks, current, sets = [s[0].effect for s in picked.sets], picked.fit, picked.sets
            continue
        break
    paid = sum(penalty(found[0].effect, found[0].rank, first.on) for found in sets)
    smooth = first.smooth_gain
    if len(sets) > 1:  # several names against several smooth terms
        free = _with_smooth_terms(base, terms)
        smooth = base.cost - free.cost - float(np.log(len(base.r))) * (len(free.x) - len(base.x))
    smooth_explains = smooth > base.cost - current.cost - paid + thresholds().smooth_clearly
    return Selection(current, sets, first, first_p, first_p < level, p, smooth_explains)


def _with_smooth_terms(base: Fit, terms: Sequence[SmoothTerm]) -> Fit:
    """Return the fit with the smooth terms that gain, at most three: named effects must explain as much."""
    current = base
    for _ in range(thresholds().effects_most):
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


def _overall(at: Fit, tests: Tests) -> float:
    """Return the p of "nothing more": the smallest of names, smooth terms and lack of fit, each by its share."""
    y, degrees = tests.on.y, tests.on.degrees
    lack = excess_p(float(y @ y) / degrees, degrees, at.noise.known)
    return min(
        1.0,
        tests.p_names / thresholds().share_names,
        tests.p_smooth / thresholds().share_smooth,
        lack / thresholds().share_misfit,
    )


def verdict_of(
    selection: Selection, base: Fit, suspects: Sequence[NoiseFinding], level: float
) -> tuple[Verdict, tuple[Finding, ...]]:
    """Return the verdict and the findings; `suspects` are findings about the noise."""
    blamed = tuple(blamed_noise(s) for s in suspects)
    if not selection.alarm:
        return _said(blamed), blamed
    before, after = _excess(base), _excess(selection.fit)
    explained = 1 - max(after, 0.0) / before if before > 0 else 1.0
    if not selection.sets and not _worth_it(selection, base):
        return _said(blamed), blamed
    short = selection.left < level and explained < (
        thresholds().explained if selection.left > thresholds().p_plain else thresholds().explained_plain
    )
    if not selection.sets or short or (selection.smooth_explains and explained < thresholds().explained_nearly):
        return "unknown", ()
    named = [finding_of(selection.fit, found) for found in selection.sets]
    findings = tuple(sorted((*named, *blamed), key=lambda f: -f.gain))
    if np.sqrt(sum(f.visible**2 for f in findings)) < thresholds().matters:
        return "negligible", findings
    return _said(findings), findings


def _said(findings: Sequence[Finding]) -> Verdict:
    """Return the verdict that findings make."""
    if not findings:
        return "none"
    return "ambiguous" if any(len(f.set) > 1 for f in findings) else "named"


def _worth_it(selection: Selection, base: Fit) -> bool:
    """Return whether a smooth term gains anything, or the misfit is plain: without either an alarm does not count."""
    y, degrees = selection.first.on.y, selection.first.on.degrees
    misfit = excess_p(float(y @ y) / degrees, degrees, base.noise.known)
    return selection.first.smooth_gain > 0 or misfit < thresholds().p_plain


def _excess(at: Fit) -> float:
    y = at.noise.scores(at.r)
    return float(y @ y) / int(len(y) - at.J.shape[1]) - 1.0
