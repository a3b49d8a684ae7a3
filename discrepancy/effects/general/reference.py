"""The temperature at which an effect of temperature is zero: the thermometer's own zero, or the mean of the run.

A column in degrees Celsius is far from its zero. The calibrated zero of a joint, or a length, would then be that of the
machine at 0 °C, which nobody has seen and which its bounds do not allow for. Counted from the mean of the run the model
is the same, and the calibrated value is that of the machine at that mean temperature. A number that is held is known
for one temperature, so its column must be relative to that temperature, and stays as it is.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.model import Model

_ROWS = 500  # rows that are used, evenly over the run
_SAME = 1e-8  # part of a signature: what is left of one that calibration absorbs is rounding


def reference_of(formulation: Formulation, column: str, quantity: str) -> float:
    """Return the temperature in `column` that counts as zero for `quantity`: the mean of the run, or 0.

    It is the mean where no reading is near 0 and calibration finds a constant error of the quantity by itself.
    """
    values = np.asarray(formulation.data[column], dtype=float)
    if values.min() <= 0.0 <= values.max() or not _is_absorbed(formulation, quantity):
        return 0.0
    return float(values.mean())


def _is_absorbed(formulation: Formulation, quantity: str) -> bool:
    """Tell whether the calibrated parameters can imitate a constant error of `quantity` in all rows."""
    if quantity in {p.name for p in formulation.parameters}:
        return True
    count = len(formulation.data)
    some = formulation
    if count > _ROWS:
        some = formulation.on(formulation.data.rows(np.linspace(0, count - 1, _ROWS).astype(int)))
    model = Model(some)
    slopes = some.slopes(model.quantities(model.start)[0])
    error = np.asarray(slopes[quantity], dtype=float).ravel()
    own = np.stack([np.asarray(slopes[p.name], dtype=float).ravel() for p in some.parameters], axis=-1)
    length = np.linalg.norm(own, axis=0)
    own = own[:, length > 0] / length[length > 0]
    rest = error - own @ np.linalg.lstsq(own, error, rcond=1e-12)[0]
    return bool(np.linalg.norm(rest) <= _SAME * np.linalg.norm(error))
