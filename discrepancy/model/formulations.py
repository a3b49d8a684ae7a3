"""Ready-made formulations: a machine as constraints, as predictions, or as blocks of several kinds of readings.

`Constraints`, for a machine of which its author writes the constraints and nothing else:

    def formulate(self, data):
        return Constraints(data, closure, PARAMETERS, {"enc_1": 2e-5, "x": 0.02})

`closure(q)` takes quantities by name and returns what vanishes on a perfect machine, shape (n, c). Slopes are taken by
complex step, so it must be analytic: no `abs`, no `np.linalg.norm`, no comparison of quantities, no `np.hypot` nor
`np.arctan2`. A few rows are compared with differences at the start, for a modulus would be wrong in silence.

`Predicted`, for a machine that predicts what is measured, its inputs free of noise:

    def formulate(self, data):
        return Predicted(data, tip, PARAMETERS, measured={"x": 0.02, "y": "sigma_y"}, inputs=("enc_1", "enc_2"))

`predict(q)` returns what perfect instruments would read, (n, m) in the order of `measured`, or (n,) of one. Residual is
measured minus predicted. Slopes are taken by complex step where `slopes(q)` does not give them: see `Constraints`.

`Blocks`, for readings of different kinds in one fit, such as heights of a probe and distances between its marks:

    def formulate(self, data):
        heights, distances = (data.rows(data["kind"] == kind) for kind in ("height", "distance"))
        return Blocks(Predicted(heights, height, PARAMETERS, {"z": 0.02}), Predicted(distances, ...))

Each block has rows and constraints of its own; a parameter of one name is one parameter.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, Note, once
from calibench.core.options import suggest
from calibench.discrepancy.model import roles as parts_of
from calibench.discrepancy.model.machine import Formulation, Numbers, Quantities, Slopes, as_is, complex_step_slopes
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, complete, number_visits, without_gaps
from calibench.discrepancy.model.model import Model, learned_noise, noise_left, relearned
from calibench.discrepancy.model.roles import RATE, Roles, inputs_of, roles_of, unknown_noise_of
from calibench.problems.base import Array, Parameter

BOOKKEEPING = ("pose_id", "visit_id", "repeat", "reading_place", "valid", "block")
_OF_ROWS = (*BOOKKEEPING, "split", "place_x", "place_y")


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
    fixed: Mapping[str, float] = field(init=False, repr=False)
    readings: tuple[str, ...] = field(init=False, repr=False)
    sigma: Mapping[str, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.checked:
            check_names("noise", self.noise, self.inputs, self.held, self.parameters)
        vars(self).update(fixed=self.held, readings=tuple(self.noise), sigma=self.noise)
        if self.checked:
            return
        for name in (one.column for one in self.instruments if one.column not in self.noise):
            raise DataError(f"sensor {name}: no noise is stated of it; there are {', '.join(self.noise)}")
        for name, sigma in self.noise.items():
            if not (isinstance(sigma, int | float) and np.isfinite(sigma) and sigma > 0):
                shown_sigma = f"{sigma:g}" if isinstance(sigma, int | float) else repr(sigma)
                only = " (None, unknown, is for what Predicted measures)" if sigma is None else ""
                raise DataError(f"noise of {name}: {shown_sigma}; a standard deviation above 0 is needed{only}")
        object.__setattr__(self, "data", _complete(self, (*self.noise, *self.inputs)))
        check_slopes(self, "closure(q)")
        self.roles.refuse_unknown(self)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        kinds = {name: f"{sigma:g}" for name, sigma in self.noise.items()}
        return _sensors(self, kinds, {})

    def constraints(self, q: Quantities) -> Numbers:
        """Return the constraints, shape (n, c); raise `DataError` for a closure of another shape."""
        rows = np.asarray(self.closure(q))
        if rows.ndim != 2 or len(rows) != len(self.data):
            raise DataError(
                f"closure(q) returned shape {rows.shape} for {len(self.data)} readings: a row a reading, a column a "
                "constraint, is needed; np.stack([...], axis=-1) makes them"
            )
        return rows

    slopes = complex_step_slopes
    decorrelate = as_is

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return for each reading every column of numbers that varies: its error may depend smoothly on these."""
        columns = varying(self.data)
        return {name: columns for name in self.noise}

    def on(self, data: MeasuredData) -> Constraints:
        return replace(self, data=data, checked=True)


def _sensors(of: Constraints | Predicted, kinds: Mapping[str, str], other: Mapping[str, str]) -> tuple[Sensor, ...]:
    """Return the instruments that fill columns; one not told of is in the unit of its joint, its file or `other`."""
    known = {sensor.column: sensor for sensor in of.instruments}
    units = {**other, **of.data.units, **{joint.reading: joint.unit for joint in of.roles.joints}}
    return tuple(
        known.get(name) or Sensor(name, f"sensor of noise {kind}", units.get(name, ""), part=name)
        for name, kind in kinds.items()
    )


def varying(data: MeasuredData) -> dict[str, Array]:
    """Return every column of numbers that varies, name -> (n,), without those that only number the readings."""
    return {
        name: np.asarray(column, dtype=float)
        for name, column in data.columns.items()
        if name not in BOOKKEEPING and column.dtype.kind in "if" and np.ptp(column) > 0
    }


def along_clock(data: MeasuredData, names: Iterable[str], clock: str) -> dict[str, Array]:
    """Return the derivative in time of each column, (n,), as `RATE`; nothing of fewer than three times."""
    t, at = np.unique(np.asarray(data[clock], dtype=float), return_inverse=True)
    return {f"{RATE}{name}": np.gradient(means_at(data[name], at), t)[at] for name in names if len(t) >= 3}


def means_at(column: Array, at: NDArray[np.intp]) -> Array:
    """Return the mean of a column, (n,), in each of the groups that `at` numbers, (n,)."""
    return np.asarray(np.bincount(at, np.asarray(column, dtype=float)) / np.bincount(at))


def numbers_of(data: MeasuredData) -> tuple[str, ...]:
    """Return the columns of numbers that describe a reading."""
    return tuple(c for c in data.columns if c not in _OF_ROWS and np.asarray(data[c]).dtype.kind in "iuf")


def _complete(of: Constraints | Predicted, read: Sequence[str]) -> MeasuredData:
    """Return the rows with a number in all that is `read` or followed, a joint's reading in the unit of the joint."""
    joints = [Sensor(joint.reading, "joint", joint.unit) for joint in of.roles.joints if joint.reading in of.inputs]
    data = complete(of.data, read, (*of.instruments, *joints))
    directions = dict.fromkeys(joint.direction for joint in of.roles.joints if joint.direction)
    return without_gaps(data, parts_of.columns_of(of.roles), tuple(directions))


def check_names(
    argument: str, columns: object, inputs: Sequence[str], held: Mapping[str, float], parameters: Sequence[object]
) -> None:
    """Raise `DataError` for a statement of a wrong type (a word for a tuple, names without noise), or a name twice."""
    if not isinstance(columns, Mapping):
        raise DataError(
            f"{argument}: each column with its standard deviation is needed, such as {argument}={{'x': 0.02}}"
        )
    parts_of.refuse_word("inputs", inputs)
    for one in parameters:
        if not isinstance(one, Parameter):
            raise DataError(f"parameters: {one!r:.60} is no Parameter(name, unit, nominal, lower, upper)")
        if not one.lower <= one.upper:
            raise DataError(f"parameters: {one.name}: its lower bound {one.lower:g} is above its upper {one.upper:g}")
    names = [*columns, *inputs, *held, *(one.name for one in parameters if isinstance(one, Parameter))]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise DataError(f"{', '.join(twice)}: a name is measured, an input, held, or free: one of these")


OfRows = tuple[Callable[[Quantities], Numbers], Callable[[Quantities], dict[str, Array]]]
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
    `of_rows` returns `predict` and `slopes` for other rows, where these depend on which rows they are asked for;
    `at_end` what a report says of them when the search is done. `made_up` are parameters that others make up for, where
    errors of slopes hide it: name -> other -> its change for a unit of it.
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
    slopes: Callable[[Quantities], Mapping[str, Array]] = field(default=None, repr=False)  # type: ignore[assignment]
    learned: Mapping[str, float] = field(default_factory=dict, repr=False)
    of_new: Callable[[MeasuredData], MeasuredData] | None = field(default=None, repr=False)
    of_rows: Callable[[MeasuredData], OfRows] | None = field(default=None, repr=False)
    at_end: Callable[[], tuple[Note, ...]] | None = field(default=None, repr=False)
    made_up: Mapping[str, Mapping[str, float]] = field(default_factory=dict, repr=False)
    _checked: bool = field(default=False, repr=False)
    _given: Callable[[Quantities], Mapping[str, Array]] | None = field(default=None, repr=False)
    fixed: Mapping[str, float] = field(init=False, repr=False)
    readings: tuple[str, ...] = field(init=False, repr=False)
    unknown_noise: tuple[str, ...] = field(init=False, repr=False)  # the measured columns whose noise is not stated

    def __post_init__(self) -> None:
        ours = getattr(self.slopes, "__func__", None) is Predicted._slopes  # handed on by `replace`
        given = self._given if ours else self.slopes
        if not self._checked:
            check_names("measured", self.measured, self.inputs, self.held, self.parameters)
        unknown = tuple(name for name, sigma in self.measured.items() if sigma is None)
        vars(self).update(_given=given, fixed=self.held, readings=tuple(self.measured), unknown_noise=unknown)
        vars(self).update(slopes=self._slopes)  # the method of a `Formulation`, whether given or not
        if self._checked:
            return
        if not self.measured:
            raise DataError("measured: nothing is measured; give it a column with its standard deviation or None")
        for name in (one.column for one in self.instruments if one.column not in self.measured):
            raise DataError(f"sensor {name}: it is not measured; {suggest(name, self.measured)}")
        deviations = [stated for stated in self.measured.values() if isinstance(stated, str)]
        read = tuple(dict.fromkeys((*self.measured, *self.inputs, *deviations)))
        object.__setattr__(self, "data", _complete(self, read))
        if self.of_rows is not None:  # of the rows that are left
            predict, given = self.of_rows(self.data)
            vars(self).update(predict=predict, _given=given)
        for name, sigma in self.sigma.items():
            least = np.min(sigma)
            if not (self.measured[name] is None or (np.isfinite(least) and least > 0)):
                raise DataError(f"noise of {name}: {least:g}; a standard deviation above 0 is needed, or None: unknown")
        if self.of_rows is None:  # a simulator's slopes are differences themselves, where it is rough over wide steps
            check_slopes(self, "predict(q)" if given is None else "slopes(q)")
        self.roles.refuse_unknown(self)
        if self.unknown_noise:
            object.__setattr__(self, "learned", learned_noise(self))

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        # sensors of equal stated noise are one kind, any other is its own kind
        kinds = {n: f"{s:g}" if isinstance(s, int | float) else f"of {n}" for n, s in self.measured.items()}
        return _sensors(self, kinds, dict.fromkeys(self.measured, self.unit))

    @property
    def sigma(self) -> Mapping[str, Array | float]:
        """Return the standard deviation of each measured column, a number or (n,): stated, or a first estimate."""
        found: dict[str, Array | float] = {}
        for name, stated in self.measured.items():
            if stated is None:
                found[name] = self.learned.get(name, 1.0)
            else:
                found[name] = np.asarray(self.data[stated], dtype=float) if isinstance(stated, str) else float(stated)
        return found

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

    decorrelate = as_is

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return for each measured column every column of numbers that varies, but those that are measured."""
        columns = {name: column for name, column in varying(self.data).items() if name not in self.measured}
        return {name: columns for name in self.measured}

    def on(self, data: MeasuredData) -> Predicted:
        if self.of_rows is None:
            return replace(self, data=data, _checked=True)
        predict, slopes = self.of_rows(data)
        return replace(self, data=data, predict=predict, slopes=slopes, _checked=True)

    def relearned(self, left: Array, spent: float) -> Predicted:
        """Return the same with its unknown noise estimated from the constraints `left`, (n, c), by a fit."""
        return replace(self, learned=noise_left(self, left, spent), _checked=True)

    def parted(self) -> tuple[Predicted, ...]:
        """Return one formulation for each measured column, because their noise is independent."""

        def predict(k: int, name: str, q: Quantities) -> Numbers:
            return np.asarray(self.predict(q)).reshape(len(q[name]), -1)[:, k]

        def slopes(k: int, q: Quantities) -> Mapping[str, Array]:
            given = {} if self._given is None else self._given(q)
            return {n: np.asarray(s).reshape(len(s), -1)[:, k : k + 1] for n, s in given.items()}

        parts = []
        for k, name in enumerate(self.measured):
            own = tuple(s for s in self.instruments if s.column == name)
            part = replace(
                self, predict=partial(predict, k, name), measured={name: self.measured[name]}, instruments=own,
                _given=partial(slopes, k), _checked=True,
            )  # fmt: skip
            parts.append(part)
        return tuple(parts)

    def _slopes(self, q: Quantities) -> Slopes:
        """Return the derivative of the constraints in each quantity, name -> (n, m); by complex step if not given."""
        given = {} if self._given is None else self._given(q)
        names = (*self.measured, *(name for name in q if name not in self.measured))
        return Slopes(names, partial(self._slope, q, given))

    def _slope(self, q: Quantities, given: Mapping[str, Array], name: str) -> Array:
        n, m = len(self.data), len(self.measured)
        if name in self.measured:
            found = np.zeros((n, m))
            found[:, [*self.measured].index(name)] = 1.0
            return found
        if name in given:
            own = np.asarray(given.one(name) if isinstance(given, Slopes) else given[name])  # kept once, with its sign
            own = own[:, None] if own.ndim == 1 else own
            return np.asarray(-(own if own.shape == (n, m) else np.broadcast_to(own, (n, m))))
        return complex_step_slopes(self, q)[name]


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
    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, float]
    readings: tuple[str, ...]
    inputs: tuple[str, ...]
    unknown_noise: tuple[str, ...]
    roles: Roles
    sensors: tuple[Sensor, ...]
    unit: str  # of the constraints; "" where blocks differ

    def __init__(self, *blocks: Formulation) -> None:
        if not blocks:
            raise DataError("Blocks: at least one block is needed")
        parts = tuple(blocks)
        if len({_width(block) for block in blocks}) > 1:  # one for each measured column, whose noise is its own
            for block in blocks:
                if not isinstance(block, Predicted) and _width(block) > 1:
                    raise DataError(
                        "Blocks: a closure of several constraints beside a block of another number; state it as "
                        "`Predicted`, whose measured columns have noise of their own"
                    )
            parted = [block.parted() if isinstance(block, Predicted) else (block,) for block in blocks]
            parts = tuple(one for some in parted for one in some)
        first: dict[str, tuple[str, Any]] = {}
        for block in parts:
            roles: dict[str, tuple[str, Any]] = {
                p.name: ("free", (p.unit, p.start, p.lower, p.upper)) for p in block.parameters
            }
            roles |= {name: ("held", value) for name, value in block.fixed.items()}
            roles |= dict.fromkeys(block.readings, ("measured", None))
            roles |= dict.fromkeys(inputs_of(block), ("an input", None))
            for name, role in roles.items():
                other = first.setdefault(name, role)
                if other != role:
                    both = f"{other[0]} in one and {role[0]} in another"
                    how = both if other[0] != role[0] else f"{role[0]} differently"
                    raise DataError(f"Blocks: {name} is {how}; state it alike in all blocks")
        data = _stacked(parts)
        self._set(data, [part.on(data.rows(data[BLOCK] == k)) for k, part in enumerate(parts)])

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
        read = np.zeros(len(self.data), dtype=bool)
        for block, rows in self._filled():
            read[rows] = name in block.readings
        return read

    def constraints(self, q: Quantities) -> Numbers:
        parts = [(rows, np.asarray(block.constraints(_of(block, q, rows)))) for block, rows in self._filled()]
        whole = np.zeros(
            (len(self.data), _width(self.blocks[0])), dtype=np.result_type(*(value for _, value in parts), float)
        )
        for rows, value in parts:
            whole[rows] = value
        return whole

    def slopes(self, q: Quantities) -> dict[str, Array]:
        width = _width(self.blocks[0])
        found = {name: np.zeros((len(self.data), width)) for name in q}
        for block, rows in self._filled():
            for name, slope in block.slopes(_of(block, q, rows)).items():
                found[name][rows] = slope
        return found

    def decorrelate(self, rows: Array) -> Array:
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
        return object.__new__(Blocks)._set(
            data, [block.on(data.rows(data[BLOCK] == k)) for k, block in enumerate(self.blocks)]
        )

    def relearned(self, left: Array, spent: float) -> Blocks:
        """Return the same with its unknown noise estimated from the constraints `left`, (n, c), by a fit."""
        blocks = []
        for k, block in enumerate(self.blocks):
            rows = self.data[BLOCK] == k
            learns = unknown_noise_of(block) and rows.any()
            blocks.append(relearned(block, left[rows], spent * float(rows.mean())) if learns else block)
        return object.__new__(Blocks)._set(self.data, blocks)

    def _set(self, data: MeasuredData, blocks: Sequence[Formulation]) -> Blocks:
        readings = tuple(dict.fromkeys(name for block in blocks for name in block.readings))
        sensors = {sensor.column: sensor for block in reversed(blocks) for sensor in block.sensors}
        units = {block.unit for block in blocks}
        vars(self).update(
            data=data, blocks=tuple(blocks),
            parameters=tuple({p.name: p for block in blocks for p in block.parameters}.values()),
            fixed={name: value for block in blocks for name, value in block.fixed.items()}, readings=readings,
            inputs=tuple(dict.fromkeys(name for block in blocks for name in inputs_of(block))),
            unknown_noise=tuple(dict.fromkeys(name for block in blocks for name in unknown_noise_of(block))),
            roles=reduce(lambda some, more: some | more, (roles_of(block) for block in blocks)),
            sensors=tuple(sensors[name] for name in readings), unit=units.pop() if len(units) == 1 else "",
        )  # fmt: skip
        return self

    def _filled(self) -> list[tuple[Formulation, Mask]]:
        each = ((block, np.asarray(self.data[BLOCK] == k)) for k, block in enumerate(self.blocks))
        return [(block, rows) for block, rows in each if rows.any()]


def _of(block: Formulation, q: Quantities, rows: Mask) -> dict[str, Numbers]:
    known = {*(p.name for p in block.parameters), *block.fixed, *block.readings, *inputs_of(block)}
    return {name: value[rows] if np.ndim(value) else value for name, value in q.items() if name in known}


def _width(block: Formulation) -> int:
    """Return the number of constraints a row."""
    if isinstance(block, Predicted):
        return len(block.readings)
    few = block.on(block.data.rows(np.arange(len(block.data)) < 1))
    return int(few.constraints(Model(few).quantities()[0]).shape[1])


def _stacked(blocks: Sequence[Formulation]) -> MeasuredData:
    """Return the rows of all blocks one below the other, with a column for the block, poses and visits told apart."""
    known_of = [{*block.readings, *inputs_of(block)} for block in blocks]
    parts: list[MeasuredData] = []
    for block, own in zip(blocks, known_of):
        data = block.data
        if "visit_id" not in data:  # each row is a visit, and a pose, of its own where the data tell none
            data = data.with_columns({"visit_id": np.arange(len(data))})
        if "pose_id" not in data:
            data = data.with_columns({"pose_id": data["visit_id"]})
        data = number_visits(data) if len(data) else data
        # a number in the empty cells that only rows of another block read
        there = [(other.data, names - own) for other, names in zip(blocks, known_of) if len(other.data)]
        first = {name: other[name][0] for other, names in reversed(there) for name in names}
        numbers = [name for name in first if name in data and data[name].dtype.kind == "f"]
        holey = [name for name in numbers if not np.isfinite(data[name]).all()]
        filled = {name: np.where(np.isfinite(data[name]), data[name], first[name]) for name in holey}
        parts.append(data.with_columns(filled))

    names = dict.fromkeys(name for part in parts for name in part.columns if name != BLOCK)
    lacking = {name for name in names if not all(name in part for part in parts)}
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
    quiet = {"split"}.union(*known_of)
    empty = [name for name in names if name in lacking - quiet and columns[name].dtype.kind in "iuf"]
    notes = [note for block in blocks for note in block.data.notes]
    if empty:
        text = f"column{'s' * (len(empty) > 1)} {', '.join(empty)}: not in every block; 0 is taken where missing"
        notes.append(Note(Code.COLUMN_IN_SOME, text, tuple(empty)))
    rows = np.concatenate([part.row_numbers for part in parts])
    of_one_file = len(np.unique(rows)) == len(rows)
    return replace(parts[0], columns=columns, notes=once(notes), numbers=rows if of_one_file else None)


_ROWS = 5
_STEP = 1e-6


def check_slopes(formulation: Formulation, words: str) -> None:
    """Raise `DataError` where slopes and central differences disagree on the first rows; `words` name the function.

    It also raises for a function that fails, or that asks for a quantity that nothing states.
    """
    few = formulation.on(formulation.data.rows(np.arange(len(formulation.data)) < _ROWS))
    q = Model(few).quantities()[0]
    q |= {name: np.asarray(q[name], dtype=float) for name in (*inputs_of(few), *few.readings)}
    way_out = "write it with analytic functions: no abs, norm, hypot, arctan2 or comparison of quantities"
    try:
        size = max(1.0, float(np.max(np.abs(few.constraints(q)))))
    except DataError:
        raise
    except KeyError as error:
        name = str(error.args[0])
        remedy = "state the column with its standard deviation, or in inputs= where it carries no noise"
        if name not in formulation.data:
            remedy = f"no column of the file, no parameter and no held number is called so; {suggest(name, q)}"
        raise DataError(f"{words} asks for {name!r}: {remedy}") from error
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where, compares = f"{Path(at.filename).name}, line {at.lineno}", ""
        try:  # one reading alone: then it fails for several at once
            one = formulation.on(formulation.data.rows(np.arange(len(formulation.data)) < 1))
            one.constraints({name: value[:1] if np.ndim(value) else value for name, value in q.items()})
            compares = "; it is given all readings at once: no if, and no comparison"
        except Exception:
            pass
        failure = f"{words} failed at the start values: {type(error).__name__}: {error} ({where})"
        raise DataError(f"{failure}{compares}") from error
    try:
        slopes = dict(few.slopes(q))
    except TypeError as error:
        raise DataError(f"{words} takes no complex numbers ({error}); {way_out}") from None
    for name, value in q.items():
        h = _STEP * max(1.0, float(np.max(np.abs(value))))
        difference = (few.constraints({**q, name: value + h}) - few.constraints({**q, name: value - h})) / (2 * h)
        wide = 1e-4 * (np.abs(slopes[name]) + np.abs(difference)) + 1e-9 * size / h
        if (np.abs(slopes[name] - difference) > wide).any():
            raise DataError(f"{words}: its slope in {name} by complex step is not its difference; {way_out}")
