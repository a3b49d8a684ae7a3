"""`Blocks`: readings of different kinds in one fit, such as heights of a probe and distances between its marks.

    def formulate(self, data):
        heights, distances = (data.rows(data["kind"] == kind) for kind in ("height", "distance"))
        return Blocks(Predicted(heights, height, PARAMETERS, {"z": 0.02}), Predicted(distances, ...))

Each block has rows and constraints of its own; a parameter of one name is one parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.discrepancy.model.formulations.learned_noise import relearned
from calibench.discrepancy.model.formulations.predicted import Predicted
from calibench.discrepancy.model.machine import Formulation, Numbers, Quantities
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.measured.visits import told_visits
from calibench.discrepancy.model.roles import Roles, inputs_of, roles_of, unknown_noise_of
from calibench.problems.base import Array, Parameter

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
        _check(parts)
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


def _check(blocks: Sequence[Formulation]) -> None:
    first: dict[str, tuple[str, Any]] = {}
    for block in blocks:
        roles: dict[str, tuple[str, Any]] = {
            p.name: ("free", (p.unit, p.start, p.lower, p.upper)) for p in block.parameters
        }
        roles |= {name: ("held", value) for name, value in block.fixed.items()}
        roles |= dict.fromkeys(block.readings, ("measured", None)) | dict.fromkeys(inputs_of(block), ("an input", None))
        for name, told in roles.items():
            other = first.setdefault(name, told)
            if other != told:
                how = f"{other[0]} in one and {told[0]} in another" if other[0] != told[0] else f"{told[0]} differently"
                raise DataError(f"Blocks: {name} is {how}; state it alike in all blocks")


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
    notes = dict.fromkeys(note for block in blocks for note in block.data.notes)
    if empty:
        notes[f"column{'s' * (len(empty) > 1)} {', '.join(empty)}: not in every block; 0 is taken where missing"] = None
    noted = frozenset[str]().union(*(block.data.noted for block in blocks))
    numbers = np.concatenate([part.row_numbers for part in parts])
    of_one_file = len(np.unique(numbers)) == len(numbers)
    return replace(parts[0], columns=columns, notes=tuple(notes), noted=noted, numbers=numbers if of_one_file else None)


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
    return told_visits(data) if len(data) else data
