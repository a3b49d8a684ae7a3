"""`Constraints`: a ready-made formulation, for a machine of which its author writes the constraints and nothing else.

    def formulate(self, data):
        return Constraints(data, closure, PARAMETERS, {"enc_1": 2e-5, "x": 0.02})

`closure(q)` takes quantities by name and returns what vanishes on a perfect machine, shape (n, c). Slopes are taken by
complex step, so it must be analytic: no `abs`, no `np.linalg.norm`, no comparison of quantities; `np.hypot` and
`np.arctan2` know no complex numbers either (write `np.sqrt(x**2 + y**2)`, and closures without angles of vectors).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from discrepancy.data import DataError, MeasuredData
from discrepancy.machine import Numbers, Quantities, complex_step_slopes
from problems.base import Array, Parameter

_BOOKKEEPING = ("pose_id", "visit_id", "repeat", "reading_place", "valid")


@final
@dataclass(frozen=True, eq=False)
class Constraints:
    """A `Formulation` from a function: `closure(q)` -> (n, c), in `unit`.

    `noise` is the stated standard deviation of each column that carries noise, in the order they are read. `held` are
    numbers of the machine that are not calibrated. Raises `DataError` for a column that is missing or not finite.
    """

    data: MeasuredData
    closure: Callable[[Quantities], Numbers]
    parameters: tuple[Parameter, ...]
    noise: Mapping[str, float]
    held: Mapping[str, float] = field(default_factory=dict)
    unit: str = "mm"

    def __post_init__(self) -> None:
        for name, sigma in self.noise.items():
            if not np.isfinite(np.asarray(self.data[name], dtype=float)).all():
                raise DataError(f"{self.data.name}: column {name} holds what is no finite number; leave those rows out")
            if not sigma > 0:
                raise DataError(f"noise of {name}: {sigma:g}; a standard deviation above 0 is needed")

    @property
    def fixed(self) -> Mapping[str, float]:
        """Return the numbers that are held."""
        return self.held

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the columns that carry noise."""
        return tuple(self.noise)

    @property
    def sigma(self) -> Mapping[str, float]:
        """Return their stated standard deviations."""
        return self.noise

    def constraints(self, q: Quantities) -> Numbers:
        """Return the constraints, shape (n, c); raise `DataError` for a closure of another shape."""
        rows = np.asarray(self.closure(q))
        if rows.ndim != 2 or len(rows) != len(self.data):
            raise DataError(
                f"closure(q) returned shape {rows.shape}: {len(self.data)} rows, a column a constraint, are needed; "
                "np.stack([...], axis=-1) makes them"
            )
        return rows

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, c), by complex step."""
        return complex_step_slopes(self, q)

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows` as they are: each reading has noise of its own."""
        return rows

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return for each reading every column of numbers that varies: what its error may smoothly depend on."""
        columns = {
            name: np.asarray(column, dtype=float)
            for name, column in self.data.columns.items()
            if name not in _BOOKKEEPING and column.dtype.kind in "if" and np.ptp(column) > 0
        }
        return {name: columns for name in self.noise}

    def on(self, data: MeasuredData) -> Constraints:
        """Return the same constraints over other rows."""
        return replace(self, data=data)
