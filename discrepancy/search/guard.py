"""The guard against causes that no catalogue has: a name stands where its form is confirmed, not where none refuses it.

Without its own name a cause brings the nearest ones. What they explain is compared, by marginal likelihood, with smooth
errors of the same part over what was met: Gaussian processes over one column, two, or all that the names follow. Three
accounts are weighed. The names, each off its formula by as much as formulas are; the names beside a smooth error that
is no form of theirs, as it follows columns that they do not know, or is larger; and one smooth error instead of them.
Several causes that meet on one part are rare, a foreign cause that several names share is not: they must explain far
more than one function. A likelihood counts the numbers that a function needs, so no error is held out, and few rows do
not decide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import final

import numpy as np
from scipy.linalg.lapack import dormqr, dpstrf, dsytrd, dtrtrs

from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm
from calibench.discrepancy.fitting.fit import Fit, once, orthonormal, project_off, thinned
from calibench.discrepancy.fitting.journal import kept_step
from calibench.discrepancy.model.effect import Effect, OfFreePeriod, name_of
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.noise.whiten import Whitener
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.report import Caution, Doubt, Finding
from calibench.discrepancy.search.form import MOST, forms_of, product
from calibench.discrepancy.search.select import Option
from calibench.discrepancy.search.smoother import Component
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_WAVES, _SIDE = 24, 7  # cosines over one column, and along each side of two
_SLOWEST = 100  # waves of a function of more than two columns
_LENGTHS = (0.08, 0.16, 0.32, 0.64)  # of a column's range
_SIZES = np.geomspace(0.05, 100.0, 14)  # of a smooth error, in standard deviations of the noise
_OFF = np.array([0.0, 0.2, 0.4, 0.67, 1.0])  # sizes of the error of a form, parts of what formulas may be off
_LEVELS = 4  # values up to which a column is a few states and not a number
_TOP = 2  # columns whose functions explain most, that are tried together with each other one
_OWN = 0.02  # of the variance of a name's change: what a function of one column leaves of it, where it is one of that
_SIGN = 0.95  # of the rows, in which a direction is the sign of a velocity
_BEAT = np.sqrt(2.0)  # between two periods: half an octave
_LEAST = 60  # degrees of freedom: with fewer nothing tells a cause from another
_FURTHER = 20.0  # log odds against another name on the same part: measured on foreign causes and on pairs of true ones
_RANK = 1e-10
_WORK = 32  # columns that LAPACK takes at once
_SAME = 1e-3  # of the square: slopes that differ by less are the same
_TINY = 1e-300


@final
@dataclass(frozen=True)
class Account:
    """Log-likelihoods of names and a smooth error over `columns`, and of that error `alone`.

    `form`: it is the error of the names' forms; `beside`: of any size; `larger`: larger than forms are off.
    """

    columns: tuple[str, ...]
    form: float
    beside: float
    larger: float
    alone: float


def with_doubts(
    findings: Sequence[Finding], at: Fit, terms: Sequence[SmoothTerm], sets: Sequence[Sequence[Option]]
) -> tuple[tuple[Finding, ...], bool]:  # fmt: skip
    """Return the findings, with a caution where another cause may be behind a name, and whether there is such a one.

    A name of so many numbers that it is nearly any function stands where a simpler one of its set does.
    """
    effects = {f"{e.family} {e.target}": e for e in at.model.effects}
    part = description_of(at.model.formulation.data.machine).part_of
    groups: dict[str, list[Finding]] = {}
    for one in (one for one in findings if one.effect in effects):
        groups.setdefault(part(one.target), []).append(one)
    together = [[one for own in groups.values() for one in own]] if len(groups) > 1 else []
    doubts: dict[str, Caution] = {}
    for own in (*groups.values(), *together):
        sure = [one for one in own if not one.caution] or own[:1]
        claims = _causes_of(sure, effects, part, at)
        named = [effects[one.effect] for one in sure]
        errors = [effects[one.effect] for one in own if one not in sure]
        curve = _of_one_curve(named, at)
        columns, instead = (curve, True) if curve else _doubt(at, terms, named, errors, claims)
        if columns and not curve and _is_rich(named[0]):
            rivals = [o for one in sets if [one[0].effect] == named for o in one if len(o.fit.r)]
            if any(not _doubt(o.fit, terms, [o.effect], (), claims)[0] for o in rivals if not _is_rich(o.effect)):
                continue
        doubt = Caution(Doubt.ONE_CAUSE, columns, sure[0].target) if instead else Caution(Doubt.OTHER_CAUSE, columns)
        doubts |= {one.effect: doubt for one in own if columns and one.effect not in doubts}
    some = (
        replace(one, caution=(doubts[one.effect],)) if one.effect in doubts and not one.caution else one
        for one in findings
    )
    return tuple(some), bool(doubts)


def _of_one_curve(named: Sequence[Effect], at: Fit) -> tuple[str, ...]:
    """Return the column over which names are another curve than what they stand for, and () where they are not.

    Two waves whose fitted periods are less than half an octave apart are one wave whose size changes, as where gears
    beat. A size of a direction that goes with the velocity of this sign is a function of the velocity, as friction is
    and no play.
    """
    periods = [(e.period(at.x[at.model.place_of(e)]), e.columns) for e in named if isinstance(e, OfFreePeriod)]
    for (one, columns), (other, same) in combinations(periods, 2):
        if columns == same and 1 / _BEAT < one / other < _BEAT:
            return columns
    for effect in named:
        for slow in (slow for form in forms_of(effect, at.model.effects) for slow in form.over):
            if slow.column not in effect.columns and _has_sign_of(effect, slow.column, at.model.formulation.data):
                return (slow.column,)
    return ()


def _has_sign_of(effect: Effect, column: str, data: MeasuredData) -> bool:
    """Return whether a direction that an effect reads is that of a velocity."""
    if not (data.has(column) and all(map(data.has, effect.columns))):
        return False
    sign = np.sign(np.asarray(data[column], dtype=float))
    return len(np.unique(sign)) > 1 and any(np.mean(sign == data[one]) > _SIGN for one in effect.columns)


def _causes_of(
    findings: Sequence[Finding], effects: Mapping[str, Effect], part: Callable[[str], str], at: Fit
) -> int:  # fmt: skip
    """Return how many causes names claim: the waves of one curve are one, and one family may act on several parts.

    Terms of one quantity over different columns are no parts of a machine: each claims a cause of its own.
    """
    data, recorded = at.model.formulation.data, at.at.recorded
    causes: list[tuple[set[str], set[str], dict[str, tuple[str, ...]]]] = []  # parts, families or waves, what changes
    for one in findings:
        effect = effects[one.effect]
        wave: Effect | None = getattr(effect, "whole", None)
        families = {one.family, *(rival.family for rival in one.set)} if wave is None else {*wave.coefficients}
        place = part(one.target)
        changes = dict.fromkeys(effect.basis(recorded, data, at.x[at.model.place_of(effect)]), effect.columns)
        for parts, kinds, known in causes:
            apart = place not in parts and all(known.get(name, effect.columns) == effect.columns for name in changes)
            if kinds & families and (wave is not None or apart):
                parts.add(place)
                kinds |= families
                known |= changes
                break
        else:
            causes.append(({place}, families, changes))
    return len(causes)


def _doubt(
    at: Fit, terms: Sequence[SmoothTerm], named: Sequence[Effect], errors: Sequence[Effect], claims: int
) -> tuple[tuple[str, ...], bool]:
    """Return the columns of a smooth error that puts names in doubt, () for none, and whether it is instead of them."""
    of = ("accounts", len(named), *map(name_of, (*named, *errors)), len(terms), at.x, at.r)
    tried, own = kept_step(lambda: accounts(at, terms, named, errors), of)
    if not tried:
        return (), False
    t = thresholds()
    # the size of an error may go with the reading that it is an error of: that is a form of its own
    recorded, data = at.at.recorded, at.model.formulation.data
    bases = {name_of(e): e.basis(recorded, data, at.x[at.model.place_of(e)]) for e in named}
    known = {name for e, basis in bases.items() for name in (*own[e], *basis)}
    exact = max(one.form for one in tried)
    within = max((one.form for one in tried if {*one.columns} <= known), default=exact)
    rest = max(tried, key=lambda one: one.larger if {*one.columns} <= known else one.beside)
    more = rest.larger if {*rest.columns} <= known else rest.beside
    # a function of what the only name is a function of says no other thing than the name; but all that is slow has some
    # course in time and over the temperature, and a line is the cause there only where no free course is likelier; and
    # a formula of so many numbers that it is nearly any function says more than one only where it is surely likelier
    same = own[name_of(named[0])] if claims == 1 else set()
    roles = roles_of(at.model.formulation)
    slow = {*named[0].columns} and {*named[0].columns} <= {roles.time, roles.temperature}
    # several names on one part are rare, and rarer where their sizes depend on what their formulas do not have
    bent = [{slow.column for one in forms_of(e, at.model.effects) for slow in one.over} - {*e.columns} for e in named]
    more_claims = claims - 1 + (claims > 1) * sum(not one <= own[name_of(e)] for e, one in zip(named, bent))
    least = {True: -t.close / 2 if _is_rich(named[0]) else 0.0 if slow else np.inf}
    # a function of three columns is rarer than one of two, as a further cause is
    least[False] = t.close / 2 - _FURTHER * more_claims
    rare = {one.columns: _FURTHER * max(min(len(one.columns) - 2, more_claims), 0) for one in tried}
    ahead, columns = max(
        (one.alone - exact - least[{*one.columns} <= same] - rare[one.columns], one.columns) for one in tried
    )
    if ahead > 0:
        return columns, True
    return (rest.columns if more - within > (t.further_gain + t.close) / 2 else ()), False


def _is_rich(effect: Effect) -> bool:
    one_wave = isinstance(effect, OfFreePeriod)  # which is no function at will
    return len(effect.coefficients) > MOST and not one_wave


def accounts(
    at: Fit, terms: Sequence[SmoothTerm], named: Sequence[Effect], errors: Sequence[Effect] = ()
) -> tuple[list[Account], Mapping[str, set[str]]]:
    """Return what smooth errors say of names on their part, and name -> the columns of which it is a function.

    `errors` are names that may be the error of the form of these: what they explain is left to that.
    """
    fixed, at = (at.J, *named, *errors), thinned(at)
    part = _Part.of(at, named, errors)
    if part.degrees < _LEAST:
        return [], {}
    data = at.model.formulation.data
    columns: dict[str, Component] = {}
    for term in terms:
        for name, low, high in zip(term.covariates, term.low, term.high):
            x = np.asarray(data[name], dtype=float)
            if name not in columns and np.isfinite(x).all() and high > low:
                values = np.unique(x)
                levels = tuple(map(float, values)) if len(values) <= _LEVELS else ()
                columns[name] = Component("", name, "", (name,), (low,), (high,), _WAVES, levels)
    waves = {name: one.waves(data.columns) for name, one in columns.items()}
    # a function of a direction is one of the velocity that has this sign
    own: dict[str, set[str]] = {name_of(e): set() for e in named}
    for e in named:
        own[name_of(e)].update(name for name in columns if name in e.columns or _has_sign_of(e, name, data))
    for effect, values in part.changes:
        y = values - values.mean()
        for name in columns:
            A = np.column_stack([np.ones(len(values)), waves[name][0]])
            left = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
            if left @ left < _OWN * (y @ y):
                own[name_of(effect)].add(name)
    law = part.gain if np.isfinite(at.noise.t_degrees) else 0.0  # heavy tails are cut by their scale
    sides = dict(waves)  # of each column the functions of which products with another column's are made
    for name, (one, slow) in waves.items():
        if slow.any():
            sides[name] = np.insert(one[:, : _SIDE - 1], 0, 1.0, axis=1), np.insert(slow[: _SIDE - 1], 0, 0.0)

    def smooth(*names: str) -> list[list[_Error]]:
        if len(names) == 1:
            return part.errors(*waves[names[0]], 1)
        one, squares = np.ones((len(data), 1)), np.zeros(1)
        for other, fast in (sides[name] for name in names):
            squares = (squares[:, None] + fast**2).ravel()
            slowest = np.sort(np.argsort(squares, kind="stable")[:_SLOWEST])
            one, squares = product(one, other)[:, slowest], squares[slowest]
        some = squares > 0 if squares.any() else np.ones(len(squares), dtype=bool)
        return part.errors(one[:, some], np.sqrt(squares[some]), len(names))

    def account(columns_of: Iterable[tuple[str, ...]]) -> list[Account]:
        known = {names: once(partial(smooth, *names), fixed, "errors", len(named), names, law) for names in columns_of}
        return part.accounts(known)

    tried = account((name,) for name in columns)
    best = sorted(tried, key=lambda one: -max(one.larger, one.alone))[:_TOP]
    met = {name for names in own.values() for name in names} | {one.columns[0] for one in best}
    tried += account(pair for pair in combinations(columns, 2) if met & {*pair})
    # names over more columns than two may share one function of all of them
    known = tuple(name for name in columns if any(name in e.columns for e in named))
    return tried + account([known] if len(known) > 2 else []), own


@final
@dataclass(frozen=True, eq=False)
class _Part:
    """The scores with what names explain, and the columns of these, each by what it may be: `given` (N, 1 + k).

    `slopes` are those of the quantities that they change, alike ones once; `sets` the places of all of them and of
    those of each name. `off` is how large, in the scores, errors of their forms may be; `changes` the names' effects.
    """

    given: Array
    Q: Array
    slopes: Sequence[Array]
    sets: Sequence[Sequence[int]]
    off: float
    changes: Sequence[tuple[Effect, Array]]
    white: Whitener
    gain: float
    degrees: int
    least: float  # variance of the noise

    @classmethod
    def of(cls, at: Fit, named: Sequence[Effect], errors: Sequence[Effect]) -> _Part:
        """Return the part of names, and of their forms, in a fit."""
        model, gain, r, J, data = at.model, at.noise.gain, at.r, at.J, at.model.formulation.data
        own = [effect for e in named for effect in (e, *forms_of(e, model.effects))]
        places = [model.place_of(e) for e in own]
        out = [model.place_of(one) for e in errors for one in (e, *forms_of(e, model.effects))]
        J = J * gain
        signs = [J[:, place] @ at.x[place] for place in places]
        kept = np.delete(np.arange(len(at.x)), np.concatenate([np.arange(len(at.x))[p] for p in (*places, *out)]))
        Q, rest = orthonormal(J[:, kept], _RANK), sum(J[:, place] @ at.x[place] for place in out)
        columns = [J[:, place] for place in places]
        variances = [
            np.mean(sign**2) / np.maximum(np.mean(one**2, axis=0), _TINY) / one.shape[1]
            for sign, one in zip(signs, columns)
        ]
        slopes: list[Array] = []
        sets: list[list[int]] = []
        changes: list[tuple[Effect, Array]] = []
        for effect, place in zip(own, places):
            acting = []
            for name, basis in effect.basis(at.at.recorded, data, at.x[place]).items():
                slope = np.asarray(at.at.slopes[name])
                same = [  # but for a factor
                    k for k, one in enumerate(slopes)
                    if np.sum(slope * one) ** 2 > (1 - _SAME) * np.sum(slope**2) * np.sum(one**2)
                ]  # fmt: skip
                acting.append(same[0] if same else len(slopes))
                slopes += [slope] if acting[-1] == len(slopes) else []
                changes += [(effect, np.asarray(basis) @ at.x[place])] if effect in named else []
            sets += [sorted({*acting})]
        every = [[*range(len(slopes))], *(one for one in sets if len(one) < len(slopes))]
        y = project_off(at.noise.scores(r) - sum(signs) - rest, Q)
        shown = project_off(np.concatenate(columns, axis=1), Q, times=2) * np.sqrt(np.concatenate(variances))
        return cls(
            given=np.column_stack([y, shown]), Q=Q, slopes=slopes,
            sets=[list(one) for one in dict.fromkeys(map(tuple, every))],
            off=float(np.sqrt(thresholds().formula_error * np.mean(sum(signs) ** 2))), changes=changes,
            white=at.at.whiten, gain=gain, degrees=len(y) - Q.shape[1], least=0.0 if at.noise.profiled else 1.0,
        )  # fmt: skip

    def accounts(self, tried: Mapping[tuple[str, ...], Sequence[Sequence[_Error]]]) -> list[Account]:
        """Return what smooth errors over columns say of the names; the first ones of each are of all slopes."""
        off, found = _OFF * self.off, []
        every: list[_Error] = [one for own in tried.values() for alike in own for one in alike]
        likely = iter(_likely(every, np.concatenate([off, _SIZES]), self) if every else np.empty(0))
        for columns, own in tried.items():
            sets = [[next(likely) for _ in alike] for alike in own]
            alone = max(float(one[0, len(off) :].max()) for alike in sets for one in alike)
            named = np.max([one[1] for one in sets[0]], axis=0)
            form, beside = named[: len(off)], named[len(off) :]
            larger = np.max(beside, where=self.off < _SIZES, initial=-np.inf)
            found.append(Account(columns, float(form.max()), float(beside.max()), float(larger), alone))
        return found

    def errors(self, waves: Array, frequencies: Array, over: int) -> list[list[_Error]]:
        """Return the smooth errors of functions (n, m) of `over` columns: of each set of slopes, one of each prior."""
        raw = [self.white(slope[:, :, None] * waves[:, None, :]) * self.gain for slope in self.slopes]
        sizes = [float(np.mean(one**2)) or 1.0 for one in raw]
        seen = [project_off(one, self.Q) for one in raw]
        squares, found = self.given.T @ self.given, []
        # relative variances of the weights: of smooth functions, and over one column of a walk
        shapes = [np.ones(len(frequencies))]
        if frequencies.any():
            walk = [frequencies**-2.0] if over == 1 else []
            shapes = [*(np.exp(-0.5 * (frequencies * length) ** 2) for length in _LENGTHS), *walk]
        for acting in self.sets:
            A = np.concatenate([seen[j] for j in acting], axis=1)
            factor, z = _factor(A.T @ A, A.T @ self.given)
            priors = (np.concatenate([shape / shape.sum() / sizes[j] for j in acting]) for shape in shapes)
            found.append([_Error.of(factor, z, squares, one / len(acting), self.gain) for one in priors])
        return found


def _factor(sums: Array, along: Array) -> tuple[Array, Array]:
    """Return a factor (r, m) and z (r, t), so that factor' factor and factor' z are sums (m, m) and `along` (m, t)."""
    upper, pivots, rank, _ = dpstrf(sums, tol=_RANK * np.diag(sums).max())
    order = pivots - 1
    # two rows are zero: LAPACK solves for two and more
    factor, z = np.zeros((rank + 2, len(sums))), np.zeros((rank + 2, along.shape[1]))
    factor[:rank, order] = np.triu(upper[:rank])
    z[:rank] = dtrtrs(upper[:rank, :rank], along[order[:rank]], trans=1)[0]
    return factor, z


@final
@dataclass(frozen=True, eq=False)
class _Error:
    """A smooth error of a part, of any size: a tridiagonal matrix (`diagonal`, `beside`), so that a size costs little.

    `z`, (r, 1 + k), are the scores and the k columns of the names, each by what it may be, along the error; `rest` are
    their products without it. `inner`: the matrix is that of the functions, else that of the rows. `gain` is that of
    the scores: at another scale of the noise the matrix is the same.
    """

    diagonal: Array
    beside: Array
    z: Array
    rest: Array
    inner: bool
    gain: float

    @classmethod
    def of(cls, factor: Array, z: Array, squares: Array, variances: Array, gain: float) -> _Error:
        """Return it of functions by their factor and z, and the variances (m,) of their weights."""
        some = variances > _RANK * variances.max()
        scaled = factor[:, some] * np.sqrt(variances[some])
        # of the two, the smaller matrix: (1 + S S')^-1 is 1 - S (1 + S' S)^-1 S'
        inner = 1 < scaled.shape[1] < len(scaled)
        rest = squares if inner else squares - z.T @ z
        S, z = (scaled.T, scaled.T @ z) if inner else (scaled, z.copy())
        turns, diagonal, beside, tau, _ = dsytrd(S @ S.T, lower=1, lwork=_WORK * len(S))
        z[1:] = dormqr("L", "T", turns[1:, :-1], tau, z[1:], lwork=_WORK * z.shape[1])[0]
        return cls(diagonal, beside, z, rest, inner, gain)


def _likely(errors: Sequence[_Error], sizes: Array, part: _Part) -> Array:
    """Return the log-likelihoods, but for a constant, of each error and size: alone and beside the names, (e, 2, s).

    All matrices are factored row by row at once, the longest first, so that those that have ended stand behind.
    """
    order = sorted(range(len(errors)), key=lambda j: -len(errors[j].diagonal))
    lengths = np.array([len(errors[j].diagonal) for j in order])
    squares, k = sizes**2, len(errors[0].rest)
    diagonal, beside = np.zeros((2, lengths[0], len(errors), 1))
    z = np.zeros((lengths[0], k, len(errors), 1))
    for place, j in enumerate(order):
        one, r = errors[j], lengths[place]
        diagonal[:r, place, 0], beside[1:r, place, 0], z[:r, :, place, 0] = one.diagonal, one.beside, one.z
    widths, along = np.zeros((len(errors), len(sizes))), np.zeros((k, k, len(errors), len(sizes)))
    pivots, moved = np.ones_like(widths), np.zeros_like(along[0])
    for i in range(lengths[0]):
        open_to = slice(np.count_nonzero(lengths > i))
        tied = squares * beside[i, open_to]
        share = tied / pivots[open_to]
        pivots = 1 + squares * diagonal[i, open_to] - share * tied
        moved = z[i][:, open_to] - share * moved[:, open_to]
        widths[open_to] += np.log(pivots)
        along[:, :, open_to] += moved[:, None] * (moved / pivots)
    inner = np.array([errors[j].inner for j in order])[:, None]
    rest = np.stack([errors[j].rest for j in order], axis=-1)[..., None]
    gains = np.array([part.gain / errors[j].gain for j in order])[:, None]
    left = (rest + np.where(inner, -squares, 1.0) * along) * gains**2
    both = [(left[0, 0].copy(), widths)]
    for j in range(k - 1, 0, -1):  # the names are taken out as well
        names = left[j, j] + 1
        widths = widths + np.log(names)
        left[:j, :j] -= left[:j, j, None] * (left[j, :j] / names)
    found = np.empty((len(errors), 2, len(sizes)))
    for place, (alone, wide) in enumerate([*both, (left[0, 0], widths)]):
        alone = np.maximum(alone, _TINY)
        noise = np.maximum(part.least, alone / part.degrees)
        found[order, place] = -0.5 * (part.degrees * np.log(noise) + alone / noise + wide)
    return found
