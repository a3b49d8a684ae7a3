"""Which names are still significant beside smooth functions: a name that only imitates an unnamed cause is not.

Where an error has no name, the nearest names explain a part of it, and smooth functions explain more. A named cause
that is there as well explains more than any smooth function of one covariate, because it shows in all readings at once;
and it still gains beside all smooth functions together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibench.discrepancy.diagnostics.score import ProjectedScores, columns, score_all, subspaces
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.search.select import Option, fit_with, option, penalty, run_tests
from calibench.discrepancy.thresholds import thresholds


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
