"""Score tests of very many readings: the same numbers from sums of products, without a row of what is left over.

With orthonormal Q for what calibration takes up, and columns D of unit length, (D - Q Q'D)'(D - Q Q'D) is
D'D - (Q'D)'(Q'D): what of a column is visible is known to rounding over its square, and the least that is kept,
2e-4, squared stands eight figures above that. Where each reading's noise is its own, a change of a quantity enters by
its slope, whitened and multiplied into Q and y once for all candidates: a sum then runs over readings, not constraints.
"""

from __future__ import annotations

from typing import final

import numpy as np

from discrepancy.effect import Effect
from discrepancy.fit import Fit
from discrepancy.model import trace
from problems.base import Array

_HELD = 6  # products with the targets that are kept: most candidates are of few quantities, and each is large


@final
class Sums:
    """The products of any candidate's whitened columns with each other and with `targets`, (N, t), at one fit."""

    def __init__(self, fit: Fit, targets: Array) -> None:
        self.fit, self.targets = fit, targets
        rows = fit.at.misclosure
        self._apart = fit.at.whiten.band is None and fit.at.model.formulation.decorrelate(rows) is rows
        self._white: dict[str, Array] = {}
        self._pulls: dict[str, Array] = {}
        self._pairs: dict[tuple[str, str], Array] = {}

    def of(self, effect: Effect) -> tuple[Array, Array]:
        """Return D'D, (k, k), and targets'D, (t, k), of the columns D of a unit of each coefficient."""
        at, zero = self.fit.at, np.zeros(len(effect.coefficients))
        formulation = at.model.formulation
        if not self._apart:
            D = at.whiten(trace(effect, zero, at.recorded, at.slopes, formulation))
            return D.T @ D, self.targets.T @ D
        basis = {name: np.asarray(b) for name, b in effect.basis(at.recorded, formulation.data, zero).items()}
        square, across = np.zeros((len(zero), len(zero))), np.zeros((self.targets.shape[1], len(zero)))
        for one, change in basis.items():
            across += self._pull(one).T @ change
            for other, beside in basis.items():
                square += change.T @ (self._pair(one, other)[:, None] * beside)
        return square, across

    def _slope(self, name: str) -> Array:
        if name not in self._white:
            slope = self.fit.at.slopes[name]
            self._white[name] = self.fit.at.whiten(slope).reshape(slope.shape)
        return self._white[name]

    def _pull(self, name: str) -> Array:
        """Return what a change of a quantity at each reading adds to the products with the targets, (n, t)."""
        pull = self._pulls.pop(name, None)
        if pull is None:
            slope = self._slope(name)
            pull = np.einsum("nc,nct->nt", slope, self.targets.reshape(*slope.shape, -1))
            if len(self._pulls) >= _HELD:
                del self._pulls[next(iter(self._pulls))]
        self._pulls[name] = pull  # the last in line to go
        return pull

    def _pair(self, one: str, other: str) -> Array:
        """Return what changes of two quantities at each reading add to their product, (n,)."""
        if (one, other) not in self._pairs:
            pair = np.einsum("nc,nc->n", self._slope(one), self._slope(other))
            self._pairs[one, other] = self._pairs[other, one] = pair
        return self._pairs[one, other]
