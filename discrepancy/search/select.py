"""Select effects: test, choose by BIC gain, refit exactly, and keep the confidence set of near-equal ones.

The gain of a candidate is what it brings in twice the log-likelihood, less log N for each coefficient that the data
see and 2 log of the places scanned for a change point. At every pick all candidates within `Thresholds.close`
of the winner stay in its set.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from calibench.discrepancy.diagnostics import score
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit, fit_once, once, orthonormal, project_off
from calibench.discrepancy.fitting.journal import kept_step
from calibench.discrepancy.model import effect as effects
from calibench.discrepancy.model.effect import Effect, is_possible, name_of
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.thresholds import thresholds

_DECIMALS = 6  # of a gain: beyond them is rounding
_FULL = 1e-10  # of the largest singular value, below which a direction is rounding
_SAME = 1e-6  # part of a cost: two fits that differ by less have the same signature but for rounding


@final
@dataclass(frozen=True, eq=False)
class Tests:
    """Candidates and smooth terms tested against one fit: linear gains, and family-wise p of names and smooth terms."""

    on: score.ProjectedScores
    names: tuple[score.Scored, ...]
    smooth: tuple[score.Scored, ...]
    p_names: float
    p_smooth: float

    @property
    def still(self) -> float:
        """Return the p of "nothing is left": the smaller of names' and smooth terms', each over its share."""
        return min(1.0, self.p_names / thresholds().share_names, self.p_smooth / thresholds().share_smooth)

    @property
    def smooth_gain(self) -> float:
        return max((delta_bic(s, self.on) for s in self.smooth), default=-np.inf)


@final
@dataclass(frozen=True, eq=False)
class Option:
    """A candidate fitted exactly beside the other picks: its model's fit and its gain over the model without it.

    `behind` is its distance to the best of its set if formulas may be off; infinite where that was not computed.
    `energy` is what `energy_of` tells of one whose fit is `light`, and has no rows.
    """

    effect: Effect
    fit: Fit
    gain: float
    rank: int
    behind: float = np.inf
    energy: float = 0.0

    @property
    def name(self) -> str:
        return name_of(self.effect)

    @property
    def paid(self) -> float:
        return penalty(self.effect, self.rank, len(self.fit.r))

    @property
    def amplitude(self) -> float:
        """Return the size an engineer quotes, without its sign."""
        return abs(self.effect.amplitude(self.fit.x[len(self.fit.x) - len(self.effect.coefficients) :]))


def delta_bic(scored: score.Scored, on: score.ProjectedScores) -> float:
    return on.gain(scored.T, scored.m) - penalty(scored.effect, scored.m, len(on.y))


def penalty(effect: Effect, rank: int, residuals: int) -> float:
    """Return the BIC penalty of a candidate of visible `rank`."""
    return rank * math.log(residuals) + 2 * math.log(max(effect.positions, 1))


def best_of_each(scored: Sequence[score.Scored], on: score.ProjectedScores) -> tuple[score.Scored, ...]:
    """Return the best form or place of every name, the largest gain first."""
    best: dict[str, tuple[float, score.Scored]] = {}
    gains = on.gains(np.array([s.T for s in scored]), np.array([s.m for s in scored]))
    for s, gain in zip(scored, gains.tolist()):
        gain, name = gain - penalty(s.effect, s.m, len(on.y)), s.name
        if name not in best or gain > best[name][0]:
            best[name] = gain, s
    return tuple(s for _, s in sorted(best.values(), key=lambda one: -one[0]))


def run_tests(
    at: Fit, candidates: Sequence[Effect], smooth: Sequence[SmoothTerm], rng: np.random.Generator | None,
    spared: bool = False,
) -> Tests:  # fmt: skip
    """Test all candidates against a fit; without `rng` the smallest p are corrected by their number (Bonferroni)."""
    on, members = score.projected_scores(at, spared), (*candidates, *smooth)

    def pack(tests: Tests) -> tuple[Any, ...]:
        state = None if rng is None else rng.bit_generator.state
        places = {id(effect): place for place, effect in enumerate(members)}
        each = [
            [(places[id(s.effect)], vars(s) | {"effect": None}) for s in own] for own in (tests.names, tests.smooth)
        ]
        return state, each, tests.p_names, tests.p_smooth

    def unpack(kept: tuple[Any, ...]) -> Tests:
        state, each, *p = kept
        if rng is not None:
            rng.bit_generator.state = state
        names, smooth = (tuple(score.Scored(**(s | {"effect": members[place]})) for place, s in own) for own in each)
        return Tests(on, names, smooth, *p)

    of = ("tests", len(candidates), len(smooth), spared, at.x, at.r)
    return kept_step(lambda: _tested(at, on, candidates, smooth, rng), of, pack, unpack)


def _tested(
    at: Fit, on: score.ProjectedScores, candidates: Sequence[Effect], smooth: Sequence[SmoothTerm],
    rng: np.random.Generator | None,
) -> Tests:  # fmt: skip
    scored: list[list[score.Scored]] = []
    p, t = [], thresholds()
    groups: tuple[tuple[Sequence[Effect], float], ...] = ((candidates, t.visible), (smooth, t.smooth_visible))
    for members, least in groups:
        tested = score.score_all(at, on, members, least, bases=rng is not None, sums=True)
        smallest, law = min((s.p for s, _ in tested), default=1.0), np.empty(0)
        if rng is not None and t.p_sure < smallest < t.p_calm:  # else draws decide nothing
            # the tests themselves do without some of the bases
            known = [U for s, U in tested if s.m and len(U)]
            rest = score.score_all(at, on, [s.effect for s, U in tested if not len(U)], least, bases=True)
            law = score.smallest_p_law(on, [*known, *(U for s, U in rest if s.m and len(U))], rng)
        p.append(score.family_wise(smallest, law, max(len(tested), 1)))
        scored.append([s for s, _ in tested])
    ranked = sorted(scored[1], key=lambda s: -delta_bic(s, on))
    return Tests(on, tuple(scored[0]), tuple(ranked), p[0], p[1])


def options(base: Fit, tests: Tests) -> tuple[Option, ...]:
    """Return the candidates near the best one, each fitted exactly, the largest gain first."""
    on, t, data = tests.on, thresholds(), base.model.formulation.data
    named = [s for s in best_of_each(tests.names, on) if s.m]
    if not named:
        return ()
    # a step is taken at the best of its finer places: at the wrong one of two readings it would be far behind
    top = max(delta_bic(s, on) for s in named)
    ranked = []
    for s in named:
        steps = isinstance(s.effect, effects.ChangePoint) and delta_bic(s, on) > t.change_hopeful * top
        places = _finer(s.effect, data) if steps else ()
        placed = [one for one, _ in score.score_all(base, on, places, sums=True)] if places else []
        placed = [*best_of_each(placed, on)[:1]]
        ranked.append(max((s, *placed), key=lambda one: delta_bic(one, on)))
    ranked.sort(key=lambda s: -delta_bic(s, on))
    # those near the best, and on its part those whose linear gain is unreliable
    top, of_any_phase = delta_bic(ranked[0], on), gains_of_any_phase(base, on, ranked)
    gains = {s.name: max(delta_bic(s, on), of_any_phase.get(s.name, -np.inf)) for s in ranked}
    near = [s for s in ranked if gains[s.name] > top - t.refit_within - 0.1 * abs(top)][: t.refit_most]
    part_of = description_of(data.machine).part_of
    where = {part_of(s.effect.target) for s in near[:2]}
    bent = [s for s in ranked if s not in near and s.seen.visible < t.bent and part_of(s.effect.target) in where]
    found: list[Option] = []
    # scores that are cut where tails are heavy may show another form of a large effect as the best than whole ones do
    whole = replace(on, y=project_off(replace(base.noise, t_degrees=np.inf).scores(base.r), on.Q))
    names = {s.name for s in (*near, *bent)} if np.isfinite(base.noise.t_degrees) else set()
    forms = [s.effect for s in tests.names if s.name in names]
    others = {s.name: s for s in best_of_each([s for s, _ in score.score_all(base, whole, forms, sums=True)], whole)}
    for scored in (*near, *bent):
        one = option(base, scored, on)
        other = others.get(scored.name, scored)
        if other.effect is not scored.effect and other.m:
            one = max(one, option(base, other, whole), key=lambda o: o.gain)
        if is_possible(one.effect, one.amplitude):
            found.append(one)
            if len(base.r) >= t.drawn_rows:  # the arrays of all of them would take gigabytes
                first = _in_order(found)[0]
                found = [o if o is first else light(o, base) for o in found]
    return _in_order(found)


def gains_of_any_phase(
    base: Fit, on: score.ProjectedScores, named: Sequence[score.Scored | Option]
) -> dict[str, float]:
    """Return, for each of `named` that is the sine or the cosine of a wave of any phase, the linear gain of the wave.

    It may explain more than the best name, though neither of its terms does alone.
    """
    wholes = {s.name: whole for s in named if (whole := getattr(s.effect, "whole", None)) is not None}
    scored = score.score_all(base, on, list(wholes.values()), sums=True)
    return {name: delta_bic(s, on) for name, (s, _) in zip(wholes, scored)}


def light(o: Option, base: Fit) -> Option:
    rows = np.empty(0), np.empty((0, len(o.fit.x)))
    return replace(o, fit=replace(o.fit, at=base.at, r=rows[0], J=rows[1]), energy=energy_of(o))


def _in_order(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return options by gain; of those that differ from the best only by an error of form, the simplest comes first.

    Exact twins differ by rounding alone, so their names decide which of them leads the set.
    """
    best, names = max((o.gain for o in found), default=0.0), {o.name for o in found}

    def rank(o: Option) -> tuple[float, int, float, str]:
        gain = round(float(o.gain), _DECIMALS)
        if o.gain < best - thresholds().form * best:
            return 1.0, 0, -gain, o.name
        later = o.effect.target == "all" and not names.isdisjoint(o.effect.twins)
        return 0.0, len(o.effect.coefficients), -gain + (thresholds().close if later else 0.0), o.name

    return tuple(sorted(found, key=rank))


def option(base: Fit, scored: score.Scored, on: score.ProjectedScores) -> Option:
    """Return a scored candidate fitted exactly, a change point at the best of its finer places too."""
    best = _refit(base, scored, on)
    if near := _finer(scored.effect, base.model.formulation.data):
        fine = best_of_each([s for s, _ in score.score_all(base, on, near, sums=True)], on)[0]
        if fine.T > scored.T:
            best = max(best, _refit(base, fine, on), key=lambda o: o.gain)
    return best


def _finer(effect: Effect, data: MeasuredData) -> tuple[Effect, ...]:
    """Return the same finer places whenever they are asked for: a fit with one of them is known by it."""
    return once(lambda: effects.finer(effect, data), (effect, data), "finer")


def _refit(base: Fit, scored: score.Scored, on: score.ProjectedScores) -> Option:
    effect, c = scored.effect, scored.coefficients
    model = base.model.with_effects(effect)
    found = fit_once(model, base.noise, np.concatenate([base.x, c]), about=base)
    waves = isinstance(effect, effects.OfFreePeriod)  # at amplitude zero a fit cannot find the period
    if not (found.converged or waves) or not found.cost <= base.cost:
        damped = fit_once(model, base.noise, np.concatenate([base.x, np.zeros(len(c))]), near=False)
        found = min(found, damped, key=lambda f: f.cost if np.isfinite(f.cost) else np.inf)
    gain = base.noise.gained(base.cost, found.cost, found.degrees)
    return Option(effect, found, gain - penalty(effect, scored.m, len(on.y)), scored.m)


def close(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return the best option and those that come close to it."""
    top = max(found, key=lambda o: o.gain)
    noise, degrees, near = top.fit.noise, top.fit.degrees, thresholds().close
    return tuple(o for o in found if o is top or noise.told_apart(top.gain - o.gain - spared(o, top), degrees) < near)


def spared(o: Option, top: Option) -> float:
    """Return the part of the best one's gain that is not counted against an option: no formula is exact physics.

    A formula with more numbers has no such allowance, but where it is a twin over other columns: then only the price of
    its numbers tells them apart, and that is no reading. One with fewer has: what the error of its form leaves, because
    the richer formula may fit better only as it absorbs that error.
    """
    numbers = len(o.effect.coefficients) - len(top.effect.coefficients)
    if o.effect.positions > top.effect.positions and abs(o.fit.cost - top.fit.cost) <= _SAME * top.fit.cost:
        return top.gain - o.gain  # it changes just when the other one does: one place, and the same signature
    if numbers > 0:
        return max(o.paid - top.paid, 0.0) if _is_twin(o, top) else 0.0
    if numbers == 0:
        return thresholds().form * top.gain
    # less the gain of a signal that is so large a part of the best one
    part, count = 1 - thresholds().formula_error, top.fit.at.misclosure.size
    if not top.fit.noise.profiled or top.gain <= 0:
        return top.gain - part * top.gain
    return top.gain - -count * float(np.log1p(part * np.expm1(-top.gain / count)))


def _is_twin(o: Option, top: Option) -> bool:
    """Return whether an option over other columns than the best one has its signature, beside calibration."""
    J, k = o.fit.J, len(o.effect.coefficients)
    if {*o.effect.columns} & {*top.effect.columns} or not len(J) == len(top.fit.J) > 0:
        return False
    own = len(top.effect.coefficients)
    trace = top.fit.J[:, -own:] @ top.fit.x[-own:]
    seen, rest = (project_off(trace, orthonormal(part, _FULL), times=2) for part in (J[:, :-k], J))
    return bool(rest @ rest < thresholds().form * (seen @ seen))


def fit_with(base: Fit, effects: Sequence[Effect]) -> Fit:
    """Return the fit with `effects` added one after the other, each started from its linear coefficients."""
    current = base
    for effect in effects:
        if not np.isfinite(current.cost):
            break
        on = score.projected_scores(current)
        [(one, _)] = score.score_all(current, on, [effect])
        current = _refit(current, one, on).fit
    return current


def energy_of(o: Option) -> float:
    """Return the energy of an option's signature, in scores, before calibration absorbs a part of it."""
    if not len(o.fit.r):
        return o.energy
    k = len(o.effect.coefficients)
    trace = o.fit.J[:, -k:] @ o.fit.x[-k:] * o.fit.noise.gain
    return float(trace @ trace)
