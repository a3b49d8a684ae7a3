"""After naming, the form: whether the size of a named effect goes with something that its formula does not know.

Play of a worn gear is wide where the gear is worn: it is named play, for no other name comes near, and is not the play
of the catalogue. So what is left is tested for each pick's own trace times a slow function of each covariate of its
part. One that shows, and is large against the pick itself, belongs to the finding: it is "like" that effect, and its
size depends on the covariate. It stays in the model, so that no further name is put on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import score_all
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, curve
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.labels import quantity_label
from calibench.discrepancy.model.effect import Effect, OfFreePeriod, name_of
from calibench.discrepancy.model.linear import size
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.search.select import Option, Tests, delta_bic, option
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

FORM_DIFFERS = "form differs"  # and nothing says with what
SLOW = 2  # a slope and a bend of the size over a covariate


@final
@dataclass(frozen=True, eq=False)
class Modulated:
    """An `Effect`: another one, `of`, times a slow function of `column` whose mean over the fitting rows is zero."""

    of: Effect
    column: str
    covariate: str
    low: float
    high: float
    middle: tuple[float, ...]
    positions: int = 1

    @property
    def family(self) -> str:
        """Return the family of the effect whose size changes."""
        return self.of.family

    @property
    def target(self) -> str:
        """Return the target, and what the size goes with."""
        return f"{self.of.target} by {self.covariate}"

    @property
    def formula(self) -> str:
        """Return the formula of the effect, its size a function."""
        return f"({self.of.formula}) times a slow function of {self.covariate}"

    @property
    def channel(self) -> str:
        """Return what the effect acts on."""
        return self.of.channel

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the columns of the effect, and the covariate."""
        return (*self.of.columns, self.column)

    @property
    def twins(self) -> tuple[str, ...]:
        """Return nothing: it is part of a finding, not a name."""
        return ()

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Return the names of the coefficients."""
        orders = range(1, len(self.middle) + 1)
        return tuple(f"{c} by {self.covariate} {k}" for k in orders for c in self.of.coefficients)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each coefficient."""
        return self.of.units * len(self.middle)

    @property
    def unit(self) -> str:
        """Return the unit of the effect."""
        return self.of.unit

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,)."""
        return {name: change @ c for name, change in self.basis(q, data, c).items()}

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n, k)."""
        waves = waves_over(data[self.column], self.low, self.high, len(self.middle)) - np.asarray(self.middle)
        waves[~np.isfinite(waves)] = 0.0  # rows that are not the target's
        own = self.of.basis(q, data, np.zeros(len(self.of.coefficients)))
        return {
            name: (waves[:, :, None] * np.asarray(change)[:, None, :]).reshape(len(waves), -1)
            for name, change in own.items()
        }

    def amplitude(self, c: Array) -> float:
        """Return the length of the coefficients."""
        return size(c)


def unlike(current: Fit, picks: Sequence[Effect], known: Sequence[Effect], terms: Sequence[SmoothTerm], tests: Tests,
           level: float) -> Option | None:  # fmt: skip
    """Return the clearest form of a pick that is not its formula's, fitted beside all picks; None where none shows.

    `known` are the forms that are in the model already: of each pick one. `tests` are those of `current`. A wave whose
    size changes is one of waves of neighbouring periods, which have names: a wave of free period has no form.
    """
    told = {name_of(e.of) for e in known if isinstance(e, Modulated)}
    told |= {name_of(e) for e in picks if isinstance(e, OfFreePeriod)}
    tried = [form for pick in picks if name_of(pick) not in told for form in _forms(current, pick, terms)]
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
    share = _share(found.fit, found.effect)
    return found if found.gain > thresholds().further_gain and share >= thresholds().form_share else None


def runs_away(before: Fit, after: Fit, pick: Effect) -> bool:
    """Return whether a pick beside a form of it is `form_runaway` times as large as without the form.

    Then form and formula are nearly the same function of the readings that were fitted: the two are large and of
    opposite sign, and cancel there and nowhere else. An error of the joint's angle, a curve of that angle already, has
    no size that depends on the angle.
    """
    sizes = [abs(pick.amplitude(c)) for at in (before, after) for e, c in at.model.coefficients(at.x)
             if name_of(e) == name_of(pick)]  # fmt: skip
    return not sizes[1] <= thresholds().form_runaway * sizes[0]


def form_words(effect: Effect, shapes: Sequence[Effect], formulation: Formulation) -> str:
    """Return how the size of a named effect goes with what its formula does not know; "" where it does not."""
    over = [s.covariate for s in shapes if isinstance(s, Modulated) and name_of(s.of) == name_of(effect)]
    machine, words = formulation.data.machine, words_of(roles_of(formulation))
    told = " and the ".join(quantity_label(machine, name, words) for name in over)
    return f"size depends on the {told}" if over else ""


def _forms(current: Fit, pick: Effect, terms: Sequence[SmoothTerm]) -> list[Modulated]:
    """Return the effect times a function of each covariate of its part; of every part where its own has none."""
    data = current.at.model.formulation.data
    part_of = description_of(data.machine).part_of
    lone = [term for term in terms if len(term.covariates) == 1]
    own = [term for term in lone if part_of(term.target) == part_of(pick.target)] or lone
    forms: dict[str, Modulated] = {}
    for term in own:
        [column], [low], [high] = term.covariates, term.low, term.high
        if term.levels and column in pick.columns:
            continue  # play whose size goes with the direction that it is of: the square of a sign, a zero
        waves = waves_over(data[column], low, high, 1 if term.levels else SLOW)
        forms.setdefault(
            column, Modulated(pick, column, term.covariate, low, high, tuple(np.nanmean(waves, axis=0).tolist()))
        )
    return list(forms.values())


def waves_over(values: Array, low: float, high: float, terms: int) -> Array:
    """Return slow functions of a covariate, (n, terms): a slope, a bend and so on; flat beyond low and high."""
    return curve(np.asarray(values, dtype=float), low, high, terms + 1)[:, 1:]


def _share(at: Fit, form: Modulated) -> float:
    """Return the rms change of the size, relative to the size itself, of a fit with both."""
    parts = {name_of(e): c for e, c in at.model.coefficients(at.x)}
    q, data = at.at.recorded, at.model.formulation.data
    own = form.of.shift(q, data, parts[name_of(form.of)])
    change = form.shift(q, data, parts[name_of(form)])
    whole = sum(float(np.sum(values**2)) for values in own.values())
    return float(np.sqrt(sum(float(np.sum(values**2)) for values in change.values()) / whole)) if whole else 0.0
