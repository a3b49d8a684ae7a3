"""`Model`: the constraints of a machine with effects added, over one set of data, with all derivatives, and its noise.

The vector x holds the machine's free parameters, then the coefficients of each effect in turn. Noise that nobody stated
is learned from residuals. The first estimate is from those of the machine without effects, so it is above the noise of
a column where an effect is missing; when effects are found, it is learned again from what they leave.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.special import chdtri

from calibench.core.by_value import by_value
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import Formulation, Numbers, Quantities
from calibench.discrepancy.model.measured import DataError, kinds_of
from calibench.discrepancy.model.roles import inputs_of, roles_of, unknown_noise_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton


@final
@dataclass(frozen=True, eq=False)
class Model:
    """A machine's constraints with `effects` added: with all coefficients zero it is the machine itself."""

    formulation: Formulation
    effects: tuple[Effect, ...] = ()
    __reduce__ = by_value

    def with_effects(self, *effects: Effect) -> Model:
        """Return the model with `effects` added behind those it has."""
        return replace(self, effects=(*self.effects, *effects))

    @property
    def size(self) -> int:
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

    def quantities(self, x: Array | None = None) -> tuple[dict[str, Numbers], dict[str, Numbers]]:
        """Return the quantities as recorded or nominal, and as the effects say they truly are, at x or at `start`."""
        x = self.start if x is None else x
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

    def jacobian_of(self, x: Array, recorded: Quantities, slopes: Mapping[str, Array]) -> Array:
        """Return the derivative in x of what has these `slopes` at the quantities that are `recorded`."""
        return self.formulation.decorrelate(self.raw_jacobian(x, recorded, slopes))

    def raw_jacobian(self, x: Array, recorded: Quantities, slopes: Mapping[str, Array]) -> Array:
        """Return the same of the constraints as they are, with the noise that rows share."""
        own = [slopes[p.name] for p in self.formulation.parameters]  # column by column: rows may be many
        data, effects = self.formulation.data, self.coefficients(x)
        more = [_left_by(effect.basis(recorded, data, c), slopes) for effect, c in effects]
        columns = np.stack(own).transpose(1, 2, 0) if own else np.zeros((*next(iter(slopes.values())).shape, 0))
        return np.concatenate([columns, *more], axis=2)

    def coefficients(self, x: Array) -> list[tuple[Effect, Array]]:
        return [(effect, x[place]) for effect, place in self._places()]

    def place_of(self, effect: Effect) -> slice:
        """Return where the coefficients of an effect of that name stand in x; `LookupError` where there is none."""
        for one, place in self._places():
            if name_of(one) == name_of(effect):
                return place
        raise LookupError(name_of(effect))

    def _places(self) -> Iterator[tuple[Effect, slice]]:
        at = len(self.formulation.parameters)
        for effect in self.effects:
            yield effect, slice(at, at + len(effect.coefficients))
            at += len(effect.coefficients)


def signature(effect: Effect, c: Array, q: Quantities, slopes: Mapping[str, Array], formulation: Formulation) -> Array:
    """Return what a unit of each coefficient of `effect` leaves in the residuals, shape (n, c, k)."""
    return signature_of(effect.basis(q, formulation.data, c), slopes, formulation)


def signature_of(changes: Mapping[str, Array], slopes: Mapping[str, Array], formulation: Formulation) -> Array:
    """Return what m changes of quantities, name -> (n, m), leave in the residuals, shape (n, c, m)."""
    return formulation.decorrelate(_left_by(changes, slopes))


def _left_by(changes: Mapping[str, Array], slopes: Mapping[str, Array]) -> Array:
    terms = [slopes[name][:, :, None] * change[:, None, :] for name, change in changes.items()]
    return np.asarray(sum(terms[1:], terms[0]))


_ROUNDS = 6  # of fitting and estimating, after which neither moves by what counts
_MEDIAN = 0.6744897501960817  # of the modulus of a standard Gaussian variable
_TOLD = 0.3675  # part of n values that tells the deviation by their squares as well as all n by their median modulus
_HUBER = 1.345  # deviations beyond which a residual pulls no harder
_SMALLEST = 1e-300  # that a noise may be, which is divided by
_STILL = 1e-5  # part of a sum of squares: a deviation changes by half of that
_LEAST = 1e-12  # part of the spread of a column that its noise is not below: sums of squares keep their digits


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def learned_noise(formulation: Formulation) -> dict[str, float]:
    """Return a standard deviation for each reading of unknown noise, each of which has a constraint of its own.

    The k-th constraint must be that of the k-th reading, as in a prediction. Held-out rows are not used. Raises
    `DataError` for a reading that never varies and has no residual: such rows contain no noise.
    """
    data = formulation.data
    data = data.rows(data.fitted) if data.has("split") and data.fitted.any() else data
    there = formulation.on(data)
    names, unknown = there.readings, unknown_noise_of(there)
    model = Model(there)
    x, n = model.start, len(data)
    sigma = {name: np.broadcast_to(np.asarray(there.sigma[name], dtype=float), n) for name in names}
    left = np.asarray(model.residuals(x))
    for _ in range(_ROUNDS):
        for k, name in enumerate(names):
            if name in unknown:
                sigma[name] = np.full(n, _spread(left[:, k], np.ptp(data[name]), len(x) / len(names)))
        scale = np.stack([sigma[name] for name in names], axis=-1)
        weight = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(np.abs(left / scale), 1e-300))) / scale
        x = weighted_fit(model, x, weight)
        left = np.asarray(model.residuals(x))
    found = noise_left(there, left, len(x))
    for name, deviation in found.items():
        first = float(data[name][0])
        if not np.ptp(data[name]) and deviation <= max(_LEAST * abs(first), _SMALLEST):
            rows = f"all {len(data)} fitted rows" if len(data) > 1 else "the only fitted row"
            raise DataError(
                f"{data.name}: {name} reads {first:g} in {rows}, which tells nothing of its noise; state the noise, or "
                "take readings that differ"
            )
    return found


def noise_left(formulation: Formulation, left: Array, spent: float) -> dict[str, float]:
    """Return a standard deviation for each reading of unknown noise, from the constraints `left` by a fit, (n, m).

    `spent` parameters were fitted; the k-th constraint must be that of the k-th reading. The columns of one instrument
    have one common noise, unless they differ more than by chance: from few rows an estimate is accurate to about a
    sixth.
    """
    names, unknown, n = formulation.readings, unknown_noise_of(formulation), len(formulation.data)
    each = spent / len(names)
    found = {
        name: _spread(left[:, k], np.ptp(formulation.data[name]), each)
        for k, name in enumerate(names)
        if name in unknown
    }
    # the columns of each instrument, as the roles have them and as the sensors' kinds do
    by_role = [one.columns for one in roles_of(formulation).instruments]
    for columns in [*by_role, *(tuple(one.column for one in kind) for kind in kinds_of(formulation.sensors))]:
        own = {name: found[name] for name in columns if name in found}
        if len(own) < 2:
            continue
        logs = np.log(list(own.values()))
        error = 1 / np.sqrt(2 * told_by_middle(n, each))  # of the logarithm of a deviation
        if np.sum((logs - logs.mean()) ** 2) <= error**2 * chdtri(len(logs) - 1, thresholds().noises_differ):
            found |= dict.fromkeys(own, float(np.exp(logs.mean())))
    return found


def relearned(formulation: Formulation, left: Array, spent: float) -> Formulation:
    """Return a formulation with its unknown noise estimated from the constraints `left`, (n, c), by a fit."""
    again = getattr(formulation, "relearned", None)  # of `Predicted`, and of what stands around it
    return formulation if again is None else again(left, spent)


def told_by_middle(n: int, spent: float) -> float:
    """Return the degrees of freedom that tell a noise as well as the median of n residuals of `spent` numbers."""
    return max(_TOLD * (n - spent), 1.0)


def weighted_fit(model: Model, x: Array, weight: Array) -> Array:
    """Return the least squares from x, each constraint times its weight, (n, c), to what a deviation is told by."""
    return gauss_newton(
        lambda x: (model.residuals(x) * weight).ravel(),
        lambda x: (model.jacobian(x) * weight[:, :, None]).reshape(weight.size, -1), x,
        rank_tolerance=1e-10, least_fall=_STILL,
    )  # fmt: skip


def _spread(values: Array, width: float, spent: float) -> float:
    """Return the deviation of values, (n,), of mean zero by their median modulus, `spent` parameters fitted to them."""
    n = len(values)
    middle = float(np.median(np.abs(values))) / _MEDIAN * np.sqrt(n / max(n - spent, 1.0))
    return float(max(middle, _LEAST * float(width), _SMALLEST))
