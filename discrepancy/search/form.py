"""After naming, test the form: does the size of a named effect depend on a quantity that its formula does not have?

Example: the play of a worn gear is wider where the gear is worn. It is named play, because no other name is near, but
it is not the play of the catalogue. So the residuals are tested for each pick's own signature times a slow function of
each covariate of its part. Where that is significant, and large relative to the pick, it belongs to the finding: the
cause is "like" that effect, and its size depends on the covariate. It stays in the model, so that no other name
explains it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import score_all
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, curve
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.labels import quantity_label
from calibench.discrepancy.model.effect import Along, Effect, Moment, OfFreePeriod, along_of, name_of, size
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.search.select import Option, Tests, delta_bic, option
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

FORM_DIFFERS = "form differs"  # and nothing says with what
SLOW = 2  # functions of a covariate: a slope and a bend of the size
MOST = 2  # coefficients of a formula: with more of them it can already be any function of its argument
ALONG = 4  # functions of where a carriage stands: enough for one and a half waves of a screw or a guide
_TINY = 1e-300
_ROUNDS = 10  # in which the sizes of effects settle, relative to which a prior is
_HALVINGS = 16
_WIDTHS = 1e-3, 10.0  # of a prior, between which it is halved


@final
@dataclass(frozen=True, eq=False)
class Slow:
    """Slow functions of a covariate between `low` and `high`, less their `middle`, (m,): their mean.

    With `moments` the covariate is a position at each of them. For an effect that is relative to home, home is zero,
    and `middle` is the value there.
    """

    covariate: str
    column: str
    low: float
    high: float
    middle: tuple[float, ...]
    moments: Callable[[MeasuredData], Sequence[Moment]] | None = None

    def of(self, own: Mapping[str, Array], data: MeasuredData) -> dict[str, Array]:
        """Return quantity -> (n, m k): the changes of an effect, (n, k) each, times the functions."""
        return {one.quantity: product(self._waves(one.at), own[one.of]) for one in self._acting(own, data)}

    def nearest(self, own: Mapping[str, Array], data: MeasuredData) -> Array:
        """Return, for each of the functions, the effect's own coefficients that fit it best, (k, m k)."""
        acting = self._acting(own, data)
        scale = {one.of: float(np.linalg.norm(own[one.of])) or 1.0 for one in acting}
        plain = np.concatenate([np.asarray(own[one.of]) / scale[one.of] for one in acting])
        moved = [product(self._waves(one.at), own[one.of]) / scale[one.of] for one in acting]
        return np.asarray(np.linalg.lstsq(plain, np.concatenate(moved), rcond=None)[0])

    def _acting(self, own: Mapping[str, Array], data: MeasuredData) -> Sequence[Moment]:
        if self.moments is not None:
            return self.moments(data)
        return [Moment(name, name, np.asarray(data[self.column], dtype=float)) for name in own]

    def spread(self, data: MeasuredData) -> float:
        """Return the variance of the functions over the rows, or over the path along which something moves."""
        values = np.linspace(self.low, self.high) if self.moments else np.asarray(data[self.column], dtype=float)
        return float(np.nanvar(self._waves(values), axis=0).sum())

    def _waves(self, values: Array) -> Array:
        waves = waves_over(values, self.low, self.high, len(self.middle)) - np.asarray(self.middle)
        waves[~np.isfinite(waves)] = 0.0  # rows that are not the target's
        return np.asarray(waves)


@final
@dataclass(frozen=True, eq=False)
class Modulated:
    """An `Effect`: another one, `of`, times slow functions of one or more covariates, with their own coefficients."""

    of: Effect
    over: tuple[Slow, ...]
    positions: int = 1

    @property
    def family(self) -> str:
        """Return the family of the effect whose size changes."""
        return self.of.family

    @property
    def covariates(self) -> tuple[str, ...]:
        """Return the covariate on which the size depends."""
        return tuple(slow.covariate for slow in self.over)

    @property
    def acts_along(self) -> bool:
        """Return whether the covariates are positions, or times, at which the effect acts."""
        return all(slow.moments is not None for slow in self.over)

    @property
    def target(self) -> str:
        """Return the target, and the covariate on which the size depends."""
        return f"{self.of.target} by {', '.join(self.covariates)}"

    @property
    def formula(self) -> str:
        """Return the formula of the effect, with its size written as a function."""
        return f"({self.of.formula}) times a slow function of {', '.join(self.covariates)}"

    @property
    def channel(self) -> str:
        """Return what the effect acts on."""
        return self.of.channel

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the columns of the effect, and the covariates."""
        return (*self.of.columns, *(slow.column for slow in self.over if not slow.moments))

    @property
    def twins(self) -> tuple[str, ...]:
        """Return nothing: it is part of a finding, not a name."""
        return ()

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        return tuple(
            f"{c} by {slow.covariate} {k}"
            for slow in self.over
            for k in range(1, len(slow.middle) + 1)
            for c in self.of.coefficients
        )

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each coefficient."""
        return self.of.units * sum(len(slow.middle) for slow in self.over)

    @property
    def unit(self) -> str:
        """Return the unit of the effect."""
        return self.of.unit

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,)."""
        return {name: change @ c for name, change in self.basis(q, data, c).items()}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n, k)."""
        own = self.of.basis(q, data, np.zeros(len(self.of.coefficients)))
        parts = [slow.of(own, data) for slow in self.over]
        if len(parts) == 1:
            return parts[0]
        widths = [len(slow.middle) * len(self.of.coefficients) for slow in self.over]
        starts = np.cumsum([0, *widths])
        whole: dict[str, Array] = {}
        for part, start, width in zip(parts, starts, widths, strict=False):
            for name, change in part.items():
                whole.setdefault(name, np.zeros((len(data), starts[-1])))[:, start : start + width] = change
        return whole

    def nearest(self, q: Quantities, data: MeasuredData) -> Array:
        """Return, for each coefficient of the form, the effect's own coefficients that fit it best, (k, m)."""
        own = self.of.basis(q, data, np.zeros(len(self.of.coefficients)))
        return np.concatenate([slow.nearest(own, data) for slow in self.over], axis=1)

    def amplitude(self, c: Array) -> float:
        """Return the length of the coefficients."""
        return size(c)


def unlike(current: Fit, picks: Sequence[Effect], known: Sequence[Effect], terms: Sequence[SmoothTerm], tests: Tests,
           level: float) -> Option | None:  # fmt: skip
    """Return the clearest deviation of a pick from its formula, fitted beside all picks; None where there is none.

    `known` are the forms that are in the model already: one for each pick at most. `tests` are those of `current`. A
    wave whose size changes is the sum of waves of neighbouring periods, which have names, so a wave of free period has
    no form.
    """
    bent = {name_of(e.of) for e in known if isinstance(e, Modulated)}
    bent |= {name_of(e) for e in picks if isinstance(e, OfFreePeriod)}
    tried = [form for pick in picks if name_of(pick) not in bent for form in _forms(current, pick, terms)]
    scored = [s for s, _ in score_all(current, tests.on, tried) if s.m]
    if not scored:
        return None
    best = max(scored, key=lambda s: delta_bic(s, tests.on))
    if best.p * len(scored) >= level or delta_bic(best, tests.on) < thresholds().further_gain:
        return None
    found = option(current, best, tests.on)
    assert isinstance(found.effect, Modulated)
    if runs_away(current, found.fit, found.effect.of):
        return None
    large = share(found.fit, found.effect) >= _least(found.effect)
    return found if found.gain > thresholds().further_gain and large else None


def _least(form: Modulated) -> float:
    return thresholds().along_share if form.acts_along else thresholds().form_share


def runs_away(before: Fit, after: Fit, pick: Effect) -> bool:
    """Return whether a pick beside a form of it is `form_runaway` times as large as without the form.

    Then form and formula are nearly the same function of the fitted readings: both are large, of opposite sign, and
    cancel each other only there. Example: an error of a joint's angle is already a function of that angle, so a size
    that depends on the angle has no meaning.
    """
    sizes = [abs(pick.amplitude(c)) for at in (before, after) for e, c in at.model.coefficients(at.x)
             if name_of(e) == name_of(pick)]  # fmt: skip
    return not sizes[1] <= thresholds().form_runaway * sizes[0]


def forms_of(effect: Effect, among: Sequence[Effect]) -> list[Modulated]:
    """Return the forms of an effect `among` those of a model."""
    return [e for e in among if isinstance(e, Modulated) and name_of(e.of) == name_of(effect)]


def form_words(effect: Effect, shapes: Sequence[Effect], formulation: Formulation) -> str:
    """Return in words on what the size of a named effect depends; "" where it depends on nothing else.

    For a column that the formula itself uses, the words say that the course over it differs.
    """
    machine, words = formulation.data.machine, words_of(roles_of(formulation))
    phrases: dict[bool, list[str]] = {True: [], False: []}
    for slow in (slow for form in forms_of(effect, shapes) for slow in form.over):
        phrases[slow.column in effect.columns].append(f"the {quantity_label(machine, slow.covariate, words)}")
    size = f"size depends on {' and '.join(phrases[False])}" if phrases[False] else ""
    course = f"course over {' and '.join(phrases[True])} is not that of its formula" if phrases[True] else ""
    return " and ".join(filter(None, (size, course)))


def _forms(current: Fit, pick: Effect, terms: Sequence[SmoothTerm]) -> list[Modulated]:
    """Return the effect times a function of each covariate of its part; of every part where its own has none.

    Where the effect gives the positions of carriages as it acts, they are covariates too: each, and all of them
    together.
    """
    data = current.at.model.formulation.data
    part_of = description_of(data.machine).part_of
    lone = [term for term in terms if len(term.covariates) == 1]
    own = [term for term in lone if part_of(term.target) == part_of(pick.target)] or lone
    along = [slow_along(pick, data, m) for m in (SLOW, ALONG)] if len(pick.coefficients) <= MOST else []
    found = [(slow,) for slows in along for slow in slows] + [slows for slows in along if len(slows) > 1]
    taken = {slow.covariate for slows in along for slow in slows}
    for term in own:
        [column], [low], [high] = term.covariates, term.low, term.high
        if column in taken or term.covariate in taken:
            continue
        if term.levels and column in pick.columns:
            continue  # the size of play cannot depend on its own direction: the square of a sign is constant
        taken.add(column)
        waves = waves_over(data[column], low, high, 1 if term.levels else SLOW)
        middle = tuple(np.nanmean(waves, axis=0).tolist())
        found.append((Slow(term.covariate, column, low, high, middle),))
    return [Modulated(pick, over) for over in found]


def slow_along(effect: Effect, data: MeasuredData, terms: int) -> tuple[Slow, ...]:
    """Return slow functions of the position of each carriage of an effect; none where the effect gives no carriage."""
    along = along_of(effect)
    if along is None:
        return ()
    found = []
    for covariate, moments in along(data).items():
        stands = np.concatenate([one.at for one in moments])
        low, high = float(stands.min()), float(stands.max())
        if low < high:
            more = any(one.quantity != one.of for one in moments)  # at a moment than at home, where the formula holds
            middle = waves_over(np.zeros(1) if more else stands, low, high, terms).mean(axis=0)
            numbers = tuple(middle.tolist())
            found.append(Slow(covariate, covariate, low, high, numbers, partial(_moments, along, covariate)))
    return tuple(found)


def _moments(along: Along, covariate: str, data: MeasuredData) -> Sequence[Moment]:
    return along(data)[covariate]


def product(waves: Array, change: Array) -> Array:
    """Return the changes of an effect, (n, k), times each of m functions, (n, m k)."""
    return np.asarray((waves[:, :, None] * np.asarray(change)[:, None, :]).reshape(len(waves), -1))


def waves_over(values: Array, low: float, high: float, terms: int) -> Array:
    """Return slow functions of a covariate, (n, terms): a slope, a bend and so on; flat beyond low and high."""
    return curve(np.asarray(values, dtype=float), low, high, terms + 1)[:, 1:]


def residuals_within(at: Fit, forms: Sequence[Modulated], most: float) -> Array:
    """Return the whitened residuals, (m,), of a fit in which no form changes its effect by more than `most` of it.

    Calibration may absorb nearly all of what a form adds. Then its fitted size is mostly noise, and a smaller one
    explains as much. So the forms get a normal prior here, as wide as may be with the largest of them within `most`.
    """
    narrowed = _Narrowed(at, forms)
    low, high = np.log(_WIDTHS)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        wide = narrowed.largest_share(narrowed.solved(np.exp(middle))) > most
        low, high = (low, middle) if wide else (middle, high)
    return np.asarray(at.r + at.J @ (narrowed.solved(np.exp(low)) - at.x))


@final
class _Narrowed:
    """The linearised fit `at`, its `forms` with a normal prior."""

    def __init__(self, at: Fit, forms: Sequence[Modulated]) -> None:
        q, data, places = at.at.recorded, at.model.formulation.data, at.model.place_of
        # where the coefficients of effect and form stand, the changes of the effect, the triangle of those of the form
        self._parts = [
            (
                places(form.of),
                _stacked(form.of, q, data),
                places(form),
                np.asarray(np.linalg.qr(_stacked(form, q, data), mode="r")),
            )
            for form in forms
        ]
        self._forms = np.zeros(len(at.x), dtype=bool)
        for _, _, place, _ in self._parts:
            self._forms[place] = True
        root = np.sqrt(at.noise.weights(at.r) * (at.degrees / at.cost if at.noise.profiled else 1.0))
        self._J = at.J * root[:, None]
        self._aim = self._J @ at.x - at.r * root

    def solved(self, width: float) -> Array:
        """Return the numbers, (p,), with a prior of rms `width` relative to the effects as they are in the solution."""
        x = np.zeros(len(self._forms))
        x[~self._forms] = _least_squares(self._J[:, ~self._forms], self._aim)
        for _ in range(_ROUNDS):
            prior = []
            for own, changes, place, R in self._parts:
                rows = np.zeros((len(R), len(x)))
                rows[:, place] = R / (width * float(np.linalg.norm(changes @ x[own])) + _TINY)
                prior.append(rows)
            J = np.concatenate([self._J, *prior])
            x = _least_squares(J, np.concatenate([self._aim, np.zeros(len(J) - len(self._J))]))
        return x

    def largest_share(self, x: Array) -> float:
        """Return the largest rms change of an effect's size, relative to its size."""
        return max(
            float(np.linalg.norm(R @ x[place]) / (np.linalg.norm(changes @ x[own]) + _TINY))
            for own, changes, place, R in self._parts
        )


def _least_squares(A: Array, b: Array) -> Array:
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    return np.asarray(np.linalg.lstsq(A / size, b, rcond=None)[0] / size)


def _stacked(effect: Effect, q: Quantities, data: MeasuredData) -> Array:
    parts = effect.basis(q, data, np.zeros(len(effect.coefficients)))
    return np.concatenate([np.asarray(part) for part in parts.values()])


def share(at: Fit, form: Modulated) -> float:
    """Return the rms change of the size relative to the size, in a fit with both; infinite without the effect."""
    parts = {name_of(e): c for e, c in at.model.coefficients(at.x)}
    if name_of(form.of) not in parts:
        return np.inf
    q, data = at.at.recorded, at.model.formulation.data
    own = form.of.shift(q, data, parts[name_of(form.of)])
    change = form.shift(q, data, parts[name_of(form)])
    whole = sum(float(np.sum(values**2)) for values in own.values())
    return float(np.sqrt(sum(float(np.sum(values**2)) for values in change.values()) / whole)) if whole else 0.0
