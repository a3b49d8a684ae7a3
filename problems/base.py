"""What a problem is: a box, a start, and a number for every point of the box.

A problem needs only `lower`, `upper`, `start` and a call; everything else (residuals, Jacobian, batch, truth, figures
of merit) is extra that an optimiser or a table may use where it is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bedrock.registry import Registry

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown: its name, unit, start, bounds, and its true value where that is known."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    true: float | None = None


class Problem(Protocol):
    """The least that can be optimised: minimise ``problem(x)`` over ``lower <= x <= upper``, arrays of shape (dim,)."""

    @property
    def lower(self) -> Array: ...
    @property
    def upper(self) -> Array: ...
    @property
    def start(self) -> Array: ...
    def __call__(self, x: Array, /) -> float: ...


class Calibration(Problem, Protocol):
    """A calibration problem: a sum of squared residuals, ``problem(x) == r @ r`` with ``r = problem.residuals(x)``.

    `parameters` are the physical unknowns; `coordinates` are what the vector x holds (the same but for J3, which
    searches l_a cos z and l_a sin z in place of l_a and z).
    """

    @property
    def name(self) -> str: ...
    @property
    def options(self) -> Mapping[str, Any]: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def coordinates(self) -> tuple[Parameter, ...]: ...
    @property
    def truth(self) -> Array | None: ...
    def residuals(self, x: Array, /) -> Array: ...
    def jacobian(self, x: Array, /) -> Array: ...
    def batch(self, points: Array, /) -> Array: ...
    def physical(self, x: Array, /) -> Array: ...
    def merit(self, x: Array, /) -> dict[str, float]: ...


registry: Registry[Problem] = Registry(kind="problem", group="calibench.problems")
