"""The gain of a name if its formula is not exact: real causes differ from a catalogue's formulas by a tenth or so.

A real cause has the signature of the formula times 1 + m(x). x is the argument of the formula (the joint's angle, the
torque, the time) or the position of its carriage; m is smooth, of rms .1 or less. Calibration may absorb 99 % of a
gear's wrong ratio, and nothing of the term with m. Then most of what is seen is the error of the form. A rival, or a
smooth curve of x, may fit that and explain more than the true name. So a name gets a second gain, from its marginal
likelihood with a random m: it counts what m explains, less a penalty for its freedom. Rivals are compared with the best
name by that gain, because the formula of the best one may be off as well, and its exact fit may be luck. A smooth curve
is preferred only where it has more than that gain, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from calibench.discrepancy.diagnostics.score import columns, signatures
from calibench.discrepancy.fitting.fit import orthonormal, project_off
from calibench.discrepancy.model.effect import Effect, along_of, is_possible, name_of, over_of, whole_of
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.search.form import ALONG, MOST, SLOW, Modulated, Slow, product, slow_along, waves_over
from calibench.discrepancy.search.select import Option, close, spared, told_apart
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

# sizes tried, times the fitted one: an error of the form may have moved the fitted size far off
_SIZES = (0.03, 0.1, 0.3, 1.0, 3.0)
_STEPS = 100
_NEAR = 0.01  # tolerance of a maximum, in twice the log-likelihood
_LENGTHS = (0.4, 0.8)  # part of an argument's range over which a random form keeps its size
_OFF = (0.3, 0.6, 1.0)  # parts of `form_off`: the sizes of a random form
_KNOTS = 48  # of a random curve
_PART = 1e-6  # part of the largest variance: parts of a random curve below this are left out
_LEVELS = 4  # of a column that has no slow function
_FULL = 1e-10
_PLACES = 200  # knots of a random field, at most twice as many
_PART_OF_FIELD = 1e-3  # part of the largest variance: parts of a random field below this are left out
_SETTLED = 6  # rounds in which the noise of a random form settles
_TINY = 1e-300


def near(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return the best option and those close to it where formulas may be off, each with its distance to the best.

    The order is kept, but the likeliest comes first where the first one is not close to it.

    An option on the same part as the best one has two likelihoods: of its exact formula, and of its formula being off.
    They are added; before the data the second is `form_odds` times as likely. So of two formulas that may both be off,
    neither wins by an exact fit alone. An option without a form, or on another part, is compared by its gain. Where
    effects give the positions at which they act, options of all parts are compared with each other, because legs that
    meet share the effect of one of them; one that is near by its gain stays. There both likelihoods have the same
    weight, because a form is visible for some options and not for others, and readings are few.
    """
    plain, top = close(found), max(found, key=lambda o: o.gain)
    if not (top.gain > 0 and 0 < len(top.fit.r) < thresholds().drawn_rows):
        return plain
    if top.fit.noise.profiled:
        return _as_a_form_may_err(found, plain, top)
    own = _on_its_part(found, top)
    rivals = [o for o in found if o.name in own or _go_along(o, top)]
    if len(rivals) < 2:
        return plain
    worth = {o.name: one for o in rivals if (one := _worth(o, top)) is not None}
    best = max(worth.values()) - thresholds().form * top.gain
    # it stands for the form of another one, by a formula of many numbers
    taken_up = thresholds().formula_error * top.gain
    likelihoods = {
        o.name: replace(o, behind=best - worth[o.name] + taken_up * (_is_rich(o) - _is_rich(top)))
        for o in rivals
        if o.name in worth
    }
    kept = {o.name for o in likelihoods.values() if o.behind < thresholds().close}
    kept |= {top.name, *(o.name for o in plain if o.name not in likelihoods or o.name not in own)}
    return _likeliest_first([likelihoods.get(o.name, o) for o in found if o.name in kept])


def _as_a_form_may_err(found: Sequence[Option], plain: Sequence[Option], top: Option) -> tuple[Option, ...]:
    """Return the best option and its rivals, where nothing tells the noise.

    A random form would be measured by a noise that holds the error of the best form itself. So a rival on the same part
    stays where the best one explains no more than it does but for an error of form: up to `formula_error` of all. Its
    distance is what it leaves, in squares of `form_off`.
    """
    own, count = _on_its_part(found, top), top.fit.degrees
    kept = []
    for o in found:
        lost = float(np.expm1((top.gain - o.gain) / count) / np.expm1(top.gain / count))
        errs = o is not top and o.name in own and not _is_rich(o) and 0 <= lost < thresholds().formula_error
        if errs:
            behind = min(told_apart(top, top.gain - o.gain), lost / thresholds().form_off ** 2)
            kept.append(replace(o, behind=behind))
        elif o in plain:
            kept.append(o)
    return _as_forms_over_the_place_tell(found, kept, top)


def _as_forms_over_the_place_tell(found: Sequence[Option], kept: Sequence[Option], top: Option) -> tuple[Option, ...]:
    """Return the options that are near where effects are functions of a place; elsewhere those that are `kept` already.

    There are two laws of the error of a form: it is anything of rms `form_off`, as in `kept`, or a smooth random
    function of the place, which is `form_smooth` likely before the data. A place has more than one number, so such a
    function tells far more than one of a single argument. It is large where calibration takes up most of an effect,
    and the noise is the likeliest for each option. An effect that explains nothing has no form, nor has the twin
    of another pick. A distance is that of the weights under both laws.
    """
    own = _on_its_part(found, top)
    beside = {name_of(e) for e in top.fit.model.effects if e is not top.effect}
    placed = [o for o in found if o.name in own and over_of(o.effect) and o.gain > 0 and not beside & {*o.effect.twins}]
    if len(placed) < 2 or top not in placed:
        return tuple(kept)
    likelihoods = _likelihoods(placed, top)
    smooth = _shares({name: max(likelihoods.values()) - one for name, one in likelihoods.items()})
    free = _shares({o.name: _distance(o, top) for o in kept if o.name in likelihoods})
    part = thresholds().form_smooth
    both = {name: part * one + (1 - part) * free.get(name, 0.0) for name, one in smooth.items()}
    behind = {name: 2 * float(np.log(max(both.values()) / max(one, _TINY))) for name, one in both.items()}
    left = [replace(o, behind=behind[o.name]) if o.name in behind else o for o in found]
    names = {name for name, one in behind.items() if one < thresholds().close}
    names |= {top.name, *(o.name for o in kept if o.name not in behind)}
    return _likeliest_first([o for o in left if o.name in names])


def _shares(behind: Mapping[str, float]) -> dict[str, float]:
    weights = {name: float(np.exp(-far / 2)) for name, far in behind.items()}
    return {name: one / sum(weights.values()) for name, one in weights.items()}


def _distance(o: Option, top: Option) -> float:
    far = o.behind if np.isfinite(o.behind) else told_apart(top, top.gain - o.gain - spared(o, top))
    return max(0.0, far)


def _place(o: Option) -> Array:
    data = o.fit.model.formulation.data
    return np.stack([np.asarray(data[name], dtype=float) for name in over_of(o.effect)], axis=-1)


def _likelihoods(placed: Sequence[Option], top: Option) -> dict[str, float]:
    """Return twice the log-likelihood of each option, its form off or not, less its penalty.

    A wave of any phase pays for its phase. It is one cause, so of its sine and its cosine only the one that explains
    more is as likely as the wave.
    """
    fields = [random_field(_place(top), length) for length in _LENGTHS]
    likelihoods = {o.name: _likelihood(o, o.effect, top, fields) - o.paid for o in placed}
    waves: dict[tuple[str, ...], tuple[Option, Effect]] = {}
    for o in sorted(placed, key=lambda one: one.gain):  # the one that explains more comes last
        if (whole := whole_of(o.effect)) is not None:
            waves[tuple(sorted(whole.coefficients))] = o, whole
    for o, whole in waves.values():
        paid = o.paid + float(np.log(len(o.fit.r)))
        likelihoods[o.name] = max(likelihoods[o.name], _likelihood(o, whole, top, fields) - paid)
    return likelihoods


def _likelihood(o: Option, effect: Effect, top: Option, fields: Sequence[Array]) -> float:
    """Return twice the log-likelihood of an effect in the place of an option's, its form off or not.

    A form that is off is one of `fields`, (n, m) each, all equally likely. The noise is the likeliest.
    """
    at, k = o.fit, len(effect.coefficients)
    J, own = np.split(at.J, [len(at.x) - len(o.effect.coefficients)], axis=1)
    size = np.linalg.norm(J, axis=0)
    Q = orthonormal(J / np.where(size > 0, size, 1.0), _FULL)
    root = np.sqrt(at.noise.weights(top.fit.r))[:, None]
    without = own @ at.x[J.shape[1] :] - at.r  # what the effect has to explain
    y = project_off(without * root[:, 0], Q, times=2)
    count = max(len(y) - Q.shape[1], 1)
    D = project_off(columns(at, effect) * root, Q, times=2)
    c = np.asarray(np.linalg.lstsq(D, y, rcond=None)[0], dtype=float)
    left = max(float(np.sum((y - D @ c) ** 2)), _TINY)
    changes = effect.basis(at.at.recorded, at.model.formulation.data, np.zeros(k))
    likely = []
    for field in fields:
        T = signatures(at, {name: product(field, change) for name, change in changes.items()})
        T = project_off(T * root, Q, times=2).reshape(len(y), -1, k) * thresholds().form_off
        likely.append(-_least(y, D, np.asarray(T), effect, c, _OFF, count) / 2)
    exact = -count * (float(np.log(left / count)) + 1)
    drawn = 2 * (np.logaddexp.reduce(likely) - np.log(len(likely)))
    return float(2 * np.logaddexp(exact / 2, (drawn + thresholds().form_odds) / 2))


def _on_its_part(found: Sequence[Option], top: Option) -> set[str]:
    part_of = description_of(top.fit.model.formulation.data.machine).part_of
    return {o.name for o in found if part_of(o.effect.target) == part_of(top.effect.target)}


def _likeliest_first(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return options; where the first one is too far behind, the one that is least behind comes first."""
    first, likeliest = found[0], min(found, key=lambda o: o.behind)
    if not thresholds().close <= first.behind < np.inf:
        return tuple(found)
    return (likeliest, *(o for o in found if o is not likeliest))


def _go_along(o: Option, top: Option) -> bool:
    return None not in (along_of(o.effect), along_of(top.effect))


def _worth(o: Option, top: Option) -> float | None:
    """Return twice the log-likelihood of an option, its form off or not, over that of no effect; None without a form.

    A random form is weighted as the readings in the fit `top`. With heavy tails an option's own weights would forgive a
    poor fit the readings that it misses by far. A formula of many numbers can follow any course over its argument: it
    explains the same, off or not.
    """
    drawn = o.gain
    if (worth := _drawn(o, _random_forms(o), _OFF, top)) is not None:
        drawn = top.gain + top.paid - o.paid + float(np.sum(top.fit.noise.weights(top.fit.r) * top.fit.r**2)) - worth[1]
    elif o is not top and not _is_rich(o):
        return None
    odds = 0.0 if along_of(top.effect) is not None else thresholds().form_odds
    return float(2 * np.logaddexp(o.gain / 2, (drawn + odds) / 2))


def _is_rich(o: Option) -> bool:
    return len(o.effect.coefficients) > MOST


def bonus(o: Option) -> float:
    """Return how much more an option explains if its formula may be off; 0 where it explains no more.

    It is compared with smooth curves, so its form may vary as fast as they do.
    """
    gains = [
        _drawn(o, [[form] for form in _slow_forms(o, terms)], (1.0,), o)
        for terms in (SLOW, thresholds().curve_terms - 1)
    ]
    return max([0.0, *(before - after for before, after in filter(None, gains))])


def _drawn(
    o: Option, forms: Sequence[Sequence[Array]], off: Sequence[float], top: Option
) -> tuple[float, float] | None:
    """Return minus twice the log-likelihood of an option: of its exact formula, and with a random form.

    `forms` are the signatures that a form is made of, (N, m k) each, of rms one: those of each argument are equally
    likely; the best argument counts. A form is off by one of the parts `off` of `form_off`, all equally likely. The
    weights are those of the residuals of `top`; None where the option has no such form.
    """
    at, k = o.fit, len(o.effect.coefficients)
    c = at.x[len(at.x) - k :]
    if k > MOST or at.noise.profiled or not len(at.r) or not np.linalg.norm(c) > 0 or not forms:
        return None
    root = np.sqrt(at.noise.weights(top.fit.r))
    J = at.J * root[:, None]
    size = np.linalg.norm(J, axis=0)
    Q = orthonormal(J[:, :-k] / np.where(size > 0, size, 1.0)[:-k], _FULL)
    D = project_off(J[:, -k:], Q, times=2)
    y = project_off(at.r * root, Q, times=2) + D @ c

    def least(form: Array) -> float:
        T = project_off(form * root[:, None], Q, times=2).reshape(len(y), -1, k)
        return _least(y, D, np.asarray(T * thresholds().form_off), o.effect, c, off)

    likely = [np.logaddexp.reduce([-least(form) / 2 for form in alike]) - np.log(len(alike)) for alike in forms]
    return float(np.sum((y - D @ c) ** 2)), float(-2 * max(likely))


def _random_forms(o: Option) -> list[list[Array]]:
    """Return for each argument of an option's formula its signatures times the parts of random curves of it.

    Where the option gives the positions of its carriages, return its signatures times slow functions of these, all
    together.
    """
    if slow_along(o.effect, o.fit.model.formulation.data, ALONG):
        return [_slow_forms(o, ALONG)]
    at = o.fit.at
    own = o.effect.basis(at.recorded, at.model.formulation.data, np.zeros(len(o.effect.coefficients)))
    return [
        [signatures(o.fit, {name: product(parts, change) for name, change in own.items()})
         for parts in (random_curve(values, length) for length in _LENGTHS)]
        for _, values in _arguments(o, at.model.formulation.data)
    ]  # fmt: skip


def _slow_forms(o: Option, terms: int) -> list[Array]:
    """Return for each argument of an option's formula its signatures times so many slow functions of it.

    Where the option gives the positions of its carriages, return those times slow functions of these, all together.
    """
    data, k = o.fit.model.formulation.data, len(o.effect.coefficients)
    if along := slow_along(o.effect, data, ALONG):
        found = [Modulated(o.effect, along)]
    else:
        found = []
        for column, values in _arguments(o, data):
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            middle = np.nanmean(waves_over(values, low, high, terms), axis=0)
            found.append(Modulated(o.effect, (Slow(column, column, low, high, tuple(middle.tolist())),)))
    rms = [
        np.concatenate([np.full(len(slow.middle) * k, np.sqrt(slow.spread(data))) for slow in f.over]) for f in found
    ]
    return [columns(o.fit, form) / one for form, one in zip(found, rms, strict=True)]


def _arguments(o: Option, data: MeasuredData) -> Iterator[tuple[str, Array]]:
    """Yield each column of numbers that an option's formula is a function of."""
    for column in dict.fromkeys(o.effect.columns):
        values = np.asarray(data[column]) if column in data else np.empty(0)
        if values.dtype.kind == "f" and len(np.unique(values[np.isfinite(values)])) > _LEVELS:
            yield column, values


def random_curve(x: Array, length: float) -> Array:
    """Return the parts, (n, m), of a random smooth function of x, (n,).

    The function is the sum of the parts times standard normal numbers. Its values are normal, their correlation is
    exp(-d^2 / 2) at a distance of d times `length`, a part of the range of x. Its mean over the finite x is zero and
    its rms there one; elsewhere it is zero.
    """
    known = np.isfinite(x)
    low, high = float(np.min(x[known])), float(np.max(x[known]))
    knots = np.linspace(0.0, 1.0, _KNOTS)
    variances, V = np.linalg.eigh(_correlation(knots, knots, length))
    held = variances > _PART * variances[-1]
    curves = _correlation((x[known] - low) / (high - low), knots, length) @ (V[:, held] / np.sqrt(variances[held]))
    curves -= curves.mean(axis=0)
    parts = np.zeros((len(x), curves.shape[1]))
    parts[known] = curves / np.sqrt(np.sum(curves**2) / len(curves))
    return parts


def random_field(x: Array, length: float) -> Array:
    """Return the parts, (n, m), of a random smooth function of a place x, (n, d), each of its numbers over its range.

    The same as `random_curve` over more than one number, `length` in each of them; all of x is known.
    """
    wide = np.ptp(x, axis=0)
    u = (x - x.min(axis=0)) / np.where(wide > 0, wide, 1.0)
    knots = u[:: max(1, len(u) // _PLACES)]
    variances, V = np.linalg.eigh(_alike(knots, knots, length))
    held = variances > _PART_OF_FIELD * variances[-1]
    fields = _alike(u, knots, length) @ (V[:, held] / np.sqrt(variances[held]))
    fields -= fields.mean(axis=0)
    return np.asarray(fields / np.sqrt(np.sum(fields**2) / len(fields)))


def _alike(one: Array, other: Array, length: float) -> Array:
    return np.asarray(np.prod([_correlation(a, b, length) for a, b in zip(one.T, other.T)], axis=0))


def _correlation(one: Array, other: Array, length: float) -> Array:
    return np.asarray(np.exp(-0.5 * ((one[:, None] - other) / length) ** 2))


def _least(y: Array, D: Array, T: Array, effect: Effect, c: Array, off: Sequence[float], count: int = 0) -> float:
    """Return the minimum of minus twice the log-likelihood of y over possible sizes of the effect.

    The form m is integrated out: normal, as large as one of the parts `off` of T, all equally likely. With a `count` of
    degrees of freedom the variance of the noise is the likeliest, else it is one.
    """
    N, m, k = T.shape
    flat = T.reshape(N, m * k)
    TT, Ty, TD = (flat.T @ flat).reshape(m, k, m, k), (flat.T @ y).reshape(m, k), (flat.T @ D).reshape(m, k, k)
    TTs, TDs = TT.transpose(1, 3, 0, 2).reshape(k * k, m * m), TD.transpose(1, 2, 0).reshape(k * k, m)
    yy, Dy, DD, unit = float(y @ y), D.T @ y, D.T @ D, float(np.linalg.norm(c))
    shares = np.square(off)[:, None]

    def likelihood(u: Array) -> float:
        at = unit * u
        if not is_possible(effect, abs(effect.amplitude(at))):
            return np.inf
        squares = np.outer(at, at).ravel()
        variances, V = np.linalg.eigh((squares @ TTs).reshape(m, m))
        half = (V.T @ (Ty @ at - squares @ TDs)) ** 2
        left = float(yy - 2 * at @ Dy + at @ DD @ at)
        form = shares * variances.clip(0.0)
        noise = _likeliest(left, shares * half, form, count) if count else np.ones((len(off), 1))
        grown = 1 + form / noise
        explained = (shares * half / (noise**2 * grown)).sum(axis=1) - np.log(grown).sum(axis=1)
        likely = explained - (left / noise + count * np.log(noise))[:, 0]
        return float(-2 * (np.logaddexp.reduce(likely / 2) - np.log(len(off))))

    along = c / unit
    across = [np.array([-along[1], along[0]])] if len(along) == 2 else []
    starts = [sign * size * way for size in _SIZES for sign in (1, -1) for way in (along, *across)]
    best = min(starts, key=likelihood)
    return float(minimize(likelihood, best, method="Nelder-Mead", options={"maxiter": _STEPS, "fatol": _NEAR}).fun)


def _likeliest(left: float, half: Array, form: Array, count: int) -> Array:
    """Return the likeliest variance of the noise, (k, 1), for each of k sizes of a random form, by fixed points.

    `left` is the square of what no form explains, `form` (k, m) the variances of the forms along their own directions,
    and `half` (k, m) the squares along them times these variances.
    """
    noise = np.full((len(form), 1), max(left / count, _TINY))
    for _ in range(_SETTLED):
        both = noise + form
        explained = (half * (noise + both) / both**2).sum(axis=1, keepdims=True)
        free = count - (form / both).sum(axis=1, keepdims=True)
        noise = np.maximum((left - explained) / np.maximum(free, 1.0), _TINY)
    return noise
