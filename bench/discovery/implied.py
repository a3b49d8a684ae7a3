"""Residuals as errors of the quantity that an effect changes: the error that each reading implies.

A whitened residual has no direct meaning for an engineer, and its sign depends on the pose. So the residuals of each
reading are shown as the error of the one quantity that an effect changes (an encoder's angle, a link's length) which
would cause them: with the whitened slopes s of that quantity, s . r / s . s, of weight s . s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.report import Report
from calibench.discrepancy.search.form import Modulated, forms_of
from calibench.problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class Implied:
    """The error of `quantity` that each reading implies, (n,), in its own unit, `before` and `after` the effect.

    `column` is the data column that the effect depends on; None where there is none. `without` is the fit of all other
    effects but this one. `weight`, (n,), is that of `before`.
    """

    effect: Effect
    quantity: str
    column: str | None
    without: Fit
    before: Array
    after: Array
    weight: Array


def implied_errors(report: Report) -> tuple[Implied, ...]:
    """Return one for each effect that changes a quantity, in the order of the findings.

    Each is against the model with all others but without it and its forms, which is fitted anew. Curves of a smooth
    correction are one correction, however many: they are against the model without any effect.
    """
    before, after = report.before.fit, report.model.fit
    rank = {finding.effect: k for k, finding in enumerate(report.findings)}
    whole = [effect for effect in after.model.effects if not isinstance(effect, Modulated)]
    effects = sorted(whole, key=lambda effect: rank.get(name_of(effect), len(rank)))
    together = len(effects) == 1 or any(effect.family == "smooth" for effect in effects)
    each = (_implied(effect, before if together else _without(effect, after), after) for effect in effects)
    return tuple(implied for implied in each if implied is not None)


def error_of(quantity: str, fit: Fit) -> tuple[Array, Array]:
    """Return the error of `quantity` that each reading implies, and the weight of that, (n,) each."""
    n, c = fit.at.misclosure.shape
    r = fit.r.reshape(n, c)
    s = fit.at.whiten(fit.at.slopes[quantity][:, :, None]).reshape(n, c)
    weight = (s**2).sum(axis=1)
    return -(s * r).sum(axis=1) / np.maximum(weight, 1e-300), weight / fit.noise.scale**2


def _without(effect: Effect, final: Fit) -> Fit:
    """Return the final model fitted again without one of its effects and its forms."""
    model = final.model
    out = [effect, *forms_of(effect, model.effects)]
    kept = tuple(other for other in model.effects if not any(other is one for one in out))
    start = len(model.formulation.parameters)
    coefficients = []
    for other in model.effects:
        end = start + len(other.coefficients)
        coefficients.append(final.x[start:end] if any(other is one for one in kept) else final.x[:0])
        start = end
    x = np.concatenate([final.x[: len(model.formulation.parameters)], *coefficients])
    return fit(Model(model.formulation, kept), final.noise, x, near=False)


def _implied(effect: Effect, without: Fit, after: Fit) -> Implied | None:
    """Return what the residuals say of the quantity that `effect` changes most; None where it changes none."""
    formulation = without.model.formulation
    data = formulation.data
    column = next((name for name in effect.columns if name in data and data[name].dtype.kind in "if"), None)
    alone = formulation.readings[0] if len(formulation.readings) == 1 else None  # no reading knows a quantity by itself
    quantity = alone if column is None and alone else _most_changed(effect, without)
    if quantity is None:
        return None
    error, weight = error_of(quantity, without)
    return Implied(effect, quantity, column, without, error, error_of(quantity, after)[0], weight)


def _most_changed(effect: Effect, at: Fit) -> str | None:
    """Return the quantity through which a unit of the effect moves the residuals most."""
    c = np.zeros(len(effect.coefficients))
    basis = effect.basis(at.at.recorded, at.model.formulation.data, c)
    if not len(c):  # what is fixed to the last has no slopes, only itself
        shift = effect.shift(at.at.recorded, at.model.formulation.data, c)
        basis = {name: change[:, None] for name, change in shift.items()}
    weight = {
        name: float(np.sum((at.at.slopes[name][:, :, None] * change[:, None, :]) ** 2))
        for name, change in basis.items()
        if name in at.at.slopes
    }
    return max(weight, key=lambda name: weight[name]) if weight and max(weight.values()) > 0 else None
