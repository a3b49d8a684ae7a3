"""`Model`: the constraints of a machine with effects added, over one set of data, with all derivatives.

The vector x holds the machine's free parameters, then the coefficients of each effect in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import Formulation, Numbers, Quantities
from calibench.discrepancy.model.roles import inputs_of
from calibench.problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class Model:
    """A machine's constraints with `effects` added.

    It is the identity extension: with all coefficients zero it is the machine itself.
    """

    formulation: Formulation
    effects: tuple[Effect, ...] = ()

    def with_effects(self, *effects: Effect) -> Model:
        """Return the model with `effects` added behind those it has."""
        return replace(self, effects=(*self.effects, *effects))

    @property
    def size(self) -> int:
        """Return the length of x: free parameters and coefficients."""
        return len(self.formulation.parameters) + sum(len(e.coefficients) for e in self.effects)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the entries of x; a coefficient's is led by its effect's."""
        own = tuple(p.name for p in self.formulation.parameters)
        return own + tuple(f"{e.family} {e.target}: {c}" for e in self.effects for c in e.coefficients)

    @property
    def start(self) -> Array:
        """Return the nominal machine without effects, shape (size,)."""
        x = np.zeros(self.size)
        x[: len(self.formulation.parameters)] = [p.start for p in self.formulation.parameters]
        return x

    def quantities(self, x: Array) -> tuple[dict[str, Numbers], dict[str, Numbers]]:
        """Return the quantities as recorded or nominal, and as the effects say they truly are."""
        q: dict[str, Numbers] = {name: np.asarray(value) for name, value in self.formulation.fixed.items()}
        q |= {p.name: np.asarray(value) for p, value in zip(self.formulation.parameters, x)}
        q |= {name: self.formulation.data[name] for name in (*inputs_of(self.formulation), *self.formulation.readings)}
        true = dict(q)
        for effect, c in self.coefficients(x):
            for name, change in effect.shift(q, self.formulation.data, c).items():
                true[name] = true[name] + change
        return q, true

    def residuals(self, x: Array) -> Numbers:
        """Return the constraints, shape (n, c), in the formulation's unit, free of noise that rows share."""
        return self.formulation.decorrelate(self.formulation.constraints(self.quantities(x)[1]))

    def jacobian(self, x: Array) -> Array:
        """Return the derivative of the residuals in x, shape (n, c, size)."""
        recorded, true = self.quantities(x)
        return self.jacobian_of(x, recorded, self.formulation.slopes(true))

    def jacobian_of(self, x: Array, recorded: dict[str, Numbers], slopes: dict[str, Array]) -> Array:
        """Return the derivative in x of what has these `slopes` at the quantities that are `recorded`."""
        own = np.stack([slopes[p.name] for p in self.formulation.parameters])  # column by column: rows may be many
        columns = [self.formulation.decorrelate(own.transpose(1, 2, 0))]
        columns += [signature(effect, c, recorded, slopes, self.formulation) for effect, c in self.coefficients(x)]
        return np.concatenate(columns, axis=2)

    def coefficients(self, x: Array) -> list[tuple[Effect, Array]]:
        at, pairs = len(self.formulation.parameters), []
        for effect in self.effects:
            pairs.append((effect, x[at : at + len(effect.coefficients)]))
            at += len(effect.coefficients)
        return pairs

    def place_of(self, effect: Effect) -> slice:
        """Return where the coefficients of an effect of that name stand in x; `LookupError` where there is none."""
        at = len(self.formulation.parameters)
        for one in self.effects:
            if name_of(one) == name_of(effect):
                return slice(at, at + len(one.coefficients))
            at += len(one.coefficients)
        raise LookupError(name_of(effect))


def signature(effect: Effect, c: Array, q: Quantities, slopes: dict[str, Array], formulation: Formulation) -> Array:
    """Return what a unit of each coefficient of `effect` leaves in the residuals, shape (n, c, k)."""
    basis = effect.basis(q, formulation.data, c)
    terms = [slopes[name][:, :, None] * change[:, None, :] for name, change in basis.items()]
    return formulation.decorrelate(np.asarray(sum(terms[1:], terms[0])))
