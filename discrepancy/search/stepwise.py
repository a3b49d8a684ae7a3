"""The stepwise search: test, select, exchange, test again; then the verdict from what was selected and what is left.

A pick was chosen while later ones were missing, so it may represent two causes at once. So each pick is searched for
again while the others stay in the model, and then two at a time: all pairs are tried in the place of two picks.
A name that only imitates an unnamed cause explains a part of it, and smooth functions explain more. A named cause that
is there explains more than any smooth function of one covariate, because it shows in all readings at once; and it still
gains beside all smooth functions together.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import combinations
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics import score
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.model.effect import Alternative, Effect, name_of, still_open
from calibench.discrepancy.noise.laws import OF_NOISE, NoiseFinding
from calibench.discrepancy.noise.repeats import excess_p
from calibench.discrepancy.report import Amplitude, Finding, Rival, Shuffled, Verdict
from calibench.discrepancy.search import form as forming, guard, select
from calibench.discrepancy.search.finding import finding_of, with_cautions
from calibench.discrepancy.search.select import Option, Tests, energy_of, fit_with, options, penalty, run_tests
from calibench.discrepancy.search.shuffle import controls
from calibench.discrepancy.search.standing import Sets, named_by_smooth
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import errors_left_out, folds
from calibench.problems.base import Array

Kept = Mapping[str, tuple[Option, ...]]  # name -> its set
Controls = tuple[Fit, Mapping[str, Shuffled]]  # the fit whose names were shuffled, name -> its control

_MARGIN = 20.0  # delta BIC: where gains are small, a ratio of them says nothing
_NOTHING_LEFT = 2  # degrees of freedom: with fewer left nothing could check a name
_SAME = 1e-4  # squared length of a direction beside the other candidate: below this both have the direction in common
_HALF = 0.5  # of the shuffles
_ASKED = 20  # of the tests with the smallest p, whether they hold where noise differs from row to row


@final
@dataclass(frozen=True, eq=False)
class Picked:
    """The fit with all effects that were chosen and, for each, the options that come close."""

    fit: Fit
    sets: Sets

    @property
    def effects(self) -> list[Effect]:
        return [options[0].effect for options in self.sets]

    @property
    def by_name(self) -> dict[str, tuple[Option, ...]]:
        return {options[0].name: options for options in self.sets}


@final
@dataclass(frozen=True, eq=False)
class Selection:
    """The result of the search: the fit with all picks and their `forms`, the fit of the picks `alone`, and the sets.

    `first` and `last` are the tests of the model without effects and with all; `p` and `left` are those of "nothing is
    missing" and of "nothing is left".
    """

    fit: Fit
    alone: Fit
    sets: Sets
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
    alarm; what is left beside a name is asked with them. Where the size of a pick depends on a covariate, that form is
    part of the pick; then no pick is exchanged any more, because the form may explain a part of what it explains.
    """
    picked, ground, t = Picked(base, ()), base, thresholds()
    forms: tuple[Effect, ...] = ()
    kept: Kept = {}
    first: Tests | None = None
    first_p = 1.0
    while True:
        current, picks = picked.fit, picked.effects
        tests, p = _tested(current, picks, candidates, terms, rng, level, spared=first is None)
        if first is None:
            first, first_p = tests, p
        more = p < level and len(picks) < t.effects_most
        form = (
            forming.unlike(current, picks, forms, terms, tests, level) if p < 1.0 and len(forms) < len(picks) else None
        )
        # a smooth term that gains so much more ends the search for names, and for their forms
        form = None if form is not None and tests.smooth_gain > t.smooth_far * form.gain + _MARGIN else form
        if not more and form is None:
            break
        enough = t.further_gain if picks else 0.0
        # misfit alone gives no name, unless the degrees of freedom are so few that no other test can
        few = _NOTHING_LEFT < len(current.r) - current.J.shape[1] <= t.few_degrees
        significant = tests.p_names < level or (not picks and few)
        found = options(current, tests) if more and significant else ()

        if form is not None and not (found and found[0].gain > form.gain):
            with_form = fit_with(base, (*forms, form.effect))
            after = exchange(picks, (), with_form, candidates, picked.by_name)
            if not np.isfinite(after.fit.cost):
                break  # no fit with names and form converges: the names stay as they are
            forms, ground = (*forms, form.effect), with_form
            kept, picked = picked.by_name, after  # a form explains a part of what names explain
            continue

        short = bool(found) and 0 < found[0].gain <= enough and current.noise.profiled
        if not found or (found[0].gain <= enough and not short):
            break
        # a smooth function has the right phase at once, the sine or the cosine of a wave the wrong one
        of_any_phase = max([found[0].gain, *select.gains_of_any_phase(current, tests.on, found[:1]).values()])
        by_far = tests.smooth_gain > t.smooth_far * of_any_phase + _MARGIN
        if by_far and _stand(picked.sets, base, terms) is None:
            break
        if picks and not predicts_better(current, found[0]):
            break
        if _is_slight(found[0], picked):  # a pick that may be the error of a formula must not replace a name
            kept = {**kept, **picked.by_name}
        if len(picks) >= t.exchanged_at_once:
            close = forming.near(found)
            after = Picked(close[0].fit, (*picked.sets, close))
        else:
            after = exchange([*picks, found[0].effect], found, ground, candidates, kept)
        after = _with_another(after, ground, candidates, kept) if short else after
        if len(after.fit.r) - len(after.fit.x) < _NOTHING_LEFT or not np.isfinite(after.fit.cost):
            break
        if len(after.sets) > 1 and min(s[0].gain for s in after.sets) < t.further_gain:
            break  # after the exchange one of them explains nothing beside the others
        picked = after

    picked = _needed(_settled(picked, ground, candidates, kept, first), base, ground)
    return Selection(
        fit=picked.fit, alone=fit_with(base, picked.effects) if forms else picked.fit, sets=picked.sets, forms=forms,
        first=first, last=tests, p=first_p, alarm=first_p < level, left=p,
        smooth_explains=_smooth_explains(base, picked, forms, terms, first),
    )  # fmt: skip


def is_calm(
    base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm], rng: np.random.Generator, level: float
) -> bool:
    """Return whether a search at `level` would tell no alarm: its first test alone, whose draws `rng` keeps."""
    return _tested(base, (), candidates, terms, deepcopy(rng), level, spared=True)[1] >= level


def _tested(
    at: Fit, picks: Sequence[Effect], candidates: Sequence[Effect], terms: Sequence[SmoothTerm],
    rng: np.random.Generator, level: float, spared: bool,
) -> tuple[Tests, float]:  # fmt: skip
    """Return the tests of a fit with some picks, and the p of "nothing is left"; `spared` is that of no pick."""
    tests = run_tests(at, still_open(candidates, set(map(name_of, picks))), terms, rng, spared)
    if spared and tests.still < level:
        t = thresholds()
        names = _by_own_scatter(at, tests.on, tests.names, tests.p_names, t.share_names * level)
        smooth = _by_own_scatter(at, tests.on, tests.smooth, tests.p_smooth, t.share_smooth * level)
        tests = replace(tests, p_names=names, p_smooth=smooth)
    return tests, 1.0 if at.exact else min(tests.still, _lack_of_fit(tests, at) / thresholds().share_misfit)


def _by_own_scatter(
    at: Fit, on: score.ProjectedScores, scored: Sequence[score.Scored], p: float, most: float
) -> float:  # fmt: skip
    """Return the p of all tests of a kind; where one below `most` rests on equal noise in all rows, that without it."""
    if not thresholds().p_sure < p < most:
        return p
    ranked, found = sorted(scored, key=lambda s: s.p)[:_ASKED], 1.0
    for s in ranked:
        [(_, U)] = score.subspaces(on, score.columns(at, s.effect)[None])
        found = min(found, p * max(s.p, score.p_by_own_scatter(on, U)) / ranked[0].p)
        if found < most:
            return p
    return found


def exchange(
    picks: Sequence[Effect], found: Sequence[Option], base: Fit, candidates: Sequence[Effect],
    kept: Kept, rounds: int = 3,
) -> Picked:  # fmt: skip
    """Exchange each pick, with the others in the model, until none changes; and collect the set of each.

    `picks` are in the order of their choice, the last of them out of `found`; () where nothing was added. `kept` are
    the sets of those that are not exchanged: their forms are in `base`, and explain a part of what they explain.
    """
    chosen = list(picks)
    if len(chosen) == 1 and found:
        close = forming.near(found)
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
                without, taken = fit_with(base, others), {name_of(e) for e in others}
                tried[i] = others, options(without, run_tests(without, still_open(candidates, taken), (), None))
            if not tried[i][1]:
                continue
            own = forming.near(tried[i][1])
            best = own[0]
            many = len(base.r) >= thresholds().drawn_rows
            sets.append(tuple(select.light(o, base) for o in own) if many else own)
            changed = changed or best.name != name_of(chosen[i])
            chosen[i] = best.effect
        if not changed:
            break
    # the last to be looked at was fitted beside all others as they are now
    if best is not None and best.effect is chosen[-1] and len(best.fit.r) and best.fit.converged:
        return Picked(best.fit, tuple(sets))
    return Picked(fit_with(base, chosen), tuple(sets))


def _settled(picked: Picked, base: Fit, candidates: Sequence[Effect], kept: Kept, tests: Tests) -> Picked:
    """Return the picks after a last exchange, of pairs and then of single ones, without those that explain nothing."""
    if not picked.sets or len(base.r) >= thresholds().drawn_rows:
        return picked
    if len(picked.sets) == 1:
        return _in_place_of_one(picked, base, candidates, kept, tests)
    at, own = picked.fit, picked.effects
    gains = {s[0].name: s[0].gain for s in picked.sets}
    pairs = combinations([e for e in own if name_of(e) not in kept], 2)
    weakest = sorted(pairs, key=lambda two: sum(gains[name_of(e)] for e in two))[: thresholds().pairs_most]
    other, least = None, thresholds().close
    for two in weakest:  # in the place of each of these pairs, the pair that explains most
        others = [e for e in own if e not in two]
        gone = {name_of(e) for e in two}
        on = score.projected_scores(at, without=[e for e in at.model.effects if name_of(e) in gone])
        new = still_open(candidates, {name_of(e) for e in others})
        scored = [(s, U) for s, U in score.score_all(at, on, [*two, *new], bases=True) if s.m]
        first = {s.name: (s, U) for s, U in reversed(scored[:2])}
        now = float(_together(list(first.values()), on)[0, -1])
        pair, gain = _best_pair(scored[2:], on)
        if gain > now + least:
            other, least = [*others, *(s.effect for s, _ in pair)], gain - now
    if other is not None:
        trial, count = fit_with(base, other), len(base.r)
        paid = [sum(penalty(e, len(e.coefficients), count) for e in effects) for effects in (own, other)]
        gained = at.noise.gained(at.cost, trial.cost, trial.degrees)
        other = other if trial.converged and gained + paid[0] - paid[1] > thresholds().close else None
    if other is None and len(picked.sets) <= thresholds().exchanged_at_once:
        return picked
    effects = other or picked.effects
    while True:
        after = exchange(effects, (), base, candidates, kept, rounds=2)
        worst = min((s for s in after.sets if s[0].name not in kept), key=lambda s: s[0].gain, default=after.sets[0])
        if worst[0].gain >= thresholds().further_gain or len(after.sets) < 3:
            return after
        effects = [s[0].effect for s in after.sets if s is not worst]


def _in_place_of_one(picked: Picked, base: Fit, candidates: Sequence[Effect], kept: Kept, first: Tests) -> Picked:
    """Return two other names instead of the only pick, which may represent their sum; else the pick.

    `first` are the tests of the model without effects.

    Two names absorb the error of an inexact formula more easily than one, so they must explain more than that error,
    each something beside the other, and predict left-out poses better; of a handful of readings nothing tells that.
    """
    one, t = picked.sets[0][0], thresholds()
    if one.name in kept or not len(one.fit.r) or base.degrees <= t.few_degrees:
        return picked
    on, others = first.on, still_open(candidates, {one.name})
    known = {id(s.effect): s for s in first.names}
    late = [e for e in others if id(e) not in known]
    known |= {id(s.effect): s for s, _ in score.score_all(base, on, late)}
    best = select.best_of_each([known[id(e)] for e in others if known[id(e)].m], on)[: t.pair_names]
    pair, gain = _best_pair(score.score_all(base, on, [s.effect for s in best], bases=True), on)
    least = one.gain + t.further_gain + t.formula_error * energy_of(one)
    if gain <= least:
        return picked
    after = exchange([s.effect for s, _ in pair], (), base, candidates, kept, rounds=2)
    sound = after.fit.converged and after.fit.degrees > t.few_degrees
    if len({own[0].name for own in after.sets} - {one.name}) < 2 or not sound:
        return picked
    paid = sum(own[0].paid for own in after.sets)
    gained = base.noise.gained(base.cost, after.fit.cost, after.fit.degrees) - paid
    each = min(own[0].gain for own in after.sets)
    if gained <= least or each < t.further_gain:
        return picked
    new, old = (_squares_left_out(at, at.noise.scores) for at in (after.fit, picked.fit))
    return after if new < old else picked


def _best_pair(
    scored: Sequence[tuple[score.Scored, Array]], on: score.ProjectedScores
) -> tuple[tuple[tuple[score.Scored, Array], ...], float]:
    """Return the pair of the best single names that explains most together, and its linear gain."""
    ranked = select.best_of_each([s for s, _ in scored], on)[: thresholds().pair_names]
    if len(ranked) < 2:
        return (), -np.inf
    seen = [next(one for one in scored if one[0] is s) for s in ranked]
    first, second = np.triu_indices(len(seen), 1)
    gains = _together(seen, on)[first, second]
    k = int(np.argmax(gains))
    return (seen[first[k]], seen[second[k]]), float(gains[k])


def _together(seen: Sequence[tuple[score.Scored, Array]], on: score.ProjectedScores) -> Array:
    """Return the linear gain of each two of K candidates, (K, K), so that what both explain counts once."""
    T, rank = np.array([s.T for s, _ in seen]), np.array([s.m for s, _ in seen])
    wide = np.zeros((len(on.y), len(seen), max(rank)))  # bases of fewer columns have zeros beside them
    for k, (s, U) in enumerate(seen):
        wide[:, k, : s.m] = U
    flat = wide.reshape(len(wide), -1)
    crosses = (flat.T @ flat).reshape(len(seen), -1, len(seen), wide.shape[2]).transpose(0, 2, 3, 1)
    along = (on.y @ flat).reshape(len(seen), -1)
    own, vectors = np.linalg.eigh(np.eye(wide.shape[2]) - crosses @ crosses.transpose(0, 1, 3, 2))
    z = along[None, :, None] - (crosses @ along[:, None, :, None]).swapaxes(2, 3)
    kept = own > _SAME
    more = np.where(kept, (z @ vectors)[:, :, 0] ** 2 / np.where(kept, own, 1.0), 0.0).sum(axis=2)
    ranks = rank[:, None] + kept.sum(axis=2) - (wide.shape[2] - rank)
    paid = np.array([penalty(s.effect, s.m, len(on.y)) for s, _ in seen])
    apart = 1 - np.eye(len(seen))
    gains = on.gains(T[:, None] + apart * more, np.where(apart, ranks, rank))
    return np.asarray(gains - paid[:, None] - apart * paid)


def predicts_better(current: Fit, found: Option) -> bool:
    """Return whether a further effect also predicts the fitted poses better when each is left out in turn."""
    at, k, scores = found.fit, len(found.effect.coefficients), current.noise.scores
    if not len(at.r):
        return True
    return bool(_squares_left_out(at, scores, k, without=True) > _squares_left_out(at, scores, k))


def _squares_left_out(at: Fit, scores: Callable[[Array], Array], own: int = 0, without: bool = False) -> float:
    """Return the sum of the squared scores of a fit's errors on its poses, each left out in turn, to first order."""
    data, fitted = at.model.formulation.data, len(at.x) - own
    y, J = at.r - at.J[:, fitted:] @ at.x[fitted:], at.J[:, :-own] if without else at.J
    fold = np.repeat(folds(data, thresholds().folds), len(at.r) // len(data))
    return float(np.sum(scores(errors_left_out(J, y, fold)) ** 2))


def _smooth_explains(
    base: Fit, picked: Picked, forms: Sequence[Effect], terms: Sequence[SmoothTerm], first: Tests
) -> bool:
    """Return whether smooth terms, as many as there are names and forms, explain clearly more than these, by BIC."""
    sets = picked.sets
    paid = sum(penalty(found[0].effect, found[0].rank, len(first.on.y)) for found in sets)
    paid += sum(penalty(form, len(form.coefficients), len(first.on.y)) for form in forms)
    smooth, several = first.smooth_gain, len(sets) + len(forms)
    if several > 1:  # several names against several smooth terms
        free = _with_smooth_terms(base, terms, several)
        smooth = base.noise.gained(base.cost, free.cost, free.degrees)
        smooth -= float(np.log(len(base.r))) * (len(free.x) - len(base.x))
    named = base.noise.gained(base.cost, picked.fit.cost, picked.fit.degrees) - paid
    if smooth > named + thresholds().smooth_clearly:  # a curve may win only because a formula is not exact
        named += sum(forming.bonus(found[0]) for found in sets)
    return smooth > named + thresholds().smooth_clearly


def _is_slight(found: Option, picked: Picked) -> bool:
    """Return whether a further effect is so small that it may be the error of the formulas of those before it."""
    count, before = found.fit.at.misclosure.size, 0.0
    for o in (own[0] for own in picked.sets):
        energy = o.fit.noise.size_of(o.gain, count) ** 2
        alike = found.fit.noise.profiled and o.effect.target == found.effect.target
        before += max(energy, energy_of(o) / count) if alike else energy
    return found.fit.noise.size_of(found.gain, count) ** 2 < thresholds().formula_error * before


def _with_another(picked: Picked, ground: Fit, candidates: Sequence[Effect], kept: Kept) -> Picked:
    """Return the picks with one more, as where the noise is not known each of two missing effects hides the other."""
    taken = {name_of(e) for e in picked.effects}
    if len(taken) >= thresholds().effects_most:
        return picked
    found = options(picked.fit, run_tests(picked.fit, still_open(candidates, taken), (), None))
    if not found or found[0].gain <= thresholds().further_gain or not predicts_better(picked.fit, found[0]):
        return picked
    return exchange([*picked.effects, found[0].effect], found, ground, candidates, kept)


def _needed(picked: Picked, base: Fit, ground: Fit) -> Picked:
    """Return the picks without those that explain nothing beside the others, with the forms of `ground` and without."""
    while ground is not base and len(picked.sets) > 1:
        alone = fit_with(base, picked.effects)
        worths = {}  # the gain of each, to first order
        for effect in picked.effects:
            gains = []
            for at in (picked.fit, alone):
                own = at.model.place_of(effect)
                c = at.x[own]
                explained = float(c @ np.linalg.pinv(at.covariance(stated=True)[own, own], hermitian=True) @ c)
                gained = at.noise.gained(at.cost + explained, at.cost, at.degrees)
                gains.append(gained - len(c) * float(np.log(len(at.r))))
            worths[name_of(effect)] = max(gains)
        least = min(worths, key=lambda name: worths[name])
        if worths[least] >= 0:
            break
        sets = tuple(options for options in picked.sets if options[0].name != least)
        picked = Picked(fit_with(ground, [options[0].effect for options in sets]), sets)
    return picked


def judge(
    selection: Selection, base: Fit, terms: Sequence[SmoothTerm], suspects: Sequence[NoiseFinding], level: float,
    candidates: Sequence[Effect] = (), free: Sequence[SmoothTerm] = (), *, doubts: bool = True,
) -> tuple[Verdict, tuple[Finding, ...], Selection]:  # fmt: skip
    """Return the verdict, the findings and their selection: where names explain too little, the names that still stand.

    A name that still explains something beside smooth functions is right, but not the whole: the verdict is partly.
    So is a name of the `candidates` whose course one of the smooth functions has, which are made of terms `free`.
    `suspects` are findings about the noise. Without `doubts` nothing is asked that makes a verdict partly.
    """
    blamed = []
    for s in suspects:
        name, weight, apart = f"{s.family} {s.target}", 1.0, None
        rivals: tuple[Rival, ...] = ()
        if s.rival:
            family, target, other = s.rival
            weight, rivals = 1 - other, (Rival(f"{family} {target}", family, target, other),)
            apart = f"more repeats: they tell which {s.alike} reads far off"
        noise = Finding(
            effect=name, family=s.family, target=s.target, amplitude=Amplitude(s.amplitude, s.unit, s.ci95),
            gain=s.gain, set=(Rival(name, s.family, s.target, weight), *rivals), separated_by=apart,
            visible=float(np.sqrt(max(s.gain, 0.0) / len(s.weights))),
        )  # fmt: skip
        blamed.append(noise)
    verdict, findings = _verdict_of(selection, base, blamed, level)
    if doubts and verdict in ("named", "ambiguous", "partly"):
        findings, foreign = guard.with_doubts(findings, selection.fit, terms, selection.sets)
        verdict = "partly" if foreign else verdict
    if verdict != "unknown":
        return verdict, findings, selection
    part = _stand(selection.sets, base, terms)
    if part is None and (clear := named_by_smooth(base, candidates, free) if candidates else ()):
        part = Picked(fit_with(base, [own[0].effect for own in clear]), clear)
    if part is None:
        return verdict, findings, selection
    kept = replace(selection, fit=part.fit, alone=part.fit, sets=part.sets, forms=())
    whole = {own[0].name: energy_of(own[0]) / len(part.fit.r) for own in part.sets}
    named = with_cautions([finding_of(part.fit, own) for own in part.sets], whole)
    return "partly", tuple(sorted((*named, *blamed), key=lambda f: -f.gain)), kept


def held_by_order(
    selection: Selection, base: Fit, candidates: Sequence[Effect], terms: Sequence[SmoothTerm]
) -> tuple[Selection, Controls]:
    """Return the selection without names that shuffled rows have as well, and the control of those that stay.

    The worst goes first, as one of two names may only be there because of the other. A rival claims nothing, and few
    rows may not show its order: it goes only where half of the shuffles have as much.
    """
    while True:
        told = controls(selection.fit, [[o.effect for o in own] for own in selection.sets], candidates)
        beyond = {
            name: one.p for own, some in zip(selection.sets, told) for name, one in some.items()
            if one.p > (thresholds().shuffled_p if name == own[0].name else _HALF)
        }  # fmt: skip
        if not beyond:
            return selection, (selection.fit, {name: one for some in told for name, one in some.items()})
        out = {name for name, p in beyond.items() if p == max(beyond.values())}
        names, kept = {own[0].name for own in selection.sets} - out, []
        for own in selection.sets:  # a rival that takes the place of a name must not be a name of another set
            taken = out if own[0].name in names else out | names
            if left := tuple(o for o in own if o.name not in taken):
                kept.append(left)
                names.add(left[0].name)
        sets = tuple(kept)
        forms = tuple(f for f in selection.forms if isinstance(f, forming.Modulated) and name_of(f.of) in names)
        effects = [own[0].effect for own in sets]
        picked = Picked(fit_with(fit_with(base, forms), effects), sets)
        last = run_tests(picked.fit, still_open(candidates, names), terms, None)
        selection = replace(
            selection, fit=picked.fit, alone=fit_with(base, effects) if forms else picked.fit, sets=sets, forms=forms,
            last=last, left=min(last.still, _lack_of_fit(last, picked.fit) / thresholds().share_misfit),
            smooth_explains=_smooth_explains(base, picked, forms, terms, selection.first),
        )  # fmt: skip


def with_orders(
    findings: Sequence[Finding], selection: Selection, candidates: Sequence[Effect], controlled: Controls
) -> tuple[Finding, ...]:
    """Return the findings with their controls by shuffled rows: those that are known, or else of another fit."""
    (at, known), picked = controlled, {own[0].name for own in selection.sets}
    if findings and selection.fit is not at and not picked <= {*known}:
        told = controls(selection.fit, [[own[0].effect] for own in selection.sets], candidates)
        known = {**{name: one for some in told for name, one in some.items()}, **known}
    return tuple(replace(f, shuffled=known.get(f.effect)) for f in findings)


def _verdict_of(
    selection: Selection, base: Fit, blamed: Sequence[Finding], level: float
) -> tuple[Verdict, tuple[Finding, ...]]:
    t, at, sets, first = thresholds(), selection.fit, selection.sets, selection.first
    # without a smooth term that gains anything, and without a clear misfit, an alarm does not count
    counts = selection.alarm and (sets or first.smooth_gain > 0 or _lack_of_fit(first, base) < t.p_plain)
    if not counts:
        return _verdict_by(blamed), tuple(blamed)
    explained = _explained(base, at) + _doubt(base, at)
    enough = t.explained if selection.left > t.p_plain else t.explained_plain
    short, smooth = selection.left < level and explained < enough, selection.smooth_explains
    little = short and explained < t.explained
    # the excess that names would leave if their formulas were off by as much as formulas may be, of the whole effects:
    # calibration may absorb nearly all of an effect, and nothing of the error of its form
    of_forms = t.formula_error * sum(max(energy_of(option) for option in own) for own in sets) / at.degrees
    bent = explained >= t.explained_part and _excess(at) < of_forms
    if not sets:
        return "unknown", ()
    # names that explain the excess only with forms that differ from formulas by more than usual are none
    forms = [form for form in selection.forms if isinstance(form, forming.Modulated)]
    large = [form for form in forms if forming.share(at, form) >= t.form_share]
    if large:
        along = all(form.acts_along for form in large)
        by, r = (at, forming.residuals_within(at, forms, t.form_share)) if along else (selection.alone, None)
        if _explained(base, by, r) + _doubt(base, by, r) < t.explained_part:
            return "unknown", ()
    if little and smooth:
        return "unknown", ()
    # where nothing tells the noise, and no test shows anything that is left, the rest may be noise of heavy tails
    quiet = at.noise.profiled and selection.last.still >= level
    plainly = smooth or (little and not quiet)
    # an unnamed cause is nearer to some smooth function than to a wrong name
    named_far = max(own[0].gain for own in sets) > t.smooth_far * first.smooth_gain + _MARGIN
    by_far = first.smooth_gain > 0 and named_far and explained > t.explained_by_far
    if plainly and not bent and not by_far:
        return "unknown", ()
    found = []
    for own in sets:
        # sine and cosine of one wave are one curve: the form of one is that of both
        wave: Effect | None = getattr(own[0].effect, "whole", None)
        alike = [o.effect for o, *_ in sets if wave is not None and o.effect.family in wave.coefficients]
        told = (forming.form_words(e, selection.forms, at.model.formulation) for e in (own[0].effect, *alike))
        found.append(replace(finding_of(at, own), form=next(filter(None, told), "")))
    named = with_cautions(found, {own[0].name: energy_of(own[0]) / len(at.r) for own in sets})
    if plainly:
        named = (replace(named[0], form=named[0].form or forming.FORM_DIFFERS), *named[1:])
    findings = tuple(sorted((*named, *blamed), key=lambda f: -f.gain))
    if short or smooth:
        return "partly", findings
    if np.sqrt(sum(f.visible**2 for f in findings)) < t.matters:
        return "negligible", findings
    return _verdict_by(findings), findings


def _verdict_by(findings: Sequence[Finding]) -> Verdict:
    if not findings:
        return "none"
    if all(f.family in OF_NOISE for f in findings):
        return "noise"  # nothing is corrected: readings are trusted less
    sure = [f for f in findings if not f.caution]  # a finding that may be the error of a formula is no second claim
    return "ambiguous" if any(len(f.set) > 1 for f in sure) else "named"


def _lack_of_fit(tests: Tests, at: Fit) -> float:
    """Return the probability under the noise alone of a misfit as large as that of a fit."""
    on = tests.on
    return excess_p(on.total / on.degrees, on.degrees, at.noise.known, on.excess_kurtosis)


def _explained(base: Fit, at: Fit, r: Array | None = None) -> float:
    """Return the part of the excess over the noise that a fit explains; with other residuals `r` than its own."""
    before = _excess(base)
    return 1 - max(_excess(at, r), 0.0) / before if before > 0 else 1.0


def _doubt(base: Fit, at: Fit, r: Array | None = None) -> float:
    """Return by how much the explained part may be underestimated, because degrees of freedom are few."""
    before, left = _excess(base), len(base.r) - base.J.shape[1]
    if not _NOTHING_LEFT < left <= thresholds().few_degrees or before <= 0:  # few say little about the noise
        return 0.0
    degrees = len(at.r) - at.J.shape[1]
    rest = max(_excess(at, r), 0.0) * degrees
    return float(2 * np.sqrt(2 * (degrees + 2 * rest)) / degrees / before)


def _excess(at: Fit, r: Array | None = None) -> float:
    y = at.noise.scores(at.r if r is None else r)
    return float(y @ y) / int(len(y) - at.J.shape[1]) - 1.0


def with_alternatives(sets: Sets, base: Fit, beside: Sequence[Alternative]) -> Sets:
    """Return the sets of all picks, each with those of `beside` that gain nearly as much as its first name, or more."""
    if not beside:
        return sets
    limits = {b.effect: b.largest for b in beside}
    found = []
    for one in sets:
        without, first = fit_with(base, [s[0].effect for s in sets if s is not one]), one[0].gain
        on = score.projected_scores(without)
        scored = [s for s, _ in score.score_all(without, on, list(limits)) if s.m]
        hopeful = [s for s in scored if select.delta_bic(s, on) > first - thresholds().refit_within]
        fitted = [select.option(without, s, on) for s in hopeful]
        close = [o for o in fitted if o.gain > first - thresholds().close and o.amplitude <= limits[o.effect]]
        found.append((*one, *close))
    return tuple(found)


def _with_smooth_terms(base: Fit, terms: Sequence[SmoothTerm], most: int) -> Fit:
    """Return the fit with the smooth terms that gain, at most as many as names, with which they are compared."""
    current = base
    for _ in range(max(most, thresholds().smooth_beside)):
        tests = run_tests(current, (), terms, None)
        if not tests.smooth_gain > 0:
            break
        best = tests.smooth[0].effect
        if not isinstance(best, SmoothTerm) or len(best.quantities) > 1:
            break
        [(seen, _)] = score.subspaces(tests.on, score.columns(current, best)[None], thresholds().smooth_visible)
        [(scored, _)] = score.score_all(current, tests.on, [replace(best, mix=seen.back)])
        trial = select.option(current, scored, tests.on)
        if not (trial.gain > 0 and trial.fit.converged):
            break
        current = trial.fit
    return current


def _stand(sets: Sets, base: Fit, terms: Sequence[SmoothTerm]) -> Picked | None:
    """Return the names that stand beside smooth functions; None where these do not explain most of the misfit."""
    if len(base.r) >= thresholds().drawn_rows:
        return None

    def beside(at: Fit, one: Option, on: score.ProjectedScores) -> tuple[Fit, float]:
        found = fit_with(at, [one.effect])
        if not (found.converged and np.isfinite(found.cost)):
            return found, -np.inf
        return found, at.noise.gained(at.cost, found.cost, found.degrees) - penalty(one.effect, one.rank, len(on.y))

    held: list[tuple[Option, ...]] = []
    at, free = base, None
    for own in sorted(sets, key=lambda own: -own[0].gain):
        tests = run_tests(at, (), terms, None)
        more, gain = beside(at, own[0], tests.on)
        if gain <= tests.smooth_gain:
            continue
        free = free or _with_smooth_terms(base, terms, len(sets))
        if beside(free, own[0], tests.on)[1] >= thresholds().further_gain:
            held.append(own)
            at = more
    if not held:
        return None
    part = Picked(fit_with(base, [own[0].effect for own in held]), tuple(held))
    return part if _explained(base, part.fit) >= thresholds().explained else None
