"""`Table`: one column is measured, a function of others predicts it, and its residuals may depend on any column.

The inputs carry no noise. The noise of the measured column is a number, a column, or unknown: then it is estimated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np

from calibench.core.options import suggest
from calibench.discrepancy.machines.table.base import Base, base_of
from calibench.discrepancy.machines.table.columns import RATE, known, numbers_of, with_earlier, with_rates
from calibench.discrepancy.machines.table.models import models
from calibench.discrepancy.model.formulations.predicted import Predicted
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.roles import Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Parameter

_WIDTH = 1e9  # of the box about a start: nothing is known of a parameter of any function


@machines.register("table")
@final
@dataclass(frozen=True)
class Table:
    """A table of columns with a base model y = f(x; p).

    `model` is a name or FILE.py:FUNCTION, `measured` the column that it predicts, `inputs` the columns for its
    arguments where they are called otherwise, `sigma` the noise: a number, a column, or None where nobody knows it.
    `start` are other starts of parameters, `held` parameters that are not calibrated. `time` is a column: lag, drift
    and step are looked for along it. `back` adds columns of as many earlier rows, `u_1`, `u_2`, of what is measured and
    of all others. `covariates` are the columns that an error may follow; where none are named, all.
    """

    model: str = "constant"
    measured: str = "y"
    inputs: tuple[str, ...] = ()
    sigma: float | str | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    time: str = ""
    back: int = 0
    covariates: tuple[str, ...] = ()
    unit: str = ""
    name: str = field(default="table", init=False)

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return the prediction of the measured column; raise `DataError` for columns that do not fit the function."""
        known(data, "machine.measured", self.measured)
        if self.back and f"{self.measured}_{self.back}" not in data:
            data = with_earlier(data, numbers_of(data), self.back)
        try:
            function = models.factory(self.model)
        except ValueError as error:
            raise DataError(f"machine.model={self.model}: {error}") from None
        base = base_of(self.model, function, self.inputs, self.start, self.measured)
        clock = self.time or ("t_s" if "t_s" in data else "")
        known(data, "machine.inputs", *base.columns)
        known(data, "machine.covariates", *self.covariates)
        known(data, "machine.sigma", *((self.sigma,) if isinstance(self.sigma, str) else ()))
        known(data, "machine.time", *(clock,) * bool(clock))
        for name in self.held:
            if name not in base.starts:
                raise DataError(f"machine.held={name}: {base.name} has no such parameter; {suggest(name, base.starts)}")
        if self.measured in base.columns:
            raise DataError(f"machine.measured={self.measured}: it is what is predicted, so it can be no input")
        moving = tuple(c for c in base.columns if c != clock)
        data = with_rates(data, moving, clock)
        return Predicted(
            data,
            base,
            tuple(
                Parameter(name, "", at, at - _WIDTH, at + _WIDTH)
                for name, at in base.starts.items()
                if name not in self.held
            ),
            measured={self.measured: self.sigma},
            inputs=base.columns,
            held={name: base.starts[name] for name in self.held},
            unit=self.unit,
            instruments=(Sensor(self.measured, "column", self.unit),),
            roles=Roles(
                time=clock, columns=self.covariates or self._followed(data, base),
            ),
        )  # fmt: skip

    def _followed(self, data: MeasuredData, base: Base) -> tuple[str, ...]:
        """Return the inputs, and every other column that varies."""
        noise = self.sigma if isinstance(self.sigma, str) else ""
        others = (c for c in numbers_of(data) if c not in (self.measured, noise) and not c.startswith(RATE))
        return tuple(c for c in dict.fromkeys((*base.columns, *others)) if np.ptp(data[c]))
