"""What the search needs of a kind of machine: its quantities, the constraints between them, and their noise.

A *quantity* is a named number of every reading: what a sensor said (`enc_1`), or a parameter of the machine (`la1`).
A perfect machine read without noise makes its constraints vanish, row by row. Everything else follows by the chain
rule from the slopes of the constraints in the quantities: the calibration Jacobian, the variance that noise in the
readings leaves in the residuals, and the signature that an effect leaves there, for an effect is a change of
quantities.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.problems.base import Array, Parameter

Numbers = NDArray[Any]  # of floats, or of complex numbers where a test takes a complex step
Quantities = Mapping[str, Numbers]  # name -> (n,), or () where it is the same for every reading

WORKSPACE = "workspace"  # the target whose covariates are where the tool stands, x and y [mm]


class Formulation(Protocol):
    """The constraints that one set of data of one machine supports (angles only; angles with a tracker; ...).

    `parameters` are free; every other number is in `fixed`. `readings` are the columns that carry noise, `sigma` its
    stated standard deviation, a number or (n,) each, and `sensors` the instruments that fill them, in the same order.
    """

    @property
    def data(self) -> MeasuredData: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def fixed(self) -> Mapping[str, float]: ...
    @property
    def readings(self) -> tuple[str, ...]: ...
    @property
    def sensors(self) -> tuple[Sensor, ...]: ...
    @property
    def sigma(self) -> Mapping[str, Array | float]: ...
    @property
    def unit(self) -> str:
        """Return the unit of the constraints."""
        ...

    def constraints(self, q: Quantities) -> Numbers:
        """Return the constraints, shape (n, c), at the quantities `q`: zero on a perfect machine without noise."""
        ...

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, c)."""
        ...

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows`, shape (n, ...), mixed along the first axis so that noise shared by readings is shared no more.

        Where each row's noise is its own, `rows` as they are; it must be linear. `Model` passes residuals, Jacobian
        and signatures through it, so that after it the stated `sigma` is that of independent rows.
        """
        ...

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return target -> covariate -> (n,): what a smooth disagreement may depend on.

        A target is a reading or one of the targets that `sensors` state; `WORKSPACE` has the coordinates of the place.
        """
        ...

    def on(self, data: MeasuredData) -> Formulation:
        """Return the same constraints over other rows (a held-out part, a resampled set)."""
        ...


class Machine(Protocol):
    """A kind of robot: validates its data and states the constraints they support."""

    @property
    def name(self) -> str: ...

    def formulate(self, data: MeasuredData) -> Formulation:
        """Return the constraints that `data` support; raise `DataError` for data that cannot be of this machine."""
        ...


def complex_step_slopes(formulation: Formulation, q: Quantities) -> dict[str, Array]:
    """Return the slopes by complex step, exact to rounding: for a machine whose author wrote none, and for tests.

    The constraints must be analytic: no `abs`, no `np.linalg.norm`, no comparison of quantities.
    """
    step = 1e-30
    return {name: np.imag(formulation.constraints({**q, name: value + 1j * step})) / step for name, value in q.items()}
