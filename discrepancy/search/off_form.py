"""What a name explains if its formula is off, as nature's forms are off a catalogue's: by a tenth of its size.

A formula is right in its main part and wrong in the last: its own trace times 1 + m(x), x what the formula is a
function of (the joint's angle, the torque, the time) or where its carriage stands, m slow and of rms `form_off`.
Calibration may take up all but a hundredth of a gear's wrong ratio, and nothing of a tenth of that: then most of what
is seen is the error of the form, and a rival, or a smooth curve of x, takes it up and explains more than the name. So
a name has a second gain, that of its marginal likelihood with m drawn at random: what m explains counts, and what it
could have explained and did not is paid for. A rival is held against the best by that gain, for the best one's form
may be off as well, and its winning to the letter may be luck. A curve is believed only where it wins against that, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.optimize import minimize

from calibench.discrepancy.diagnostics.score import columns
from calibench.discrepancy.fitting.projection import orthonormal, project_off
from calibench.discrepancy.model.effect import along_of
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.search.form import ALONG, MOST, SLOW, Modulated, Slow, slow_along, waves_over
from calibench.discrepancy.search.select import Option, close
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_SIZES = (0.03, 0.1, 0.3, 1.0, 3.0)  # times the fitted one: where the form hides it, it may have been fitted far off
_STEPS = 100
_LEVELS = 4  # of a column that has no slow function
_FULL = 1e-10


def near(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return the best option and those that come close to it where formulas may be off, each with how far behind.

    In their order, but the likeliest comes first where the first one does not come close to it.

    Each on the part of the best one is as likely as its formula to the letter and its formula off, together, the second
    `form_odds` likelier beforehand: so of two formulas that may both be off, neither wins by being met to the letter.
    What has no form, and what acts on another part, is judged by its gain. Where effects tell where they act, those of
    all parts are held against each other, as legs that meet share what one of them does; one near by its gain stays.
    There both likelihoods count alike: of some a form shows, of others it does not, and readings are few.
    """
    plain, top = close(found), max(found, key=lambda o: o.gain)
    if not _are_few(top):
        return plain
    part_of = description_of(top.fit.model.formulation.data.machine).part_of
    own = {o.name for o in found if part_of(o.effect.target) == part_of(top.effect.target)}
    rivals = [o for o in found if o.name in own or _go_along(o, top)]
    if len(rivals) < 2:
        return plain
    worth = {o.name: one for o in rivals if (one := _worth(o, top)) is not None}
    best = max(worth.values()) - thresholds().form * top.gain
    taken_up = thresholds().formula_error * top.gain  # of another's form, by a formula of many numbers
    told = {
        o.name: replace(o, behind=best - worth[o.name] + taken_up * (_is_rich(o) - _is_rich(top)))
        for o in rivals
        if o.name in worth
    }
    kept = {o.name for o in told.values() if o.behind < thresholds().close}
    kept |= {top.name, *(o.name for o in plain if o.name not in told or o.name not in own)}
    return _likeliest_first([told.get(o.name, o) for o in found if o.name in kept])


def _likeliest_first(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return options, the one that is least behind before all others where the first is out of its reach."""
    first, likeliest = found[0], min(found, key=lambda o: o.behind)
    if not thresholds().close <= first.behind < np.inf:
        return tuple(found)
    return (likeliest, *(o for o in found if o is not likeliest))


def _are_few(top: Option) -> bool:
    return top.gain > 0 and 0 < len(top.fit.r) < thresholds().drawn_rows


def _go_along(o: Option, top: Option) -> bool:
    return None not in (along_of(o.effect), along_of(top.effect))


def _worth(o: Option, top: Option) -> float | None:
    """Return twice the log of an option's likelihood, its form off or not, against that of no effect; None without one.

    A slow form is drawn at random under the weights of `top`: under its own, those of heavy tails, a poor fit would be
    forgiven what is far off. One of many numbers takes up whatever its argument does: off or not, it explains the same.
    """
    drawn = o.gain
    if (told := _drawn(o, SLOW, top)) is not None:
        drawn = top.gain + top.paid - o.paid + _squares(top, top) - told[1]
    elif o is not top and not _is_rich(o):
        return None
    odds = 0.0 if along_of(top.effect) is not None else thresholds().form_odds
    return float(2 * np.logaddexp(o.gain / 2, (drawn + odds) / 2))


def _is_rich(o: Option) -> bool:
    return len(o.effect.coefficients) > MOST


def bonus(o: Option) -> float:
    """Return by how much more an option explains if its formula may be off; nothing where it explains no more.

    It is held against smooth curves, so its form may be as rough as they are.
    """
    told = [_drawn(o, terms, o) for terms in (SLOW, thresholds().curve_terms - 1)]
    return max([0.0, *(before - after for before, after in filter(None, told))])


def _squares(o: Option, top: Option) -> float:
    return float(np.sum(o.fit.noise.weights(top.fit.r) * o.fit.r**2))


def _drawn(o: Option, terms: int, top: Option) -> tuple[float, float] | None:
    """Return minus twice the log-likelihood of an option, and that with a form of so many functions drawn at random.

    Under the weights that the residuals of `top` have; None where the option has no such form.
    """
    at, k = o.fit, len(o.effect.coefficients)
    c = at.x[len(at.x) - k :]
    if k > MOST or at.noise.profiled or not len(at.r) or not np.linalg.norm(c) > 0:
        return None
    root = np.sqrt(at.noise.weights(top.fit.r))
    J = at.J * root[:, None]
    size = np.linalg.norm(J, axis=0)
    Q = orthonormal(J[:, :-k] / np.where(size > 0, size, 1.0)[:-k], _FULL)
    D = project_off(J[:, -k:], Q, times=2)
    y = project_off(at.r * root, Q, times=2) + D @ c
    least = [_least(y, D, T, c) for form in _forms(o, terms) for T in [_seen(o, form, root, Q)]]
    return (float(np.sum((y - D @ c) ** 2)), min(least)) if least else None


def _forms(o: Option, terms: int) -> list[Modulated]:
    """Return the effect times slow functions of each column of numbers that its formula is a function of.

    Where it tells where its carriages stand, of these instead, all together.
    """
    data, found = o.fit.model.formulation.data, []
    if along := slow_along(o.effect, data, ALONG):
        return [Modulated(o.effect, along)]
    for column in dict.fromkeys(o.effect.columns):
        values = np.asarray(data[column]) if column in data else np.empty(0)
        if values.dtype.kind != "f" or len(np.unique(values[np.isfinite(values)])) <= _LEVELS:
            continue
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        middle = np.nanmean(waves_over(values, low, high, terms), axis=0)
        found.append(Modulated(o.effect, (Slow(column, column, low, high, tuple(middle.tolist())),)))
    return found


def _seen(o: Option, form: Modulated, root: Array, Q: Array) -> Array:
    """Return what calibration leaves of the trace times each slow function, each covariate's of rms `form_off`."""
    k, data = len(o.effect.coefficients), o.fit.model.formulation.data
    T = project_off(columns(o.fit, form) * root[:, None], Q, times=2).reshape(len(o.fit.r), -1, k)
    rms = [np.full(len(slow.middle), np.sqrt(slow.spread(data))) for slow in form.over]
    return np.asarray(T * thresholds().form_off / np.concatenate(rms)[:, None])


def _least(y: Array, D: Array, T: Array, c: Array) -> float:
    """Return the least of minus twice the log of the likelihood of y, m integrated out, over sizes of the effect."""
    N, m, k = T.shape
    flat = T.reshape(N, m * k)
    TT, Ty, TD = (flat.T @ flat).reshape(m, k, m, k), (flat.T @ y).reshape(m, k), (flat.T @ D).reshape(m, k, k)
    TTs, TDs = TT.transpose(1, 3, 0, 2).reshape(k * k, m * m), TD.transpose(1, 2, 0).reshape(k * k, m)
    yy, Dy, DD, unit, eye = float(y @ y), D.T @ y, D.T @ D, float(np.linalg.norm(c)), np.eye(m)

    def told(u: Array) -> float:
        at = unit * u
        squares = np.outer(at, at).ravel()
        root, _ = dpotrf(eye + (squares @ TTs).reshape(m, m), lower=1)  # 1 + a square: it has a root
        half, _ = dtrtrs(root, Ty @ at - squares @ TDs, lower=1)
        left = yy - 2 * at @ Dy + at @ DD @ at
        return float(left - half @ half + 2 * np.log(root.diagonal()).sum())

    return _lowest(told, c / unit)


def _lowest(told: Callable[[Array], float], along: Array) -> float:
    across = [np.array([-along[1], along[0]])] if len(along) == 2 else []
    starts = [sign * size * way for size in _SIZES for sign in (1, -1) for way in (along, *across)]
    best = min(starts, key=told)
    return float(minimize(told, best, method="Nelder-Mead", options={"maxiter": _STEPS}).fun)
