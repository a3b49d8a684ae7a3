"""The noise of a night that nobody states, estimated from the residuals of the richest model of a mount.

That model has all terms of the field, and a slow change with time and with the place as far as the number of stars
allows. So it explains what any single effect could explain, and some more. Its residuals are noise, apart from errors
that no smooth model of a mount describes. An estimate from the residuals of the index errors alone would be ten times
as large, and would hide the terms that cause it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibench.discrepancy.machines.mount.validate import FRAME
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.model import Model
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton

_SHARE = 0.35  # of the residuals that the richest model may spend on its numbers
_WILD = 5.0  # robust deviations beyond which a star was misidentified
_MEDIAN = 0.6744897501960817  # of the modulus of a standard Gaussian variable
_ALIKE = 1e-4  # relative size below which a direction of the terms is none: names of one signature


def left_by_all(formulation: Formulation, effects: Sequence[Effect]) -> float:
    """Return the standard deviation of an error on the sky, of either component, in a fit with all `effects` together.

    One value for both components, because one eye sees them; the field's rms on the sky is sqrt(2) times it. Held-out
    rows are not used.
    """
    data = formulation.data
    if data.has("split"):
        formulation = formulation.on(data.rows(np.asarray(data["split"]) != "hold"))
    base = Model(formulation)
    rich = base.with_effects(*effects)
    x = _fitted(base, base.start)
    columns = rich.jacobian(np.concatenate([x, np.zeros(rich.size - base.size)]))
    if rich.size <= _SHARE * columns.shape[0] * columns.shape[1]:
        x = _fitted(rich, np.concatenate([x, np.zeros(rich.size - base.size)]))
        columns = rich.jacobian(x)
        left = np.asarray(rich.residuals(x))
    else:
        left, columns = np.asarray(base.residuals(x)), base.jacobian(x)
    for more in (_slow(formulation), _map(formulation)):
        wider = np.concatenate([columns, more], axis=2)
        if wider.shape[2] <= _SHARE * left.size:
            columns = wider
    flat = columns.reshape(left.size, -1)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    rank = int(np.linalg.matrix_rank(flat, tol=_ALIKE * np.sqrt(flat.shape[1])))
    left = left - (flat @ np.linalg.lstsq(flat, left.ravel(), rcond=_ALIKE)[0]).reshape(left.shape)
    return float(np.sqrt(np.mean([_spread(left[:, k], rank / left.shape[1]) ** 2 for k in range(left.shape[1])])))


def _fitted(model: Model, x: Array) -> Array:
    return gauss_newton(
        lambda x: model.residuals(x).ravel(), lambda x: model.jacobian(x).reshape(-1, model.size), x,
        rank_tolerance=_ALIKE,
    )  # fmt: skip


def _slow(formulation: Formulation) -> Array:
    """Return a cubic of the order of the stars in each component, (n, m, 3m)."""
    n, m = len(formulation.data), len(formulation.readings)
    order = np.asarray(formulation.data["t_s"]) if formulation.data.has("t_s") else np.arange(n)
    t = 2 * (order - order.min()) / max(float(np.ptp(order)), 1e-300) - 1
    return _each(np.stack([t, t**2, t**3], axis=1), m)


def _map(formulation: Formulation) -> Array:
    """Return waves over the sky in each component, (n, m, k)."""
    first, second = (np.asarray(formulation.data[name]) for name in FRAME)
    waves = [
        f(k * first + j * second) for k in (0, 1, 2) for j in (-1, 0, 1) if (k, j) > (0, 0) for f in (np.sin, np.cos)
    ]
    return _each(np.stack(waves, axis=1), len(formulation.readings))


def _each(columns: Array, m: int) -> Array:
    return np.concatenate([np.eye(m)[k][None, :, None] * columns[:, None, :] for k in range(m)], axis=2)


def _spread(left: Array, spent: float) -> float:
    """Return the rms of residuals (n,) without wild ones, for a fit of `spent` numbers."""
    core = float(np.median(np.abs(left))) / _MEDIAN
    kept = left[np.abs(left) <= _WILD * max(core, 1e-12)]
    return float(np.sqrt(np.sum(kept**2) / max(len(kept) - spent, 1.0)))
