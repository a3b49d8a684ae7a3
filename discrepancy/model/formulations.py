"""Ready-made formulations: a machine as constraints, as predictions, or as blocks of several kinds of readings.

`Constraints`: a ready-made formulation, for a machine of which its author writes the constraints and nothing else.

    def formulate(self, data):
        return Constraints(data, closure, PARAMETERS, {"enc_1": 2e-5, "x": 0.02})

`closure(q)` takes quantities by name and returns what vanishes on a perfect machine, shape (n, c). Slopes are taken by
complex step, so it must be analytic: no `abs`, no `np.linalg.norm`, no comparison of quantities, no `np.hypot` nor
`np.arctan2`. A few rows are compared with differences at the start, for a modulus would be wrong in silence.

`Predicted`: a ready-made formulation for a machine that predicts what is measured, its inputs free of noise.

    def formulate(self, data):
        return Predicted(data, tip, PARAMETERS, measured={"x": 0.02, "y": "sigma_y"}, inputs=("enc_1", "enc_2"))

`predict(q)` returns what perfect instruments would read, (n, m) in the order of `measured`, or (n,) of one. Residual is
measured minus predicted. Slopes are taken by complex step where `slopes(q)` does not give them: see `Constraints`.

`Blocks`: readings of different kinds in one fit, such as heights of a probe and distances between its marks.

    def formulate(self, data):
        heights, distances = (data.rows(data["kind"] == kind) for kind in ("height", "distance"))
        return Blocks(Predicted(heights, height, PARAMETERS, {"z": 0.02}), Predicted(distances, ...))

Each block has rows and constraints of its own; a parameter of one name is one parameter.

Check the slopes of a formulation that its author wrote as a function: by differences, on a few rows.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, Note, once
from calibench.core.options import suggest
from calibench.discrepancy.model.learned_noise import learned_noise, noise_left, relearned
from calibench.discrepancy.model.machine import Formulation, Numbers, Quantities, complex_step_slopes
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, complete, number_visits, without_gaps
from calibench.discrepancy.model.roles import (
    Roles,
    columns_of,
    directions_of,
    inputs_of,
    refuse_word,
    roles_of,
    unknown_noise_of,
)
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
                shown_sigma = f"{sigma:g}" if isinstance(sigma, int | float) else repr(sigma)
                only = " (None, unknown, is for what Predicted measures)" if sigma is None else ""
                raise DataError(f"noise of {name}: {shown_sigma}; a standard deviation above 0 is needed{only}")
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


def check_kinds(argument: str, columns: object, inputs: object, parameters: Sequence[object]) -> None:
    """Raise `DataError` where a statement of an author has a wrong type: a word for a tuple, names without noise."""
    if not isinstance(columns, Mapping):
        raise DataError(
            f"{argument}: each column with its standard deviation is needed, such as {argument}={{'x': 0.02}}"
        )
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
        predicted = np.asarray(self.predict(q))
        n, m = len(self.data), len(self.measured)
        if predicted.shape == (n,) and m == 1:
            predicted = predicted[:, None]
        if predicted.shape != (n, m):
            raise DataError(
                f"predict(q) returned shape {predicted.shape} for {n} readings of {', '.join(self.measured)}: "
                f"({n}, {m}) is needed; np.stack([...], axis=-1) makes it"
            )
        return np.asarray(np.stack([q[name] for name in self.measured], axis=-1) - predicted)

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


BLOCK = "block"  # the column that says to which block a row belongs
Mask = NDArray[np.bool_]


@final
@dataclass(frozen=True, eq=False, init=False)
class Blocks:
    """A `Formulation` of several: its rows are theirs one below the other, its parameters theirs by name.

    Blocks of different numbers of constraints are parted into one for each measured column, which only those of
    `Predicted` can be. Poses and visits of different blocks are different ones. A column that a block does not have is
    0 there, and a note of the data says so; a cell that only another block reads may be empty. Raises `DataError` where
    blocks contradict each other.
    """

    data: MeasuredData
    blocks: tuple[Formulation, ...]

    def __init__(self, *blocks: Formulation) -> None:
        if not blocks:
            raise DataError("Blocks: at least one block is needed")
        parts = _alike(blocks)
        first: dict[str, tuple[str, Any]] = {}
        for block in parts:
            roles: dict[str, tuple[str, Any]] = {
                p.name: ("free", (p.unit, p.start, p.lower, p.upper)) for p in block.parameters
            }
            roles |= {name: ("held", value) for name, value in block.fixed.items()}
            roles |= dict.fromkeys(block.readings, ("measured", None)) | dict.fromkeys(
                inputs_of(block), ("an input", None)
            )
            for name, role in roles.items():
                other = first.setdefault(name, role)
                if other != role:
                    how = (
                        f"{other[0]} in one and {role[0]} in another"
                        if other[0] != role[0]
                        else f"{role[0]} differently"
                    )
                    raise DataError(f"Blocks: {name} is {how}; state it alike in all blocks")
        self._set(_stacked(parts), parts)
        self._set(self.data, tuple(part.on(self.data.rows(rows)) for part, rows in self._rows(parts)))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters of all blocks, each once."""
        return tuple({p.name: p for block in self.blocks for p in block.parameters}.values())

    @property
    def fixed(self) -> Mapping[str, float]:
        """Return the numbers that are held."""
        return {name: value for block in self.blocks for name, value in block.fixed.items()}

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the columns that carry noise in any block."""
        return tuple(dict.fromkeys(name for block in self.blocks for name in block.readings))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the columns that are quantities without noise."""
        return tuple(dict.fromkeys(name for block in self.blocks for name in inputs_of(block)))

    @property
    def unknown_noise(self) -> tuple[str, ...]:
        """Return the readings whose noise is not stated."""
        return tuple(dict.fromkeys(name for block in self.blocks for name in unknown_noise_of(block)))

    @property
    def roles(self) -> Roles:
        """Return the roles of all blocks together."""
        return reduce(lambda some, more: some | more, (roles_of(block) for block in self.blocks))

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Return the instruments that fill the columns."""
        known = {sensor.column: sensor for block in reversed(self.blocks) for sensor in block.sensors}
        return tuple(known[name] for name in self.readings)

    @property
    def unit(self) -> str:
        """Return the unit of the constraints; "" where blocks differ."""
        units = {block.unit for block in self.blocks}
        return units.pop() if len(units) == 1 else ""

    @property
    def sigma(self) -> Mapping[str, Array | float]:
        """Return the standard deviation of each reading, (n,); in rows where it is not read, that of the others."""
        found: dict[str, Array | float] = {}
        for name in self.readings:
            there = [(rows, block.sigma[name]) for block, rows in self._filled() if name in block.readings]
            whole = np.full(len(self.data), np.median(np.concatenate([np.ravel(s) for _, s in there])) if there else 1)
            for rows, sigma in there:
                whole[rows] = sigma
            found[name] = whole
        return found

    def reads(self, name: str) -> Mask:
        """Return in which rows a column is read, (n,)."""
        read = np.zeros(len(self.data), dtype=bool)
        for block, rows in self._filled():
            read[rows] = name in block.readings
        return read

    def constraints(self, q: Quantities) -> Numbers:
        """Return the constraints, shape (n, c)."""
        return self._placed(lambda block, rows: block.constraints(_of(block, q, rows)))

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, c); 0 in blocks without it."""
        width = self._width()
        found = {name: np.zeros((len(self.data), width)) for name in q}
        for block, rows in self._filled():
            for name, slope in block.slopes(_of(block, q, rows)).items():
                found[name][rows] = slope
        return found

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows` with the shared noise removed by each block for its own rows."""
        mixed = np.array(rows)
        for block, own in self._filled():
            mixed[own] = block.decorrelate(rows[own])
        return mixed

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return target -> covariate -> (n,): NaN in the rows of blocks that do not have it."""
        found: dict[str, dict[str, Array]] = {}
        for block, rows in self._filled():
            for target, covariates in block.covariates(_of(block, q, rows)).items():
                for name, values in covariates.items():
                    whole = found.setdefault(target, {}).setdefault(name, np.full(len(self.data), np.nan))
                    whole[rows] = values
        return found

    def on(self, data: MeasuredData) -> Blocks:
        """Return the same blocks over other rows of these."""
        same = object.__new__(Blocks)
        same._set(data, self.blocks)
        same._set(data, tuple(block.on(data.rows(rows)) for block, rows in same._rows(self.blocks)))
        return same

    def relearned(self, left: Array, spent: float) -> Blocks:
        """Return the same with its unknown noise estimated from the constraints `left`, (n, c), by a fit."""
        same = object.__new__(Blocks)
        same._set(
            self.data,
            tuple(
                relearned(block, left[rows], spent * float(rows.mean()))
                if unknown_noise_of(block) and rows.any()
                else block
                for block, rows in self._rows(self.blocks)
            ),
        )
        return same

    def _set(self, data: MeasuredData, blocks: tuple[Formulation, ...]) -> None:
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "blocks", blocks)

    def _rows(self, blocks: Sequence[Formulation]) -> list[tuple[Formulation, Mask]]:
        return [(block, np.asarray(self.data[BLOCK] == k)) for k, block in enumerate(blocks)]

    def _filled(self) -> list[tuple[Formulation, Mask]]:
        """Return the blocks that have rows, with those."""
        return [(block, rows) for block, rows in self._rows(self.blocks) if rows.any()]

    def _width(self) -> int:
        block = self.blocks[0]
        return len(block.readings) if isinstance(block, Predicted) else _width(block)

    def _placed(self, part: Callable[[Formulation, Mask], Numbers]) -> Numbers:
        parts = [(rows, np.asarray(part(block, rows))) for block, rows in self._filled()]
        whole = np.zeros((len(self.data), self._width()), dtype=np.result_type(*(value for _, value in parts), float))
        for rows, value in parts:
            whole[rows] = value
        return whole


def rows_read(formulation: Formulation, columns: Sequence[str]) -> Mask:
    """Return the rows of a formulation in which all `columns` are read, (n,): all rows, but for `Blocks`."""
    read = np.ones(len(formulation.data), dtype=bool)
    reads = getattr(formulation, "reads", None)  # of `Blocks`, and of what stands around them
    if reads is not None:
        for name in columns:
            read &= reads(name)
    return read


def _of(block: Formulation, q: Quantities, rows: Mask) -> dict[str, Numbers]:
    """Return the quantities that a block knows, in its rows."""
    known = {*(p.name for p in block.parameters), *block.fixed, *block.readings, *inputs_of(block)}
    return {name: value[rows] if np.ndim(value) else value for name, value in q.items() if name in known}


def _width(block: Formulation) -> int:
    """Return the number of constraints of a reading."""
    few = block.on(block.data.rows(np.arange(len(block.data)) < 1))
    q: dict[str, Numbers] = {name: np.asarray(value) for name, value in few.fixed.items()}
    q |= {p.name: np.asarray(p.start) for p in few.parameters}
    q |= {name: np.asarray(few.data[name]) for name in (*inputs_of(few), *few.readings)}
    return int(few.constraints(q).shape[1])


def _alike(blocks: Sequence[Formulation]) -> tuple[Formulation, ...]:
    """Return the blocks, where their numbers of constraints differ one for each measured column."""
    if len({_width(block) for block in blocks}) == 1:
        return tuple(blocks)
    parted: list[Formulation] = []
    for block in blocks:
        if isinstance(block, Predicted):
            parted += block.parted()
        elif _width(block) == 1:
            parted.append(block)
        else:
            raise DataError(
                "Blocks: a closure of several constraints beside a block of another number; state it as `Predicted`, "
                "whose measured columns have noise of their own"
            )
    return tuple(parted)


def _stacked(blocks: Sequence[Formulation]) -> MeasuredData:
    """Return the rows of all blocks one below the other, with a column for the block, poses and visits told apart."""
    parts = [_filled_in(_identified(block.data), block, blocks) for block in blocks]
    names = dict.fromkeys(name for part in parts for name in part.columns if name != BLOCK)
    lacking = {name: [k for k, part in enumerate(parts) if name not in part] for name in names}
    columns: dict[str, NDArray[Any]] = {}
    for name in names:
        known = next(part[name] for part in parts if name in part)
        fill = known[:1] if any(name in block.readings for block in blocks) else np.zeros(1, known.dtype)
        if name == "split":
            fill = np.array(["train"])
        columns[name] = np.concatenate([part[name] if name in part else np.repeat(fill, len(part)) for part in parts])
    sizes = [len(part) for part in parts]
    for name in ("pose_id", "visit_id"):
        shift = np.cumsum([0, *(int(part[name].max()) + 1 if len(part) else 0 for part in parts)])[:-1]
        columns[name] = columns[name] + np.repeat(shift, sizes)
    columns[BLOCK] = np.repeat(np.arange(len(parts)), sizes)
    quiet = {name for block in blocks for name in (*block.readings, *inputs_of(block))} | {"split"}
    empty = [
        name for name, where in lacking.items() if where and name not in quiet and columns[name].dtype.kind in "iuf"
    ]
    notes = [note for block in blocks for note in block.data.notes]
    if empty:
        text = f"column{'s' * (len(empty) > 1)} {', '.join(empty)}: not in every block; 0 is taken where missing"
        notes.append(Note(Code.COLUMN_IN_SOME, text, tuple(empty)))
    numbers = np.concatenate([part.row_numbers for part in parts])
    of_one_file = len(np.unique(numbers)) == len(numbers)
    return replace(parts[0], columns=columns, notes=once(notes), numbers=numbers if of_one_file else None)


def _filled_in(data: MeasuredData, block: Formulation, blocks: Sequence[Formulation]) -> MeasuredData:
    """Return the data of a block with a number in the empty cells that only rows of another block read."""
    own = {*block.readings, *inputs_of(block)}
    filled: dict[str, NDArray[Any]] = {}
    for other in blocks:
        for name in {*other.readings, *inputs_of(other)} - own - filled.keys():
            if name in data and data[name].dtype.kind == "f" and not np.isfinite(data[name]).all() and len(other.data):
                filled[name] = np.where(np.isfinite(data[name]), data[name], other.data[name][0])
    return data.with_columns(filled) if filled else data


def _identified(data: MeasuredData) -> MeasuredData:
    """Return the data with numbers for pose and visit in every row; each row has its own where the data tell none."""
    own = np.arange(len(data))
    if "visit_id" not in data:
        data = data.with_columns({"visit_id": own})
    if "pose_id" not in data:
        data = data.with_columns({"pose_id": data["visit_id"]})
    return number_visits(data) if len(data) else data


_ROWS = 5
_STEP = 1e-6


def check_slopes(formulation: Formulation, words: str) -> None:
    """Raise `DataError` where slopes and central differences disagree on the first rows; `words` name the function.

    It also raises for a function that fails, or that asks for a quantity that nothing states.
    """
    few = formulation.on(formulation.data.rows(np.arange(len(formulation.data)) < _ROWS))
    q: dict[str, Numbers] = {name: np.asarray(value) for name, value in few.fixed.items()}
    q |= {p.name: np.asarray(p.start) for p in few.parameters}
    q |= {name: np.asarray(few.data[name], dtype=float) for name in (*inputs_of(few), *few.readings)}
    way_out = "write it with analytic functions: no abs, norm, hypot, arctan2 or comparison of quantities"
    try:
        size = max(1.0, float(np.max(np.abs(few.constraints(q)))))
    except DataError:
        raise
    except KeyError as error:
        raise DataError(_asked(words, str(error.args[0]), formulation, q)) from error
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name}, line {at.lineno}"
        compares = "; it is given all readings at once: no if, and no comparison" if _takes_one(formulation, q) else ""
        failure = f"{words} failed at the start values: {type(error).__name__}: {error} ({where})"
        raise DataError(f"{failure}{compares}") from error
    try:
        slopes = few.slopes(q)
    except TypeError as error:
        raise DataError(f"{words} takes no complex numbers ({error}); {way_out}") from None
    for name, value in q.items():
        h = _STEP * max(1.0, float(np.max(np.abs(value))))
        difference = (few.constraints({**q, name: value + h}) - few.constraints({**q, name: value - h})) / (2 * h)
        wide = 1e-4 * (np.abs(slopes[name]) + np.abs(difference)) + 1e-9 * size / h
        if (np.abs(slopes[name] - difference) > wide).any():
            raise DataError(f"{words}: its slope in {name} by complex step is not its difference; {way_out}")


def _takes_one(formulation: Formulation, q: Mapping[str, Numbers]) -> bool:
    """Return whether the constraints of one reading can be computed: then they fail for several at once alone."""
    one = formulation.on(formulation.data.rows(np.arange(len(formulation.data)) < 1))
    try:
        one.constraints({name: value[:1] if np.ndim(value) else value for name, value in q.items()})
    except Exception:
        return False
    return True


def _asked(words: str, name: str, formulation: Formulation, q: Mapping[str, Numbers]) -> str:
    """Return a sentence on a function that asks for `name`, which is not among the quantities `q`."""
    if name in formulation.data:
        way_out = "state the column with its standard deviation, or in inputs= where it carries no noise"
    else:
        way_out = f"no column of the file, no parameter and no held number is called so; {suggest(name, q)}"
    return f"{words} asks for {name!r}: {way_out}"
