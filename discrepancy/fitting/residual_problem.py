"""A fitted model as a problem for the optimisers: whitened residuals over the fitting rows, in a box about the fit."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import final

import numpy as np

from calibench.discrepancy.fitting.fit import Fit, linearise, readings_of
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.problems.base import Array

_WIDTH = 50.0  # standard deviations to either side of the fit that the box of a coefficient reaches at least


@final
@dataclass(frozen=True, eq=False)
class ResidualProblem:
    """A model over its data; x holds free parameters and coefficients, `best` is the fit found.

    Residuals are divided by the noise that the readings leave in them, whitened where the fit ended.
    """

    model: Model
    fit: Fit

    @property
    def options(self) -> dict[str, object]:
        """Return what distinguishes this problem in a table of results: its data and the added effects."""
        return {"case": self.model.formulation.data.name, "names": list(self.names)}

    @property
    def data_id(self) -> str:
        """Return a digest of the readings and of the noise that they are divided by."""
        arrays = [readings_of(self.model), self.fit.at.sigma, np.array(self.fit.noise.scale), self.fit.x]
        return blake2b(b"".join(np.ascontiguousarray(part).tobytes() for part in arrays), digest_size=8).hexdigest()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the entries of x."""
        return self.model.names

    @property
    def best(self) -> Array:
        """Return the fitted x."""
        return self.fit.x

    @property
    def start(self) -> Array:
        """Return the nominal machine without effects."""
        return self.model.start

    @property
    def lower(self) -> Array:
        """Return the lower bounds."""
        return self._box()[0]

    @property
    def upper(self) -> Array:
        """Return the upper bounds."""
        return self._box()[1]

    def residuals(self, x: Array, /) -> Array:
        """Return the whitened residuals, shape (m,)."""
        return self.fit.at.whiten(np.asarray(self.model.residuals(x))) / self.fit.noise.scale

    def jacobian(self, x: Array, /) -> Array:
        """Return their derivative, shape (m, dim)."""
        return self.fit.at.whiten(self.model.jacobian(x)) / self.fit.noise.scale

    def __call__(self, x: Array, /) -> float:
        """Return the sum of squares of the residuals."""
        r = self.residuals(x)
        return float(r @ r)

    def predict(self, data: MeasuredData, x: Array | None = None) -> Array:
        """Return the whitened residuals of other rows, shape (n, c), in units of the stated noise."""
        return predicted(self.model, self.fit.x if x is None else x, data, Noise())

    def _box(self) -> tuple[Array, Array]:
        parameters = self.model.formulation.parameters
        reach = _WIDTH * np.sqrt(np.diag(self.fit.covariance()))
        lower, upper = np.minimum(self.start, self.fit.x) - reach, np.maximum(self.start, self.fit.x) + reach
        p = len(parameters)
        lower[:p] = np.minimum([q.lower for q in parameters], self.fit.x[:p])
        upper[:p] = np.maximum([q.upper for q in parameters], self.fit.x[:p])
        return lower, upper


def predicted(model: Model, x: Array, data: MeasuredData, noise: Noise) -> Array:
    """Return the residuals of `data` under a model at x, whitened by `noise` but for its scale, shape (n, c)."""
    there = Model(model.formulation.on(data), model.effects)
    readings = readings_of(there)
    at = linearise(there, noise, x, readings, readings)
    return at.whiten(at.misclosure).reshape(at.misclosure.shape)
