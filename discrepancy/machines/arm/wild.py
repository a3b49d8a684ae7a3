"""Readings that no calibration can explain (a lost target, a pose that was not reached) are left out, with a note.

The geometry is fitted with a smaller weight for readings that lie far out. Then a reading is wild if its residual, in
any component, is `_OUT` times the median one. Where there are many of them, they are no accidents, and all are kept.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.formulations.learned_noise import weighted_fit
from calibench.discrepancy.model.formulations.predicted import Predicted
from calibench.discrepancy.model.model import Model
from calibench.problems.base import Array

_OUT = 12.0  # times the middle size of what is left
_MOST = 0.03  # of the readings
_ROUNDS = 6
_HUBER = 2.0  # robust deviations
_MEDIAN = 0.6745


def without_wild(formulation: Predicted) -> Predicted:
    """Return the formulation without wild readings, and a note that tells them."""
    data = formulation.data
    fitted = np.asarray(data["split"]) != "hold" if "split" in data else np.ones(len(data), dtype=bool)
    if fitted.sum() * len(formulation.measured) < 2 * len(formulation.parameters):
        return formulation
    model = Model(formulation)
    x = robust(Model(formulation.on(data.rows(fitted))))
    size = np.abs(np.asarray(model.residuals(x)))
    size /= np.maximum(np.median(size[fitted], axis=0), 1e-300)
    wild = size.max(axis=1) > _OUT
    if not wild.any() or wild.mean() > _MOST:
        return formulation
    count, worst = int(wild.sum()), int(np.argmax(size.max(axis=1)))
    name = tuple(formulation.measured)[int(np.argmax(size[worst]))]
    note = (
        f"{count} wild reading{'s are' if count > 1 else ' is'} left out, more than {_OUT:g} times as far from the "
        f"calibrated arm as the middle one: the worst is {name} = {float(data[name][worst]):.6g}"
    )
    return formulation.on(data.rows(~wild).with_note(note))


def robust(model: Model) -> Array:
    """Return the parameters of a fit in which readings far out have small weight."""
    x = model.start
    weight = np.ones_like(np.asarray(model.residuals(x), dtype=float))
    for _ in range(_ROUNDS):
        x = weighted_fit(model, x, weight)
        left = np.abs(np.asarray(model.residuals(x)))
        spread = np.maximum(np.median(left, axis=0) / _MEDIAN, 1e-12)
        weight = np.sqrt(np.minimum(1.0, _HUBER * spread / np.maximum(left, 1e-300))) / spread
    return np.asarray(x)
