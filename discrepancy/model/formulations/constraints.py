"""`Constraints`: a ready-made formulation, for a machine of which its author writes the constraints and nothing else.

    def formulate(self, data):
        return Constraints(data, closure, PARAMETERS, {"enc_1": 2e-5, "x": 0.02})

`closure(q)` takes quantities by name and returns what vanishes on a perfect machine, shape (n, c). Slopes are taken by
complex step, so it must be analytic: no `abs`, no `np.linalg.norm`, no comparison of quantities, no `np.hypot` nor
`np.arctan2`. A few rows are compared with differences at the start, for a modulus would be wrong in silence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from calibench.discrepancy.model.formulations.slopes import check_slopes
from calibench.discrepancy.model.machine import Numbers, Quantities, complex_step_slopes
from calibench.discrepancy.model.measured.complete import complete, without_gaps
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.roles import Roles, columns_of, directions_of, refuse_word
from calibench.problems.base import Array, Parameter

BOOKKEEPING = ("pose_id", "visit_id", "repeat", "reading_place", "valid", "block")


@final
@dataclass(frozen=True, eq=False)
class Constraints:
    """A `Formulation` from a function: `closure(q)` -> (n, c), in `unit`.

    `noise` is the stated standard deviation of each column that carries noise, in the order they are read; `inputs` are
    columns without noise, which effects may change. `held` are numbers of the machine that are not calibrated.
    `instruments` tell of columns in `noise` what `Sensor` says; of one that is not told of, its name is all that is
    known, and it is taken for one kind with those of the same noise.
    `roles` say what it is made of: the general families of effects ask for them.
    Rows with a cell that holds no number are left out, with a note. Raises `DataError` for a column that is missing, a
    name used twice, or one that `closure` asks for and nothing states.
    """

    data: MeasuredData
    closure: Callable[[Quantities], Numbers]
    parameters: tuple[Parameter, ...]
    noise: Mapping[str, float]
    held: Mapping[str, float] = field(default_factory=dict)
    unit: str = "mm"
    instruments: tuple[Sensor, ...] = ()
    roles: Roles = field(default_factory=Roles)
    inputs: tuple[str, ...] = ()
    checked: bool = field(default=False, repr=False)

    def __post_init__(self) -> None:
        if self.checked:
            return
        check_kinds("noise", self.noise, self.inputs, self.parameters)
        for sensor in self.instruments:
            if sensor.column not in self.noise:
                raise DataError(f"sensor {sensor.column}: no noise is stated of it; there are {', '.join(self.noise)}")
        for name, sigma in self.noise.items():
            if not (isinstance(sigma, int | float) and np.isfinite(sigma) and sigma > 0):
                told = f"{sigma:g}" if isinstance(sigma, int | float) else repr(sigma)
                only = " (None, unknown, is for what Predicted measures)" if sigma is None else ""
                raise DataError(f"noise of {name}: {told}; a standard deviation above 0 is needed{only}")
        refuse_twice((*self.noise, *self.inputs), self.held, self.parameters)
        sensors = (*self.instruments, *joints_among(self.inputs, self.roles))
        data = complete(self.data, (*self.noise, *self.inputs), sensors)
        object.__setattr__(self, "data", without_gaps(data, columns_of(self.roles), directions_of(self.roles)))
        check_slopes(self, "closure(q)")
        self.roles.refuse_unknown(self)

    @property
    def fixed(self) -> Mapping[str, float]:
        """Return the numbers that are held."""
        return self.held

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the columns that carry noise."""
        return tuple(self.noise)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Return the instruments that fill these columns; one not told of is in the unit of its joint, or its file."""
        known = {sensor.column: sensor for sensor in self.instruments}
        units = dict(self.data.units) | {joint.reading: joint.unit for joint in self.roles.joints}
        return tuple(
            known.get(name) or Sensor(name, f"sensor of noise {sigma:g}", units.get(name, ""), part=name)
            for name, sigma in self.noise.items()
        )

    @property
    def sigma(self) -> Mapping[str, float]:
        """Return their stated standard deviations."""
        return self.noise

    def constraints(self, q: Quantities) -> Numbers:
        """Return the constraints, shape (n, c); raise `DataError` for a closure of another shape."""
        rows = np.asarray(self.closure(q))
        if rows.ndim != 2 or len(rows) != len(self.data):
            raise DataError(
                f"closure(q) returned shape {rows.shape} for {len(self.data)} readings: a row a reading, "
                "a column a constraint, is needed; "
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
        """Return for each reading every column of numbers that varies: its error may depend smoothly on these."""
        columns = varying(self.data)
        return {name: columns for name in self.noise}

    def on(self, data: MeasuredData) -> Constraints:
        """Return the same constraints over other rows."""
        return replace(self, data=data, checked=True)


def varying(data: MeasuredData) -> dict[str, Array]:
    """Return every column of numbers that varies, name -> (n,), without those that only number the readings."""
    return {
        name: np.asarray(column, dtype=float)
        for name, column in data.columns.items()
        if name not in BOOKKEEPING and column.dtype.kind in "if" and np.ptp(column) > 0
    }


def joints_among(inputs: Sequence[str], roles: Roles) -> tuple[Sensor, ...]:
    """Return the joints whose readings are `inputs`, as sensors, so that a file's units are turned into theirs."""
    return tuple(Sensor(joint.reading, "joint", joint.unit) for joint in roles.joints if joint.reading in inputs)


def check_kinds(told: str, columns: object, inputs: object, parameters: Sequence[object]) -> None:
    """Raise `DataError` where a statement of an author has a wrong type: a word for a tuple, names without noise."""
    if not isinstance(columns, Mapping):
        raise DataError(f"{told}: each column with its standard deviation is needed, such as {told}={{'x': 0.02}}")
    refuse_word("inputs", inputs)
    for one in parameters:
        if not isinstance(one, Parameter):
            raise DataError(f"parameters: {one!r:.60} is no Parameter(name, unit, nominal, lower, upper)")
        if not one.lower <= one.upper:
            raise DataError(f"parameters: {one.name}: its lower bound {one.lower:g} is above its upper {one.upper:g}")


def refuse_twice(columns: Sequence[str], held: Mapping[str, float], parameters: Sequence[Parameter]) -> None:
    """Raise `DataError` for a name that is used twice."""
    names = [*columns, *held, *(p.name for p in parameters)]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise DataError(f"{', '.join(twice)}: a name is measured, an input, held, or free: one of these")
