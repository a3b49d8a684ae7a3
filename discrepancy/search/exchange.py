"""Exchange picks: search again for each one while the others stay in the model, then for two at a time.

The first pick was chosen while the others were missing, so it may represent two of them at once. Exchanging one pick
finds the better name where all others are right. Two causes whose sum looks like a third one need more: two picks are
removed, and all pairs are tried in their place. Pairs are compared by their linear gains; a pair is fitted only where
its linear gain is larger.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import ProjectedScores, Scored, projected_scores, score_all
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.model.effect import Effect, name_of, still_open
from calibench.discrepancy.search.off_form import near
from calibench.discrepancy.search.select import Option, best_of_each, fit_with, light, options, penalty, run_tests
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import folds
from calibench.problems.base import Array

Kept = Mapping[str, tuple[Option, ...]]  # name -> its set
NOTHING: Kept = {}

_SAME = 1e-4  # squared length of a direction beside the other candidate: below this both have the direction in common
# part of a column's square that is added, so that a direction that only the left-out poses determine is held
_HELD = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Picked:
    """The effects chosen and, for each, the options that come close; the fit with all of them."""

    fit: Fit
    sets: tuple[tuple[Option, ...], ...]

    @property
    def effects(self) -> list[Effect]:
        """Return the first of each set."""
        return [options[0].effect for options in self.sets]

    @property
    def by_name(self) -> dict[str, tuple[Option, ...]]:
        """Return the set of each pick under its name."""
        return {options[0].name: options for options in self.sets}


def beside(
    picked: Picked, found: Sequence[Option], base: Fit, candidates: Sequence[Effect], kept: Kept = NOTHING
) -> Picked:
    """Return the picks with the first of `found` added. Few picks are all exchanged; of many only the new one is.

    `base` is the fit without effects.
    """
    if len(picked.sets) >= thresholds().exchanged_at_once:
        close = near(found)
        return Picked(close[0].fit, (*picked.sets, close))
    return exchange([*picked.effects, found[0].effect], found, base, candidates, kept)


def exchange(
    picks: Sequence[Effect], found: Sequence[Option], base: Fit, candidates: Sequence[Effect],
    kept: Kept = NOTHING, rounds: int = 3,
) -> Picked:  # fmt: skip
    """Exchange each pick, with the others in the model, until none changes; and collect the set of each.

    `picks` are in the order of their choice, the last of them out of `found`; () where nothing was added. `kept` are
    the sets of those that are not exchanged: their forms are in `base`, and explain a part of what they explain.
    """
    chosen = list(picks)
    if len(chosen) == 1 and found:
        close = near(found)
        first = close[0].fit
        return Picked(first if len(first.r) else fit(first.model, first.noise, first.x), (close,))
    sets: list[tuple[Option, ...]] = []
    tried: dict[int, tuple[list[Effect], Sequence[Option]]] = {len(chosen) - 1: (chosen[:-1], found)} if found else {}
    best: Option | None = None
    for _ in range(rounds):
        sets, changed = [], False
        for i in range(len(chosen)):
            if (own := kept.get(name_of(chosen[i]))) is not None:
                sets.append(own)
                continue
            others = [e for j, e in enumerate(chosen) if j != i]
            if i not in tried or any(e is not other for e, other in zip(tried[i][0], others)):
                tried[i] = others, _beside(fit_with(base, others), others, candidates)
            if not (options := tried[i][1]):
                continue
            own = near(options)
            best = own[0]
            sets.append(tuple(light(o, base) for o in own) if len(base.r) >= thresholds().drawn_rows else own)
            changed = changed or best.name != name_of(chosen[i])
            chosen[i] = best.effect
        if not changed:
            break
    # the last to be looked at was fitted beside all others as they are now
    if best is not None and best.effect is chosen[-1] and len(best.fit.r) and best.fit.converged:
        return Picked(best.fit, tuple(sets))
    return Picked(fit_with(base, chosen), tuple(sets))


def _beside(without: Fit, others: Sequence[Effect], candidates: Sequence[Effect]) -> Sequence[Option]:
    taken = {name_of(e) for e in others}
    return options(without, run_tests(without, still_open(candidates, taken), (), None))


def settled(picked: Picked, base: Fit, candidates: Sequence[Effect], kept: Kept = NOTHING) -> Picked:
    """Return the picks after a last exchange, of pairs and then of single ones, without those that explain nothing.

    A single pick is replaced by two others that together explain clearly more.
    """
    if not picked.sets or len(base.r) >= thresholds().drawn_rows:
        return picked
    if len(picked.sets) == 1:
        return _in_place_of_one(picked, base, candidates, kept)
    other = _better_pair(picked, base, candidates, kept)
    if other is None and len(picked.sets) <= thresholds().exchanged_at_once:
        return picked
    effects = other or picked.effects
    while True:
        after = exchange(effects, (), base, candidates, kept, rounds=2)
        worst = min((s for s in after.sets if s[0].name not in kept), key=lambda s: s[0].gain, default=after.sets[0])
        if worst[0].gain >= thresholds().further_gain or len(after.sets) < 3:
            return after
        effects = [s[0].effect for s in after.sets if s is not worst]


def _better_pair(picked: Picked, base: Fit, candidates: Sequence[Effect], kept: Kept) -> list[Effect] | None:
    """Return the picks with two of them replaced by a pair that explains more; None where there is no such pair."""
    at, own = picked.fit, picked.effects
    gains = {s[0].name: s[0].gain for s in picked.sets}
    free = [e for e in own if name_of(e) not in kept]
    pairs = sorted(combinations(free, 2), key=lambda two: sum(gains[name_of(e)] for e in two))
    best, least = None, thresholds().close
    for two in pairs[: thresholds().pairs_most]:
        others = [e for e in own if e not in two]
        on, taken = _without(at, two), {name_of(e) for e in others}
        new = still_open(candidates, taken)
        scored = [(s, U) for s, U in score_all(at, on, [*two, *new]) if s.m]
        first = {s.name: (s, U) for s, U in reversed(scored[:2])}
        ranked = best_of_each([s for s, _ in scored[2:]], on)[: thresholds().pair_names]
        seen = [next(one for one in scored if one[0] is s) for s in ranked]
        now = _together(list(first.values()), on)
        pair, gain = max(
            ((both, _together(list(both), on)) for both in combinations(seen, 2)), key=lambda tried: tried[1],
            default=((), -np.inf),
        )  # fmt: skip
        if gain > now + least:
            best, least = [*others, *(s.effect for s, _ in pair)], gain - now
    if best is None:
        return None
    trial, on = fit_with(base, best), projected_scores(base)
    paid = [sum(penalty(e, len(e.coefficients), on) for e in effects) for effects in (own, best)]
    gained = at.noise.gained(at.cost, trial.cost, trial.degrees)
    return best if trial.converged and gained + paid[0] - paid[1] > thresholds().close else None


def _in_place_of_one(picked: Picked, base: Fit, candidates: Sequence[Effect], kept: Kept) -> Picked:
    """Return two other names instead of the only pick, which may represent their sum; else the pick.

    Joints that drift in opposite directions look like a member that grows. Two names absorb the error of an inexact
    formula more easily than one, so they must explain more than that error, each must explain something beside the
    other, and together they must predict left-out poses better than the pick does. A handful of readings leaves too few
    degrees of freedom for that test.
    """
    one, t = picked.sets[0][0], thresholds()
    few, many = base.degrees <= t.few_degrees, len(base.at.misclosure) >= t.many_readings
    if one.name in kept or not len(one.fit.r) or few or many:
        return picked
    on = projected_scores(base)
    scored = [(s, U) for s, U in score_all(base, on, still_open(candidates, {one.name})) if s.m]
    ranked = best_of_each([s for s, _ in scored], on)[: t.pair_names]
    seen = [next(score for score in scored if score[0] is s) for s in ranked]
    pair, gain = max(
        ((both, _together(both, on)) for both in combinations(seen, 2)), key=lambda score: score[1],
        default=((), -np.inf),
    )  # fmt: skip
    least = one.gain + t.further_gain + t.formula_error * energy_of(one)
    if gain <= least:
        return picked
    after = exchange([s.effect for s, _ in pair], (), base, candidates, kept, rounds=2)
    score = after.fit.converged and after.fit.degrees > t.few_degrees
    if len({own[0].name for own in after.sets} - {one.name}) < 2 or not score:
        return picked
    paid = sum(own[0].paid for own in after.sets)
    gained = base.noise.gained(base.cost, after.fit.cost, after.fit.degrees) - paid
    each = min(own[0].gain for own in after.sets)
    better = gained > least and each >= t.further_gain
    return after if better and _squared_errors(after.fit).sum() < _squared_errors(picked.fit).sum() else picked


def energy_of(o: Option) -> float:
    """Return the energy of an option's signature, in scores, before calibration absorbs a part of it."""
    k = len(o.effect.coefficients)
    trace = o.fit.J[:, -k:] @ o.fit.x[-k:] * o.fit.noise.gain
    return float(trace @ trace)


def _without(at: Fit, gone: Sequence[Effect]) -> ProjectedScores:
    """Return the scores of a fit without some of its effects, to first order."""
    names, place = {name_of(e) for e in gone}, len(at.model.formulation.parameters)
    out: list[int] = []
    for effect in at.model.effects:
        after = place + len(effect.coefficients)
        out += range(place, after) if name_of(effect) in names else []
        place = after
    return projected_scores(replace(at, r=at.r - at.J[:, out] @ at.x[out], J=np.delete(at.J, out, axis=1)))


def _together(pair: Sequence[tuple[Scored, Array]], on: ProjectedScores) -> float:
    """Return the linear gain of two candidates together, so that what both explain counts once."""
    (one, U), *rest = pair
    T, rank, paid = one.T, one.m, penalty(one.effect, one.m, on)
    for other, V in rest:
        z, cross = V.T @ on.y - V.T @ U @ (U.T @ on.y), V.T @ U
        own, vectors = np.linalg.eigh(np.eye(V.shape[1]) - cross @ cross.T)
        kept = own > _SAME
        T, rank = T + float(np.sum((vectors.T @ z)[kept] ** 2 / own[kept])), rank + int(kept.sum())
        paid += penalty(other.effect, other.m, on)
    return on.gain(T, rank) - paid


def predicts_better(current: Fit, found: Option) -> bool:
    """Return whether a further effect also predicts the fitted poses better when each is left out in turn.

    It is computed to first order, at the fit with the effect, from the squared errors of each pose without and with its
    columns.
    """
    k, at = len(found.effect.coefficients), found.fit
    if not len(at.r) or len(at.model.formulation.data) >= thresholds().many_readings:
        return True  # of very many readings those that are fitted tell it as well
    y, J = _about(at, k)
    fold = _folds(at)
    without, with_it = (_crossed(columns, current.noise.scores, y, fold) for columns in (J[:, :-k], J))
    return bool(np.sum(without) > np.sum(with_it))


def _squared_errors(at: Fit) -> Array:
    """Return the squared scores of the errors of a fit on its own poses when each is left out in turn, (N,)."""
    y, J = _about(at, 0)
    return _crossed(J, at.noise.scores, y, _folds(at))


def _about(at: Fit, k: int) -> tuple[Array, Array]:
    """Return the residuals of a fit without its last k columns, to first order, and the scaled columns."""
    size = np.sqrt((at.J**2).sum(axis=0))
    return at.r - at.J[:, len(at.x) - k :] @ at.x[len(at.x) - k :], at.J / np.where(size > 0, size, 1.0)


def _folds(at: Fit) -> Array:
    data = at.model.formulation.data
    return np.asarray(np.repeat(folds(data, thresholds().folds), len(at.r) // len(data)))


def _crossed(J: Array, scores: Callable[[Array], Array], y: Array, fold: Array) -> Array:
    """Return the squared scores of the errors of y, (N,), at poses left out in turn and predicted by the columns J."""
    whole, right, errors = J.T @ J, J.T @ y, np.empty(len(y))
    held = _HELD * np.eye(J.shape[1])
    for k in np.unique(fold):
        out = fold == k
        w = np.linalg.solve(whole - J[out].T @ J[out] + held, right - J[out].T @ y[out])
        errors[out] = y[out] - J[out] @ w
    return np.asarray(scores(errors) ** 2)
