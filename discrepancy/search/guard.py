"""The guard against causes that no catalogue has: is more wrong with a named part than the error of a formula?

Without its own name a cause brings the nearest one. What that leaves lies on the same part, and follows what its
formula does not know: another joint, two joints together, the time, a speed. So the part of each name gets any smooth
function of one column, coarse and fine, or of two columns, and the name itself times such a function. A real cause in a
form of its own leaves some thousandths to hundredths of what the name explains; a foreign one leaves more. What is left
must be significant, among all functions tried, and more than formulas may be off.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import projected_scores
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, curve
from calibench.discrepancy.fitting.fit import Fit, project_off, reading_order
from calibench.discrepancy.labels import part_label, quantity_label
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.noise.whiten import whitener
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.report import Finding
from calibench.discrepancy.search.form import product
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_TERMS, _FINE, _SIDE, _BEND = 8, 20, 4, 3  # of one column, of one in detail, along each side of two, times the name
_LEVELS = 4  # values up to which a column is a few states and not a number
_FULL = 1e-3  # of a column's length: what calibration and names leave less of is not looked at
_PAIRS = 150  # most pairs of columns
_LEAST = 60  # degrees of freedom: with fewer nothing tells a cause from another


@final
@dataclass(frozen=True)
class Rest:
    """What a smooth function of `columns` explains on the part of a name: `gain`, squares of the scores beyond chance.

    `p` holds for all functions that were tried. `times` says whether the function multiplies the name. `worth` is what
    it brings in twice the log-likelihood, less one for each of its numbers.
    """

    columns: tuple[str, ...]
    p: float
    gain: float
    times: bool
    worth: float


def with_doubts(
    findings: Sequence[Finding], base: Fit, at: Fit, terms: Sequence[SmoothTerm], whole: Mapping[str, float],
    level: float,
) -> tuple[tuple[Finding, ...], bool]:  # fmt: skip
    """Return the findings, with a caution where another cause may be behind a name, and whether there is such a one.

    Names of several parts may share one cause: a function on one part that explains as much beside `base`, the fit
    without effects, as all of them do is no less likely than they are together. `whole` is the energy of the signature
    of each finding before calibration absorbs a part of it, over all scores.
    """
    effects = {f"{e.family} {e.target}": e for e in at.model.effects}
    words, machine = words_of(roles_of(at.model.formulation)), at.model.formulation.data.machine
    found, foreign, alone = [], False, ""
    part = description_of(machine).part_of
    if len({part(one.target) for one in findings if one.effect in effects and not one.caution}) > 1:
        numbers = at.J.shape[1] - base.J.shape[1]
        least = at.noise.gained(base.cost, at.cost, at.degrees) - numbers - thresholds().close
        for one in findings:
            if alone or one.effect not in effects:
                continue
            tried = rests(base, effects[one.effect], terms, at.x[at.model.place_of(effects[one.effect])])
            best = max(tried, key=lambda rest: rest.worth, default=None)
            if best is not None and best.worth >= least:
                over = " and ".join(f"the {quantity_label(machine, name, words)}" for name in best.columns)
                where = part_label(machine, one.target)
                alone = f"may be another cause: one error of {where} over {over} explains as much as all these names"
    for one in findings:
        effect = effects.get(one.effect)
        if effect is None:
            found.append(one)
            continue
        caution = one.caution
        named = max(one.visible**2 * len(at.r), whole.get(one.effect, 0.0))
        if alone:
            caution, foreign = caution or alone, True
        left = [rest for rest in rests(at, effect, terms) if rest.p < level]
        if left and left[0].gain > thresholds().formula_error * named:
            over = " and ".join(f"the {quantity_label(machine, name, words)}" for name in left[0].columns)
            caution = caution or f"may be another cause: beside it the same part errs over {over}"
            foreign = True
        found.append(replace(one, caution=caution))
    return tuple(found), foreign


def rests(fitted: Fit, effect: Effect, terms: Sequence[SmoothTerm], c: Array | None = None) -> list[Rest]:
    """Return what smooth functions explain on the part of `effect` beside a fit, the largest first.

    `c` are the coefficients of the effect, by default those that it has in the fit.
    """
    numbers = fitted.x[fitted.model.place_of(effect)] if c is None else c
    own = effect.basis(fitted.at.recorded, fitted.model.formulation.data, numbers)
    at, kinds, t = fitted.at, fitted.at.misclosure.shape[1], thresholds()
    n, data, whiten, r, J = len(at.misclosure), at.model.formulation.data, at.whiten, fitted.r, fitted.J
    some = np.unique(np.linspace(0, n - 1, min(n, t.drawn_rows // kinds)).round().astype(int))
    if len(some) < n:  # of very many readings a part tells the same
        order = reading_order(data)[some]
        whiten = whitener(at.reading_slopes[some], at.sigma[some], fitted.noise.autocorrelation, order)
        r, J = whiten(at.misclosure[some]), whiten(at.columns[some])
    on = projected_scores(replace(fitted, r=r, J=J))
    if on.degrees < _LEAST:
        return []
    tried = list(_functions({name: column[some] for name, column in data.columns.items()}, terms))
    found = []
    for columns, waves, times in tried:
        raw = sum(
            at.slopes[name][some][:, :, None] * (product(waves, change[some]) if times else waves)[:, None, :]
            for name, change in own.items()
        )
        D = whiten(np.asarray(raw))
        lengths = np.linalg.norm(D, axis=0)
        D = D[:, lengths > 0] / lengths[lengths > 0]
        left = project_off(D, on.Q, times=2)
        squares, vectors = np.linalg.eigh(left.T @ left)
        seen = squares > _FULL**2
        z = (np.stack([on.y, on.tested]) @ left) @ vectors[:, seen] / np.sqrt(squares[seen])
        (T, tested), m = (z**2).sum(axis=1), int(seen.sum())
        if m:
            p = on.test(float(tested), m)
            grown = n / len(some)
            found.append(
                Rest(columns, min(1.0, p * len(tried)), float(T - m) * grown, times, on.gain(float(T), m) * grown - m)
            )
    return sorted(found, key=lambda rest: -rest.gain)


def _functions(
    columns: Mapping[str, Array], terms: Sequence[SmoothTerm]
) -> Iterator[tuple[tuple[str, ...], Array, bool]]:
    """Yield the columns of functions, the functions (n, m), and whether they multiply the name."""
    values: dict[str, Array] = {}
    for term in terms:
        for name, low, high in zip(term.covariates, term.low, term.high):
            x = np.asarray(columns[name], dtype=float)
            if name not in values and np.isfinite(x).all() and high > low:
                few = bool(term.levels) or len(np.unique(x)) <= _LEVELS
                values[name] = curve(x, low, high, 2 if few else _FINE + 1)[:, 1:]
    for name, waves in values.items():
        yield (name,), waves[:, :_TERMS], False
        yield (name,), waves[:, : _BEND - 1], True
        if waves.shape[1] > _TERMS:
            yield (name,), waves, False
    for a, b in list(combinations(values, 2))[:_PAIRS]:
        one, other = values[a][:, : _SIDE - 1], values[b][:, : _SIDE - 1]
        yield (a, b), np.concatenate([one, other, product(one, other)], axis=1), False
