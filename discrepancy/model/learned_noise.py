"""Estimates of noise that nobody stated: from residuals, robustly.

The first estimate is from the residuals of the machine without effects. These also contain missing effects, so the
estimate of a column is above its noise where an effect is missing there. A search starts with it; when effects are
found, the noise is learned again from what they leave.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import DataError, kinds_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import roles_of, unknown_noise_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton

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
    if data.has("split"):
        fitted = np.asarray(data["split"]) != "hold"
        data = data.rows(fitted) if fitted.any() else data
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

    `spent` parameters were fitted. The k-th constraint must be that of the k-th reading.
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
        found |= _pooled({name: found[name] for name in columns if name in found}, n, each)
    return found


def relearned(formulation: Formulation, left: Array, spent: float) -> Formulation:
    """Return a formulation with its unknown noise estimated from the constraints `left`, (n, c), by a fit.

    `spent` parameters were fitted. One that cannot learn its noise again is returned as it is.
    """
    again = getattr(formulation, "relearned", None)  # of `Predicted`, and of what stands around it
    return formulation if again is None else again(left, spent)


def _pooled(found: dict[str, float], n: int, spent: float) -> dict[str, float]:
    """Return one common noise for the columns of one instrument; each its own where they differ more than by chance.

    From few rows, each estimate is accurate to about a sixth. Tests that compare explained with remaining squares take
    all residuals to have equal variance; a column whose noise is estimated too small by chance would then show false
    effects.
    """
    if len(found) < 2:
        return found
    logs = np.log(list(found.values()))
    error = 1 / np.sqrt(2 * told_by_middle(n, spent))  # of the logarithm of a deviation
    if np.sum((logs - logs.mean()) ** 2) > error**2 * chdtri(len(logs) - 1, thresholds().noises_differ):
        return found
    return dict.fromkeys(found, float(np.exp(logs.mean())))


def told_by_middle(n: int, spent: float) -> float:
    """Return the degrees of freedom that are equivalent to a noise estimate by the median of n residuals.

    `spent` numbers were fitted to them. The lack of fit of the same residuals is compared with that noise; without this
    number, chance would look like misfit.
    """
    return max(_TOLD * (n - spent), 1.0)


def weighted_fit(model: Model, x: Array, weight: Array) -> Array:
    """Return the least squares from x, each constraint times its weight, (n, c), to what a deviation is told by."""
    return gauss_newton(
        lambda x: (model.residuals(x) * weight).ravel(),
        lambda x: (model.jacobian(x) * weight[:, :, None]).reshape(weight.size, -1),
        x,
        rank_tolerance=1e-10,
        least_fall=_STILL,
    )


def _spread(values: Array, width: float, spent: float) -> float:
    """Return the deviation of values, (n,), of mean zero by their median modulus, `spent` parameters fitted to them."""
    n = len(values)
    middle = float(np.median(np.abs(values))) / _MEDIAN * np.sqrt(n / max(n - spent, 1.0))
    return float(max(middle, _LEAST * float(width), _SMALLEST))
