"""Names that stand by themselves beside a rest that has no name, and sets as they are beside all that was found.

Where names explain too little, smooth functions are fitted instead. Each was chosen among all quantities and columns
for what it predicts of poses that were left out. If one of them is over a column that was met (a direction, a torque)
and its course is that of a formula of the catalogue, then this formula is what the data say there, whatever the rest
is. It stands if it also explains something beside all other smooth functions, under the noise that is left, and no
other name explains more. Over the way of a joint a course is no name: many causes are smooth functions of where a
joint stands.

Members of a set were fitted beside what was known then. Beside what was found later their sizes, weights and number are
others; and what is left is the noise by which they are told apart, where it is more than the stated one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.model.effect import Effect, has_free_period, is_possible, name_of, still_open
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import inputs_of
from calibench.discrepancy.noise.repeats import excess_p
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import family_of
from calibench.discrepancy.search import form as forming
from calibench.discrepancy.search.select import Option, energy_of, fit_with, options, run_tests, spared
from calibench.discrepancy.search.shuffle import controls
from calibench.discrepancy.search.smoother import Component, Smooth, fit_smooth
from calibench.discrepancy.thresholds import thresholds

Sets = tuple[tuple[Option, ...], ...]


def named_by_smooth(base: Fit, candidates: Sequence[Effect], terms: Sequence[Effect]) -> Sets:
    """Return the sets of the names whose courses the smooth functions of a model without names have."""
    t, current = thresholds(), base
    if len(base.r) >= t.drawn_rows:
        return ()
    found: dict[str, Effect] = {}
    while len(found) < t.effects_most:
        free = fit_smooth(current, tuple(terms))  # type: ignore[arg-type]
        parts = [one for e in free.model.effects if isinstance(e, Smooth) for one in e.components]
        more = [e for e in (_of_the_course(one, free, still_open(candidates, found)) for one in parts) if e is not None]
        more = list({name_of(e): e for e in more}.values())
        after = fit_with(current, more) if more else current
        if not more or not (after.converged and np.isfinite(after.cost)):
            break
        current, found = after, found | {name_of(e): e for e in more}
    while found:
        at = fit_with(base, list(found.values()))
        free = fit_smooth(at, tuple(terms))  # type: ignore[arg-type]
        noise = replace(free.noise, scale=free.noise.scale * left_scale(free))
        sets, falls = [], []
        for e in found.values():  # each beside all else that was fitted
            own, close = _beside_others(e, [*found.values()], free, noise, candidates)
            if own is None or own.gain < t.further_gain:
                falls.append(e)
                continue
            size = own.effect.amplitude(own.fit.x[len(own.fit.x) - len(e.coefficients) :])
            family = family_of(free.model.formulation.data.machine, e.family)
            if not is_possible(e, size) or (family is not None and family.never_negative and size < 0):
                falls.append(e)
            else:
                sets.append((own, *(o for o in close if o is not own)))
        if not falls:
            firsts = [[e] for e in found.values()]
            told = (
                control for one in (free, at) for control in controls(one, firsts, candidates, along=True)
            )  # beside the rest, and as told
            by_chance = {name for control in told for name, one in control.items() if one.p > t.shuffled_p}
            falls = [e for name, e in found.items() if name in by_chance]
        if not falls:
            return tuple(sets)
        for e in falls:
            del found[name_of(e)]
    return ()


def _of_the_course(part: Component, at: Fit, candidates: Sequence[Effect]) -> Effect | None:
    """Return the effect whose formula has the course of a smooth function, over a column that was met; else None."""
    formulation = at.model.formulation
    data = formulation.data
    if {*part.columns} & {*formulation.readings, *inputs_of(formulation)}:
        return None
    values = part.waves(data.columns)[0] @ part.weights
    values = values - values.mean()
    found: tuple[float, int, Effect | None] = (thresholds().course, 0, None)
    for effect in candidates:
        if effect.columns != part.columns or has_free_period(effect) or len(effect.coefficients) > forming.MOST:
            continue
        change = effect.basis(at.at.recorded, data, np.zeros(len(effect.coefficients)))
        if [*change] != [part.quantity]:
            continue
        B = np.asarray(change[part.quantity]) - np.mean(change[part.quantity], axis=0)
        left = values - B @ np.linalg.lstsq(B, values, rcond=None)[0]
        told = 1 - float(left @ left) / max(float(values @ values), 1e-300)
        found = max(found, (told, -len(effect.coefficients), effect), key=lambda one: one[:2])
    return found[2]


def _beside_others(
    effect: Effect, found: Sequence[Effect], at: Fit, noise: Noise, candidates: Sequence[Effect]
) -> tuple[Option | None, tuple[Option, ...]]:
    """Return an effect of a fit and what comes close to it, each fitted beside all other effects there, under `noise`.

    `found` are the names in the fit. The gains are told by the noise of the fit, the distances by `noise`.
    """
    name, place = name_of(effect), at.model.place_of(effect)
    others = tuple(e for e in at.model.effects if name_of(e) != name)
    without = fit(Model(at.model.formulation, others), noise, np.delete(at.x, place), about=at)
    if not (without.converged and np.isfinite(without.cost)):
        return None, ()
    open_to = [effect, *still_open(candidates, {name_of(e) for e in found})]
    tried = options(without, run_tests(without, open_to, (), None))
    own = next((o for o in tried if o.name == name), None)
    top = max(tried, key=lambda o: o.gain, default=None)
    if own is None or top is None:
        return None, ()
    close = []
    for o in forming.near(tried):
        behind = max(top.gain - o.gain - max(spared(o, top), thresholds().form * top.gain), 0.0)
        close.append(o if np.isfinite(o.behind) else replace(o, behind=behind))
    plain = at.noise.cost(without.r)
    stated = [
        replace(o, gain=at.noise.gained(plain, at.noise.cost(o.fit.r), o.fit.degrees) - o.paid) if len(o.fit.r) else o
        for o in close
    ]
    return next((o for o in stated if o.name == name), None), tuple(stated)


def left_scale(at: Fit) -> float:
    """Return in how many times the noise of a fit its residuals lie, where that is more than chance; else 1."""
    y = at.noise.scores(at.r)
    degrees = len(y) - at.J.shape[1]
    if at.noise.profiled or degrees < 1 or at.exact:
        return 1.0
    square = float(y @ y) / degrees
    sure = square > 1 and excess_p(square, degrees, at.noise.known, 0.0) < thresholds().p_calm
    return float(np.sqrt(square)) if sure else 1.0


def renewed(sets: Sets, at: Fit, candidates: Sequence[Effect]) -> Sets:
    """Return the sets beside all that was found, under the noise that is left, each with the same first name.

    A set that was made beside just these others stays as it is where no more than noise is left; so does that of a name
    with a form, which explains a part of what the name does. What may be no more than the error of a name's own formula
    is no ground to compare its rivals on: it has taken what tells them apart. No rival is a name that was found too.
    """
    noise, t = replace(at.noise, scale=at.noise.scale * left_scale(at)), thresholds()
    found = [own[0].effect for own in sets]
    forms = {name_of(e): name_of(e.of) for e in at.model.effects if isinstance(e, forming.Modulated)}
    bent = {*forms.values()}
    renewed_sets = []
    for own in sets:
        first = own[0]
        least = t.formula_error * energy_of(first) if len(first.fit.J) else 0.0
        slight = {o.name for o, *_ in sets if o.effect.target == first.effect.target and o.gain < least} - {first.name}
        ground, out = at, [e for e in at.model.effects if {name_of(e), forms.get(name_of(e))} & slight]
        if out:
            places = np.concatenate([np.arange(len(at.x))[at.model.place_of(e)] for e in out])
            others = tuple(e for e in at.model.effects if e not in out)
            ground = fit(Model(at.model.formulation, others), at.noise, np.delete(at.x, places))
        beside = {name_of(e) for e in ground.model.effects} - {first.name}
        stale = {name_of(e) for e in first.fit.model.effects} - {first.name} != beside
        if first.name in bent or len(at.r) >= t.drawn_rows or (not stale and noise.scale == at.noise.scale):
            renewed_sets.append(own)
            continue
        told, close = _beside_others(first.effect, found, ground, noise, candidates)
        if told is None:
            renewed_sets.append(own)
            continue
        # the gain of a name is that over the model in which it was found: beside names that share it, it is smaller
        more = first.gain - told.gain
        renewed_sets.append(tuple(replace(o, gain=o.gain + more) for o in (told, *(o for o in close if o is not told))))
    firsts = {own[0].name for own in sets}
    return tuple((own[0], *(o for o in own[1:] if o.name not in firsts)) for own in renewed_sets)
