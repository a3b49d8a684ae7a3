"""NIST's models: which data set has which formula, how its readings are taken, and the slopes of any of them.

A model takes the parameters `b`, shape (dim,), and the predictors `x`, shape (k, m), and returns shape (m,). Formulas
are those that NIST prints with the data.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np

from calibench.problems.base import Array

_STEP = 1e-30  # along the imaginary axis: its square is below rounding beside any parameter


@final
@dataclass(frozen=True)
class Model:
    """A regression: ``value(b, x)``, shape (m,), is fitted to ``response(y)``."""

    value: Callable[[Array, Array], Array]
    response: Callable[[Array], Array] = np.asarray

    def slopes(self, b: Array, x: Array) -> Array:
        """Return the derivative by each parameter, shape (m, dim), to rounding; NaN where the value is not finite.

        They are complex steps, ``Im f(b + ih) / h`` (Squire and Trapp 1998), which subtract nothing: so a formula has
        to hold for complex parameters.
        """
        steps = b + 1j * _STEP * np.eye(len(b))
        slopes = np.stack([np.imag(self.value(one, x)) / _STEP for one in steps], axis=1)
        return np.where(np.isfinite(self.value(b, x))[:, None], slopes, np.nan)


def _richards(b: Array, x: Array) -> Array:
    """Return b1 / (1 + exp(b2 - b3 x))^(1/b4), which exp(1000) must not spoil."""
    z = b[1] - b[2] * x[0]
    away = np.where(z.real > 0, z, -z)
    log = np.where(z.real > 0, z, 0) + np.log1p(np.exp(-away))
    return np.asarray(b[0] * np.exp(-log / b[3]))


def _fraction(degree: int, b: Array, x: Array) -> Any:
    """Return a polynomial of `degree` over one whose constant is 1."""
    above, below = b[degree] + 0 * x[0], b[-1] + 0 * x[0]
    for k in range(degree - 1, -1, -1):  # Horner
        above = above * x[0] + b[k]
        below = below * x[0] + (b[degree + k] if k else 1.0)
    return above / below


def _three_cycles(b: Array, x: Array) -> Array:
    """Return b1 and three cycles, of 12, b4 and b7 months."""
    value = b[0] + 0 * x[0]
    for period, cosine, sine in ((12.0, b[1], b[2]), b[3:6], b[6:9]):
        angle = 2 * np.pi * x[0] / period
        value = value + cosine * np.cos(angle) + sine * np.sin(angle)
    return np.asarray(value)


_saturation = Model(lambda b, x: b[0] * -np.expm1(-b[1] * x[0]))
_damped_fraction = Model(lambda b, x: np.exp(-b[0] * x[0]) / (b[1] + b[2] * x[0]))
_decays = Model(lambda b, x: b[0] * np.exp(-b[1] * x[0]) + b[2] * np.exp(-b[3] * x[0]) + b[4] * np.exp(-b[5] * x[0]))
_peaks = Model(
    lambda b, x: (
        b[0] * np.exp(-b[1] * x[0])
        + b[2] * np.exp(-((x[0] - b[3]) ** 2) / b[4] ** 2)
        + b[5] * np.exp(-((x[0] - b[6]) ** 2) / b[7] ** 2)
    )
)
_quadratics, _cubics = Model(partial(_fraction, 2)), Model(partial(_fraction, 3))

MODELS = {
    "Misra1a": _saturation,
    "Chwirut2": _damped_fraction,
    "Chwirut1": _damped_fraction,
    "Lanczos3": _decays,
    "Gauss1": _peaks,
    "Gauss2": _peaks,
    "DanWood": Model(lambda b, x: b[0] * x[0] ** b[1]),
    "Misra1b": Model(lambda b, x: b[0] * (1 - (1 + b[1] * x[0] / 2) ** -2)),
    "Kirby2": _quadratics,
    "Hahn1": _cubics,
    "Nelson": Model(lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]), response=np.log),
    "MGH17": Model(lambda b, x: b[0] + b[1] * np.exp(-x[0] * b[3]) + b[2] * np.exp(-x[0] * b[4])),
    "Lanczos1": _decays,
    "Lanczos2": _decays,
    "Gauss3": _peaks,
    "Misra1c": Model(lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x[0]) ** -0.5)),
    "Misra1d": Model(lambda b, x: b[0] * b[1] * x[0] / (1 + b[1] * x[0])),
    "Roszman1": Model(lambda b, x: b[0] - b[1] * x[0] - np.arctan(b[2] / (x[0] - b[3])) / np.pi),
    "ENSO": Model(_three_cycles),
    "MGH09": Model(  # Kowalik and Osborne 1978
        lambda b, x: b[0] * (x[0] ** 2 + x[0] * b[1]) / (x[0] ** 2 + x[0] * b[2] + b[3])
    ),
    "Thurber": _cubics,
    "BoxBOD": _saturation,
    "Rat42": Model(lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x[0]))),
    "MGH10": Model(lambda b, x: b[0] * np.exp(b[1] / (x[0] + b[2]))),  # Meyer 1970
    "Eckerle4": Model(lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x[0] - b[2]) / b[1]) ** 2)),
    "Rat43": Model(_richards),
    "Bennett5": Model(lambda b, x: b[0] * (b[1] + x[0]) ** (-1 / b[2])),
}
