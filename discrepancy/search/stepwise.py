"""The search itself: test, pick, test again; and the verdict that follows from what is picked and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from discrepancy.diagnostics.score import CHARTED, columns, score_all, subspaces
from discrepancy.diagnostics.smooth_term import Chart
from discrepancy.fitting.fit import MANY, Fit
from discrepancy.model.effect import Effect, name_of
from discrepancy.noise.mixture import NoiseFinding
from discrepancy.noise.repeats import excess_p
from discrepancy.report import Finding, Verdict
from discrepancy.search.finding import blamed_noise, finding_of
from discrepancy.search.select import Option, Tests, charge, option, options, run_tests, sets_of

_MOST = 3  # effects looked for
_EXPLAINED = 0.85  # part of the excess that names must account for
_WELL = 0.92  # the same where what is left is plain
_PLAIN = 1e-4  # p of what is plain
_CLEARLY = 6.0  # gain by which a chart must beat the names
_FAR = 2.5  # times the best name's gain at which a chart ends the search for names
_NEARLY = 0.97  # part of the excess beyond which a chart's greater gain only shows a formula's last per cents
_LEAST, _PART = 12.0, 0.005  # gain a further pick must have: at least, and as a part of what is explained already
_HOPED = 0.25  # part of that gain which the linear one must reach, of very many readings, for exact fits to be tried
_MATTERS = 0.15  # visible size [sigma] below which what is found is too small to matter


@final
@dataclass(frozen=True, eq=False)
class Hunt:
    """What the search ended with: the fit with all picks, their sets, the first tests, and p of "nothing is left"."""

    fit: Fit
    sets: tuple[tuple[Option, ...], ...]
    first: Tests
    p: float
    alarm: bool
    left: float
    charted: bool


def hunt(
    base: Fit, candidates: Sequence[Effect], atlas: Sequence[Chart], rng: np.random.Generator, level: float
) -> Hunt:
    """Return what is missing beside `base`: pick after pick while a test at `level` says that something is left."""
    current = base
    picks: list[Effect] = []
    sets: tuple[tuple[Option, ...], ...] = ()
    first: Tests | None = None
    first_p = 1.0
    while True:
        taken = {name_of(e) for e in picks}
        tests = run_tests(current, [e for e in candidates if name_of(e) not in taken], atlas, rng)
        p = _overall(current, tests)
        if first is None:
            first, first_p = tests, p
        if p >= level:
            break
        enough = _LEAST + _PART * sum(s[0].gain for s in sets) if sets else 0.0
        many = len(current.at.misclosure) >= MANY  # then exact fits take their time
        hopeless = many and tests.named < _HOPED * enough
        found = options(current, tests) if tests.p_names < level and not hopeless else ()  # misfit alone names nothing
        if found and found[0].gain > enough and len(picks) < _MOST and not tests.charted > _FAR * found[0].gain + 20:
            picks.append(found[0].effect)
            picked = sets_of(picks, found, base, candidates)
            if len(picked.sets) > 1 and min(s[0].gain for s in picked.sets) < _LEAST:
                break  # beside the others, exchanged for better ones, one of them explains nothing any more
            picks, current, sets = [s[0].effect for s in picked.sets], picked.fit, picked.sets
            continue
        break
    paid = sum(charge(found[0].effect, found[0].rank, first.on) for found in sets)
    smooth = first.charted
    if len(sets) > 1:  # several names against several charts
        free = _charted(base, atlas)
        smooth = base.cost - free.cost - float(np.log(len(base.r))) * (len(free.x) - len(base.x))
    charted = smooth > base.cost - current.cost - paid + _CLEARLY
    return Hunt(current, sets, first, first_p, first_p < level, p, charted)


def _charted(base: Fit, atlas: Sequence[Chart]) -> Fit:
    """Return the fit with the smooth charts that gain, at most three of them: what names must not fall short of."""
    current = base
    for _ in range(_MOST):
        tests = run_tests(current, (), atlas, None)
        if not tests.charted > 0:
            break
        best = tests.charts[0].effect
        if not isinstance(best, Chart) or len(best.quantities) > 1:
            break
        [seen] = subspaces(tests.on, columns(current, best)[None], CHARTED)
        kept = replace(best, mix=seen.back)
        [(scored, _)] = score_all(current, tests.on, [kept])
        trial = option(current, scored, tests.on)
        if not (trial.gain > 0 and trial.fit.converged):
            break
        current = trial.fit
    return current


def _overall(at: Fit, tests: Tests) -> float:
    """Return the p of "nothing more": the smallest of names (weight .5), charts (.3) and lack of fit (.2)."""
    y, degrees = tests.on.y, tests.on.degrees
    lack = excess_p(float(y @ y) / degrees, degrees, at.noise.known)
    return min(1.0, tests.p_names / 0.5, tests.p_charts / 0.3, lack / 0.2)


def verdict_of(
    hunt: Hunt, base: Fit, suspects: Sequence[NoiseFinding], level: float
) -> tuple[Verdict, tuple[Finding, ...]]:
    """Return the verdict and the findings; `suspects` are what the noise is blamed for besides."""
    blamed = tuple(blamed_noise(s) for s in suspects)
    if not hunt.alarm:
        return _said(blamed), blamed
    before, after = _excess(base), _excess(hunt.fit)
    explained = 1 - max(after, 0.0) / before if before > 0 else 1.0
    if not hunt.sets and not _worth_it(hunt, base):
        return _said(blamed), blamed
    short = hunt.left < level and explained < (_EXPLAINED if hunt.left > _PLAIN else _WELL)
    if not hunt.sets or short or (hunt.charted and explained < _NEARLY):
        return "unknown", ()
    named = [finding_of(hunt.fit, found) for found in hunt.sets]
    findings = tuple(sorted((*named, *blamed), key=lambda f: -f.gain))
    if np.sqrt(sum(f.visible**2 for f in findings)) < _MATTERS:
        return "negligible", findings
    return _said(findings), findings


def _said(findings: Sequence[Finding]) -> Verdict:
    """Return the verdict that findings make."""
    if not findings:
        return "none"
    return "ambiguous" if any(len(f.set) > 1 for f in findings) else "named"


def _worth_it(hunt: Hunt, base: Fit) -> bool:
    """Return whether a chart gains anything, or the misfit is plain: an alarm without either is of no consequence."""
    y, degrees = hunt.first.on.y, hunt.first.on.degrees
    misfit = excess_p(float(y @ y) / degrees, degrees, base.noise.known)
    return hunt.first.charted > 0 or misfit < _PLAIN


def _excess(at: Fit) -> float:
    y = at.noise.scores(at.r)
    return float(y @ y) / int(len(y) - at.J.shape[1]) - 1.0
