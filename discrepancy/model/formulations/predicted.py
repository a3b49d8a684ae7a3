"""`Predicted`: a ready-made formulation for a machine that predicts what is measured, its inputs free of noise.

    def formulate(self, data):
        return Predicted(data, tip, PARAMETERS, measured={"x": 0.02, "y": "sigma_y"}, inputs=("enc_1", "enc_2"))

`predict(q)` returns what perfect instruments would read, (n, m) in the order of `measured`, or (n,) of one. Residual is
measured minus predicted. Slopes are taken by complex step where `slopes(q)` does not give them: see `Constraints`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from calibench.core.options import suggest
from calibench.discrepancy.model.formulations.constraints import check_kinds, joints_among, refuse_twice, varying
from calibench.discrepancy.model.formulations.learned_noise import learned_noise, noise_left
from calibench.discrepancy.model.formulations.slopes import check_slopes
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.discrepancy.model.measured.complete import complete, without_gaps
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.roles import Roles, columns_of, directions_of
from calibench.problems.base import Array, Parameter

Stated = float | str | None  # a standard deviation, the column that holds it, or unknown


@final
@dataclass(frozen=True, eq=False)
class Predicted:
    """A `Formulation` from a function that predicts: residual = measured - `predict(q)`, (n, m), in `unit`.

    `measured` has the standard deviation of each measured column: a number, the name of the column that holds it, or
    None where it is unknown (`unknown_noise`): then `sigma` is a first robust estimate from the residuals of the rows
    that are not held out. `inputs` are columns without noise, which effects may change; `held` numbers that are not
    calibrated. `instruments` tell of measured columns what `Sensor` says, `roles` what the machine is made of.
    `of_new` makes the columns of the fit from those of a file, for rows that are only predicted, each of them kept.
    Rows with a cell that holds no number are left out. Raises `DataError` for a column that is missing, a name used
    twice, or a prediction of another shape.
    """

    data: MeasuredData
    predict: Callable[[Quantities], Numbers]
    parameters: tuple[Parameter, ...]
    measured: Mapping[str, Stated]
    inputs: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    unit: str = "mm"
    instruments: tuple[Sensor, ...] = ()
    roles: Roles = field(default_factory=Roles)
    slopes: Callable[[Quantities], dict[str, Array]] = field(default=None, repr=False)  # type: ignore[assignment]
    learned: Mapping[str, float] = field(default_factory=dict, repr=False)
    of_new: Callable[[MeasuredData], MeasuredData] | None = field(default=None, repr=False)
    _checked: bool = field(default=False, repr=False)
    _given: Callable[[Quantities], Mapping[str, Array]] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        ours = getattr(self.slopes, "__func__", None) is Predicted._slopes  # handed on by `replace`
        given = self._given if ours else self.slopes
        object.__setattr__(self, "_given", given)
        object.__setattr__(self, "slopes", self._slopes)  # the method of a `Formulation`, whether given or not
        if self._checked:
            return
        self._check_names()
        self._check_columns()
        check_slopes(self, "predict(q)" if given is None else "slopes(q)")
        self.roles.refuse_unknown(self)
        if self.unknown_noise:
            object.__setattr__(self, "learned", learned_noise(self))

    @property
    def fixed(self) -> Mapping[str, float]:
        """Return the numbers that are held."""
        return self.held

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the measured columns: they carry noise."""
        return tuple(self.measured)

    @property
    def unknown_noise(self) -> tuple[str, ...]:
        """Return the measured columns whose noise is not stated."""
        return tuple(name for name, sigma in self.measured.items() if sigma is None)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Return the instruments that fill these columns; one not told of is in the unit of its joint, or its file."""
        known = {sensor.column: sensor for sensor in self.instruments}
        units = dict(self.data.units) | {joint.reading: joint.unit for joint in self.roles.joints}
        return tuple(
            known.get(name)
            or Sensor(name, f"sensor of noise {_kind(name, sigma)}", units.get(name, self.unit), part=name)
            for name, sigma in self.measured.items()
        )

    @property
    def sigma(self) -> Mapping[str, Array | float]:
        """Return the standard deviation of each measured column, a number or (n,): stated, or a first estimate."""
        return {name: self._sigma(name, stated) for name, stated in self.measured.items()}

    def constraints(self, q: Quantities) -> Numbers:
        """Return measured minus predicted, shape (n, m); raise `DataError` for a prediction of another shape."""
        told = np.asarray(self.predict(q))
        n, m = len(self.data), len(self.measured)
        if told.shape == (n,) and m == 1:
            told = told[:, None]
        if told.shape != (n, m):
            raise DataError(
                f"predict(q) returned shape {told.shape} for {n} readings of {', '.join(self.measured)}: "
                f"({n}, {m}) is needed; np.stack([...], axis=-1) makes it"
            )
        return np.asarray(np.stack([q[name] for name in self.measured], axis=-1) - told)

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows` as they are: each reading has noise of its own."""
        return rows

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return for each measured column every column of numbers that varies, but those that are measured."""
        columns = {name: column for name, column in varying(self.data).items() if name not in self.measured}
        return {name: columns for name in self.measured}

    def on(self, data: MeasuredData) -> Predicted:
        """Return the same prediction over other rows."""
        return replace(self, data=data, _checked=True)

    def relearned(self, left: Array, spent: float) -> Predicted:
        """Return the same with its unknown noise estimated from the constraints `left`, (n, c), by a fit."""
        return replace(self, learned=noise_left(self, left, spent), _checked=True)

    def parted(self) -> tuple[Predicted, ...]:
        """Return one formulation for each measured column, because their noise is independent."""

        def one(k: int, name: str) -> Predicted:
            def predict(q: Quantities) -> Numbers:
                return np.asarray(self.predict(q)).reshape(len(q[name]), -1)[:, k]

            def slopes(q: Quantities) -> Mapping[str, Array]:
                return {n: np.asarray(s).reshape(len(s), -1)[:, k : k + 1] for n, s in self._own_slopes(q).items()}

            return replace(
                self, predict=predict, measured={name: self.measured[name]},
                instruments=tuple(s for s in self.instruments if s.column == name),
                _given=slopes, _checked=True,
            )  # fmt: skip

        return tuple(one(k, name) for k, name in enumerate(self.measured))

    def _own_slopes(self, q: Quantities) -> Mapping[str, Array]:
        return {} if self._given is None else self._given(q)

    def _slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, m); by complex step if not given."""
        n, m = len(self.data), len(self.measured)
        given = self._own_slopes(q)
        found: dict[str, Array] = {}
        for k, name in enumerate(self.measured):
            found[name] = np.zeros((n, m))
            found[name][:, k] = 1.0
        for name in q:
            if name in found:
                continue
            if name in given:
                own = np.asarray(given[name])
                own = own[:, None] if own.ndim == 1 else own
                found[name] = -(own if own.shape == (n, m) else np.broadcast_to(own, (n, m)))
            else:
                found[name] = np.imag(self.constraints({**q, name: np.asarray(q[name]) + 1j * _TINY})) / _TINY
        return found

    def _sigma(self, name: str, stated: Stated) -> Array | float:
        if stated is None:
            return self.learned.get(name, 1.0)
        return np.asarray(self.data[stated], dtype=float) if isinstance(stated, str) else float(stated)

    def _check_names(self) -> None:
        check_kinds("measured", self.measured, self.inputs, self.parameters)
        if not self.measured:
            raise DataError("measured: nothing is measured; give it a column with its standard deviation or None")
        refuse_twice((*self.measured, *self.inputs), self.held, self.parameters)
        for sensor in self.instruments:
            if sensor.column not in self.measured:
                raise DataError(f"sensor {sensor.column}: it is not measured; {suggest(sensor.column, self.measured)}")

    def _check_columns(self) -> None:
        deviations = [stated for stated in self.measured.values() if isinstance(stated, str)]
        read = tuple(dict.fromkeys((*self.measured, *self.inputs, *deviations)))
        data = complete(self.data, read, (*self.instruments, *joints_among(self.inputs, self.roles)))
        object.__setattr__(self, "data", without_gaps(data, columns_of(self.roles), directions_of(self.roles)))
        for name, stated in self.measured.items():
            least = np.min(self._sigma(name, stated))
            if not (stated is None or (np.isfinite(least) and least > 0)):
                raise DataError(f"noise of {name}: {least:g}; a standard deviation above 0 is needed, or None: unknown")


_TINY = 1e-30  # of a complex step: exact to rounding


def _kind(name: str, stated: Stated) -> str:
    """Return a name for each kind of sensor: sensors of equal stated noise are one kind, any other is its own kind."""
    return f"{stated:g}" if isinstance(stated, int | float) else f"of {name}"
