"""Score tests of very many readings: the same numbers from sums of products, so that no full matrix is stored.

With orthonormal Q for what calibration absorbs, and columns D of unit length, (D - Q Q'D)'(D - Q Q'D) is D'D -
(Q'D)'(Q'D). Its relative error is rounding over the square of the visible part; the smallest part that is kept is 2e-4,
whose square is eight decimal orders above rounding. Where each reading's noise is independent, a change of a quantity
enters by its slope, whitened and multiplied into Q and y once for all candidates; so a sum runs over readings, not
constraints. A change from some reading on is a sum from there to the end, so that a scan for its place costs one pass.
Where noise is correlated between readings, the readings after the change are whitened again until the readings before
the change have no influence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.change_point import ChangePoint
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.model import signature
from calibench.problems.base import Array

_HELD = 6  # products with the targets that are kept: most candidates are of few quantities, and each is large
_NEXT = 64  # readings after a change that are whitened anew, and twice as many until it is forgotten
_FORGOTTEN = 1e-10
_TOGETHER = 200_000  # numbers of a signature that are multiplied at once: a processor's cache holds them


@final
class Sums:
    """The products of any candidate's whitened columns with each other and with `targets`, (N, t), at one fit."""

    def __init__(self, fit: Fit, targets: Array) -> None:
        self.fit, self.targets = fit, targets
        rows = fit.at.misclosure
        data = fit.at.model.formulation.data
        plain = fit.at.model.formulation.decorrelate(rows) is rows
        self._apart = plain and fit.at.whiten.band is None
        self._clock = np.asarray(data["t_s"]) if plain and data.has("t_s") else np.empty(0)
        if np.any(np.diff(self._clock) < 0):
            self._clock = np.empty(0)
        self._ends: dict[tuple[str, ...], Array] = {}
        self._white: dict[str, Array] = {}
        self._pulls: dict[str, Array] = {}
        self._pairs: dict[tuple[str, str], Array] = {}

    def of(self, effects: Sequence[Effect]) -> list[tuple[Array, Array]]:
        """Return D'D, (k, k), and targets'D, (t, k), of each effect's columns D of a unit of each coefficient.

        Effects that change the same quantities are multiplied together.
        """
        at = self.fit.at
        found: list[tuple[Array, Array]] = [(np.empty(0), np.empty(0))] * len(effects)
        alike: dict[tuple[object, ...], dict[int, Mapping[str, Array]]] = {}

        def multiply(some: dict[int, Mapping[str, Array]]) -> None:
            for place, products in zip(some, self._of_readings(list(some.values()))):
                found[place] = products
            some.clear()

        for place, effect in enumerate(effects):
            if isinstance(effect, ChangePoint) and len(self._clock):
                square, across = self._from(effect.quantities, int(np.searchsorted(self._clock, effect.at)))
                found[place] = square * np.outer(effect.ones, effect.ones), across * effect.ones
                continue
            zero, formulation = np.zeros(len(effect.coefficients)), at.model.formulation
            if not self._apart:
                D = at.whiten(signature(effect, zero, at.recorded, at.slopes, formulation))
                found[place] = D.T @ D, self.targets.T @ D
                continue
            basis = effect.basis(at.recorded, formulation.data, zero)
            some = alike.setdefault((*basis, len(zero)), {})
            some[place] = basis
            if len(some) * len(zero) * len(at.misclosure) >= _TOGETHER:
                multiply(some)
        for some in alike.values():
            multiply(some)
        return found

    def _of_readings(self, bases: Sequence[Mapping[str, Array]]) -> list[tuple[Array, Array]]:
        """Return the products of some effects' columns from their changes, (n, k), of the same quantities."""
        if not bases:
            return []
        changes = {name: np.stack([np.asarray(basis[name]).T for basis in bases]) for name in bases[0]}
        K, k, n = next(iter(changes.values())).shape
        square, across = np.zeros((K, k, k)), np.zeros((K * k, self.targets.shape[1]))
        for one, change in changes.items():
            across += change.reshape(K * k, n) @ self._pull(one)
            for other, beside in changes.items():
                square += change @ (self._pair(one, other) * beside).transpose(0, 2, 1)
        return list(zip(square, across.reshape(K, k, -1).transpose(0, 2, 1)))

    def _from(self, names: Sequence[str], start: int) -> tuple[Array, Array]:
        """Return the products of columns that are quantities' slopes from reading `start` on."""
        n = len(self._clock)
        near = start if self._apart else min(start + _NEXT, n)
        while near < n and not all(self._forgotten(name, start, near) for name in names):
            near = min(start + 2 * (near - start), n)
        square = np.array([[self._end(a, b)[near] for b in names] for a in names])
        across = np.stack([self._end(name)[near] for name in names], axis=-1)
        if near > start:
            anew = np.stack([self._anew(name, start, near).ravel() for name in names], axis=-1)
            there = self.targets.reshape(n, -1, self.targets.shape[1])[start:near].reshape(len(anew), -1)
            square, across = square + anew.T @ anew, across + there.T @ anew
        return square, across

    def _anew(self, name: str, start: int, stop: int) -> Array:
        """Return the whitened slope of readings `start` to `stop`, (m, c), as if no reading came before `start`."""
        slope = self.fit.at.slopes[name][start:stop]
        return self.fit.at.whiten.of(slice(start, stop), slope.shape[1])(slope).reshape(slope.shape)

    def _forgotten(self, name: str, start: int, near: int) -> bool:
        """Return whether the transient of whitening that begins at `start` has decayed at reading `near`."""
        if near == start:
            return True
        anew = self._anew(name, start, near)
        return bool(np.all(np.abs(anew[-1] - self._slope(name)[near - 1]) <= _FORGOTTEN * np.abs(anew).max()))

    def _end(self, *names: str) -> Array:
        """Return the sums from each reading to the end, (n + 1, ...): of a pull, or of a pair."""
        if names not in self._ends:
            terms = self._pull(*names) if len(names) == 1 else self._pair(*names)
            ends = np.zeros((len(terms) + 1, *terms.shape[1:]))
            np.cumsum(terms[::-1], axis=0, out=ends[-2::-1])
            self._ends[names] = ends
        return self._ends[names]

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
        self._pulls[name] = pull  # used last, so it is dropped last
        return pull

    def _pair(self, one: str, other: str) -> Array:
        """Return what changes of two quantities at each reading add to their product, (n,)."""
        if (one, other) not in self._pairs:
            pair = np.einsum("nc,nc->n", self._slope(one), self._slope(other))
            self._pairs[one, other] = self._pairs[other, one] = pair
        return self._pairs[one, other]
