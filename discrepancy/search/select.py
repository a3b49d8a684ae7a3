"""Select effects: test, choose by BIC gain, refit exactly, and keep the confidence set of near-equal ones.

The gain of a candidate is what it brings in twice the log-likelihood, less log N for each coefficient that the data
see and 2 log of the places scanned for a change point. At every pick all candidates within `Thresholds.close`
of the winner stay in its set.

Screening: a part of very many readings shows which candidates can still win; only those are fitted to all readings.

Each candidate is fitted to the same part of the readings. The difference of two candidates' gains is a sum over
readings, so its value over all readings can be estimated, with a standard error. A candidate is left out if it is
behind by more than several standard errors, and by more than a fit to all readings could change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import (
    ProjectedScores,
    Scored,
    family_wise,
    projected_scores,
    score_all,
    smallest_p_law,
)
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit, fit, part_of
from calibench.discrepancy.fitting.kept import fit_once
from calibench.discrepancy.model.effect import (
    ChangePoint,
    Effect,
    OfFreePeriod,
    finer,
    has_free_period,
    is_possible,
    name_of,
    whole_of,
)
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_SAME = 1e-6  # part of a cost: two fits that differ by less have the same signature but for rounding


@final
@dataclass(frozen=True, eq=False)
class Tests:
    """Candidates and smooth terms tested against one fit: linear gains, and family-wise p of names and smooth terms."""

    on: ProjectedScores
    names: tuple[Scored, ...]
    smooth: tuple[Scored, ...]
    p_names: float
    p_smooth: float

    @property
    def still(self) -> float:
        """Return the p of "nothing is left": the smaller of names' and smooth terms', each over its share."""
        return min(1.0, self.p_names / thresholds().share_names, self.p_smooth / thresholds().share_smooth)

    @property
    def named(self) -> float:
        """Return the largest gain of a name."""
        return max((delta_bic(s, self.on) for s in self.names), default=-np.inf)

    @property
    def smooth_gain(self) -> float:
        """Return the largest gain of a smooth term."""
        return max((delta_bic(s, self.on) for s in self.smooth), default=-np.inf)


@final
@dataclass(frozen=True, eq=False)
class Option:
    """A candidate fitted exactly beside the other picks: its model's fit and its gain over the model without it.

    `behind` is its distance to the best of its set if formulas may be off; infinite where that was not computed.
    """

    effect: Effect
    fit: Fit
    gain: float
    rank: int
    behind: float = np.inf

    @property
    def name(self) -> str:
        """Return family and target."""
        return name_of(self.effect)

    @property
    def paid(self) -> float:
        """Return the BIC penalty in the gain."""
        return _penalty(self.effect, self.rank, len(self.fit.r))

    @property
    def amplitude(self) -> float:
        """Return the size an engineer quotes, without its sign."""
        return _quoted(self.effect, self.fit.x)


def delta_bic(scored: Scored, on: ProjectedScores) -> float:
    """Return the linear gain of a scored candidate."""
    return on.gain(scored.T, scored.m) - penalty(scored.effect, scored.m, on)


def penalty(effect: Effect, rank: int, on: ProjectedScores) -> float:
    """Return the BIC penalty of a candidate of visible `rank`."""
    return _penalty(effect, rank, on.Q.shape[0])


def _penalty(effect: Effect, rank: int, residuals: int) -> float:
    return rank * math.log(residuals) + 2 * math.log(max(effect.positions, 1))


def best_of_each(scored: Sequence[Scored], on: ProjectedScores) -> tuple[Scored, ...]:
    """Return the best form or place of every name, the largest gain first."""
    best: dict[str, tuple[float, Scored]] = {}
    for s in scored:
        gain, name = delta_bic(s, on), s.name
        if name not in best or gain > best[name][0]:
            best[name] = gain, s
    return tuple(s for _, s in sorted(best.values(), key=lambda one: -one[0]))


def run_tests(
    at: Fit, candidates: Sequence[Effect], smooth: Sequence[SmoothTerm], rng: np.random.Generator | None,
    spared: bool = False,
) -> Tests:  # fmt: skip
    """Test all candidates against a fit; without `rng` the smallest p are corrected by their number (Bonferroni).

    With `spared`, single readings far off are no evidence, see `ProjectedScores`.
    """
    on = projected_scores(at, spared)
    kept: list[list[Array]] = [[], []]
    scored: list[list[Scored]] = [[], []]
    for group, members in enumerate((candidates, smooth)):
        for one, U in score_all(at, on, members, _least(group), bases=False):
            scored[group].append(one)
            if one.m and len(U):
                kept[group].append(U)
    p = []
    for group in (0, 1):
        smallest = min((s.p for s in scored[group]), default=1.0)
        law = np.empty(0)
        if rng is not None and thresholds().p_sure < smallest < thresholds().p_calm:  # else draws decide nothing
            law = smallest_p_law(on, [*kept[group], *_of_waves(at, on, (candidates, smooth)[group])], rng)
        p.append(family_wise(smallest, law, max(len(scored[group]), 1)))
    smooth_sorted = tuple(sorted(scored[1], key=lambda s: -delta_bic(s, on)))
    return Tests(on, tuple(scored[0]), smooth_sorted, p[0], p[1])


def _least(group: int) -> float:
    return (thresholds().visible, thresholds().smooth_visible)[group]


def _of_waves(at: Fit, on: ProjectedScores, candidates: Sequence[Effect]) -> list[Array]:
    """Return the visible bases of the waves of free period, which the tests themselves do without."""
    waves = [effect for effect in candidates if has_free_period(effect)]
    return [U for one, U in score_all(at, on, waves) if one.m and len(U)]


def options(base: Fit, tests: Tests) -> tuple[Option, ...]:
    """Return the candidates near the best one, each fitted exactly, the largest gain first."""
    ranked = _placed(base, tests.on, [s for s in best_of_each(tests.names, tests.on) if s.m])
    if not ranked:
        return ()
    top = delta_bic(ranked[0], tests.on)
    of_any_phase = gains_of_any_phase(base, tests.on, ranked)
    gains = {s.name: max(delta_bic(s, tests.on), of_any_phase.get(s.name, -np.inf)) for s in ranked}
    near = [s for s in ranked if gains[s.name] > top - thresholds().refit_within - 0.1 * abs(top)][
        : thresholds().refit_most
    ]
    part_of = description_of(base.model.formulation.data.machine).part_of
    where = {part_of(s.effect.target) for s in near[:2]}
    bent = [s for s in ranked if s not in near and s.visible < thresholds().bent and part_of(s.effect.target) in where]
    found: list[Option] = []
    for scored in screened(base, (*near, *bent), _bearable):
        one = option(base, scored, tests.on)
        if _bearable(one.effect, one.fit.x):
            found = _spared([*found, one], base)
    return _in_order(found)


def gains_of_any_phase(base: Fit, on: ProjectedScores, named: Sequence[Scored | Option]) -> dict[str, float]:
    """Return, for each of `named` that is the sine or the cosine of a wave of any phase, the linear gain of the wave.

    It may explain more than the best name, though neither of its terms does alone.
    """
    wholes = {s.name: whole for s in named if (whole := whole_of(s.effect)) is not None}
    scored = score_all(base, on, list(wholes.values()), bases=False)
    return {name: delta_bic(s, on) for name, (s, _) in zip(wholes, scored)}


def _placed(base: Fit, on: ProjectedScores, ranked: Sequence[Scored]) -> list[Scored]:
    """Return the best of each name, the largest gain first; a step is taken at the best of its finer places.

    Without that, a step at the wrong one of two readings would be far behind beside a clear effect, and would not be
    tried again.
    """
    top = max((delta_bic(s, on) for s in ranked), default=0.0)
    kept = []
    for s in ranked:
        steps = isinstance(s.effect, ChangePoint) and delta_bic(s, on) > thresholds().change_hopeful * top
        near = finer(s.effect, base.model.formulation.data) if steps else ()
        placed = best_of_each([one for one, _ in score_all(base, on, near, bases=False)], on)[:1] if near else ()
        kept.append(max((s, *placed), key=lambda one: delta_bic(one, on)))
    return sorted(kept, key=lambda s: -delta_bic(s, on))


def _spared(found: list[Option], base: Fit) -> list[Option]:
    """Return options; where rows are many only the first keeps its arrays, because all of them would take gigabytes."""
    if len(base.r) < thresholds().drawn_rows:
        return found
    first = _in_order(found)[0]
    return [o if o is first else light(o, base) for o in found]


def light(o: Option, base: Fit) -> Option:
    """Return an option without the arrays of its fit."""
    return replace(o, fit=replace(o.fit, at=base.at, r=base.r[:0], J=base.J[:0]))


def _bearable(effect: Effect, x: Array) -> bool:
    """Return whether an effect, its coefficients the last of x, is physically possible."""
    return is_possible(effect, _quoted(effect, x))


def _quoted(effect: Effect, x: Array) -> float:
    """Return the size an engineer quotes, without its sign, of the effect whose coefficients are the last of x."""
    return abs(effect.amplitude(x[len(x) - len(effect.coefficients) :]))


def _in_order(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return options by gain; of those that differ from the best only by an error of form, the simplest comes first.

    Of declared twins, which no data can order, the one of one instrument comes before the one of all joints.
    """
    if not found:
        return ()
    best = max(o.gain for o in found)

    def rank(o: Option) -> tuple[float, int, float]:
        if o.gain < best - thresholds().form * best:
            return 1.0, 0, -o.gain
        shared = any(twin in {other.name for other in found} for twin in o.effect.twins)
        return (
            0.0,
            len(o.effect.coefficients),
            -o.gain + (thresholds().close if shared and o.effect.target == "all" else 0.0),
        )

    return tuple(sorted(found, key=rank))


def option(base: Fit, scored: Scored, on: ProjectedScores) -> Option:
    """Return a scored candidate fitted exactly, a change point at the best of its finer places too."""
    best = _refit(base, scored.effect, scored.coefficients, scored.m, on)
    near = finer(scored.effect, base.model.formulation.data)
    if near:
        fine = best_of_each([s for s, _ in score_all(base, on, near, bases=False)], on)[0]
        if fine.T > scored.T:
            trial = _refit(base, fine.effect, fine.coefficients, fine.m, on)
            best = max(best, trial, key=lambda o: o.gain)
    return best


def _refit(base: Fit, effect: Effect, c: Array, rank: int, on: ProjectedScores) -> Option:
    model = base.model.with_effects(effect)
    found = fit_once(model, base.noise, np.concatenate([base.x, c]), about=base)
    waves = isinstance(effect, OfFreePeriod)  # at amplitude zero a fit cannot find the period
    if not (found.converged or waves) or not found.cost <= base.cost:
        damped = fit_once(model, base.noise, np.concatenate([base.x, np.zeros(len(c))]), near=False)
        found = min(found, damped, key=lambda f: f.cost if np.isfinite(f.cost) else np.inf)
    gain = base.noise.gained(base.cost, found.cost, found.degrees)
    return Option(effect, found, gain - penalty(effect, rank, on), rank)


def close(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return the best option and those that come close to it."""
    top = max(found, key=lambda o: o.gain)
    near = thresholds().close
    return tuple(o for o in found if o is top or told_apart(top, top.gain - o.gain - spared(o, top)) < near)


def told_apart(top: Option, behind: float) -> float:
    """Return the significance of the distance `behind` of an option to the best one, where readings are very many."""
    return top.fit.noise.told_apart(behind, top.fit.degrees)


def spared(o: Option, top: Option) -> float:
    """Return the part of the best one's gain that is not counted against an option: no formula is exact physics.

    A formula with more numbers has no such allowance. One with fewer has: what the error of its form leaves, because
    the richer formula may fit better only as it absorbs that error.
    """
    numbers = len(o.effect.coefficients) - len(top.effect.coefficients)
    if o.effect.positions > top.effect.positions and abs(o.fit.cost - top.fit.cost) <= _SAME * top.fit.cost:
        return top.gain - o.gain  # it changes just when the other one does: one place, and the same signature
    if numbers > 0:
        return 0.0
    if numbers == 0:
        return thresholds().form * top.gain
    return top.gain - top.fit.noise.gain_of(1 - thresholds().formula_error, top.gain, top.fit.at.misclosure.size)


def fit_with(base: Fit, effects: Sequence[Effect]) -> Fit:
    """Return the fit with `effects` added one after the other, each started from its linear coefficients.

    Where one of them has no fit, the others are not tried, and the cost is not finite.
    """
    current = base
    for effect in effects:
        if not np.isfinite(current.cost):
            break
        on = projected_scores(current)
        [(one, _)] = score_all(current, on, [effect])
        current = _refit(current, effect, one.coefficients, one.m, on).fit
    return current


def screened(base: Fit, scored: Sequence[Scored], bearable: Callable[[Effect, Array], bool]) -> tuple[Scored, ...]:
    """Return which of `scored` are worth a fit to all the readings; all of them where readings are not very many.

    `bearable(effect, x)` says whether a fitted candidate may win.
    """
    n = len(base.at.misclosure)
    if n < thresholds().many_readings or len(scored) < 2:
        return tuple(scored)
    model, noise = part_of(base.model, base.noise)
    plain = fit(model, noise, base.x)
    fits = [fit(model.with_effects(s.effect), noise, np.concatenate([base.x, s.coefficients])) for s in scored]
    sound = [k for k, f in enumerate(fits) if f.cost <= plain.cost]
    able = [k for k in sound if bearable(scored[k].effect, fits[k].x)]
    if not able:
        return tuple(scored)
    best = min(able, key=lambda k: fits[k].cost)
    readings = len(model.formulation.data)
    grown, size = n / readings, len(scored[best].coefficients)
    top = grown * (plain.cost - fits[best].cost)

    def out(k: int) -> bool:
        behind = (noise.costs(fits[k].r) - noise.costs(fits[best].r)).reshape(readings, -1).sum(axis=1)
        fitted = grown * (size + len(scored[k].coefficients)) + size * np.log(len(base.r))  # as part of any gain
        spare = (
            thresholds().behind_share_placed if scored[k].effect.positions > 1 else thresholds().behind_share
        ) * top + fitted
        return bool(grown * (behind.sum() - thresholds().behind_errors * np.sqrt(readings) * behind.std()) > spare)

    return tuple(s for k, s in enumerate(scored) if k not in sound or not out(k))
