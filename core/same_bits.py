"""Functions of angles with the same bits on every processor: those of the C library, number by number.

NumPy's own take other code where a processor has wider registers (AVX-512), and differ there in the last bit. Readings
that are simulated decide the id of a run, so they have to be the same on every node of a cluster.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def cos(x: ArrayLike) -> NDArray[np.float64]:
    """Return the cosine of angles [rad], of their shape.

    >>> cos([0.0, 1.0]).tolist()
    [1.0, 0.5403023058681398]
    """
    return _each(math.cos, x)


def sin(x: ArrayLike) -> NDArray[np.float64]:
    """Return the sine of angles [rad], of their shape."""
    return _each(math.sin, x)


def arccos(x: ArrayLike) -> NDArray[np.float64]:
    """Return the angles [rad] whose cosines are x, of its shape; NaN beyond -1 and 1."""
    return _each(lambda value: math.acos(value) if -1 <= value <= 1 else math.nan, x)


def arctan2(y: ArrayLike, x: ArrayLike) -> NDArray[np.float64]:
    """Return the angles [rad] of points (x, y), of the shape that these have together."""
    return _each(math.atan2, y, x)


def _each(of: Callable[..., float], *arrays: ArrayLike) -> NDArray[np.float64]:
    values: Any = np.frompyfunc(of, len(arrays), 1)(*(np.asarray(array, dtype=float) for array in arrays))
    return np.asarray(values, dtype=float)
