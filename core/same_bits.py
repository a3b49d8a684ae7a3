"""Functions of angles with the same bits on every processor: those of the C library, number by number.

NumPy's own take other code where a processor has wider registers (AVX-512), and differ there in the last bit. Readings
that are simulated decide the id of a run, so they have to be the same on every node of a cluster.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def _each(of: Callable[..., float], *arrays: ArrayLike) -> NDArray[np.float64]:
    values: Any = np.frompyfunc(of, len(arrays), 1)(*(np.asarray(array, dtype=float) for array in arrays))
    return np.asarray(values, dtype=float)


cos, sin = partial(_each, math.cos), partial(_each, math.sin)  # of angles [rad], of their shape
# the angles [rad] whose cosines are x, of its shape; NaN beyond -1 and 1
arccos = partial(_each, lambda value: math.acos(value) if -1 <= value <= 1 else math.nan)
arctan2 = partial(_each, math.atan2)  # (y, x): the angles [rad] of points, of the shape that y and x have together
