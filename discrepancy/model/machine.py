"""What the search needs of a kind of machine: its quantities, the constraints between them, and their noise.

A *quantity* is a named number of every reading: what a sensor said (`enc_1`), or a parameter of the machine (`la1`).
A perfect machine read without noise makes its constraints vanish, row by row. Everything else follows by the chain
rule from their slopes in the quantities: the calibration Jacobian, the variance of the residuals, and the signature of
an effect, which is a change of quantities. A machine without a `Description` can be searched all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.tables.columns import Columns, Quantity as Quantity
from calibench.discrepancy.model.measured import MeasuredData, Sensor
from calibench.problems.base import Array, Parameter

Numbers = NDArray[Any]  # of floats, or of complex numbers where a test takes a complex step
Quantities = Mapping[str, Numbers]  # name -> (n,), or () where it is the same for every reading

TINY = 1e-30  # of a complex step: exact to rounding
WORKSPACE = "workspace"  # the target whose covariates are where the tool stands, x and y [mm]


def as_is(formulation: Any, rows: Array) -> Array:
    """Return `rows`: the `decorrelate` of a formulation whose readings have noise of their own each."""
    return rows


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
    def unit(self) -> str: ...

    def constraints(self, q: Quantities) -> Numbers:
        """Return the constraints, shape (n, c), at the quantities `q`: zero on a perfect machine without noise."""

    def slopes(self, q: Quantities) -> Mapping[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, c)."""

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows`, shape (n, ...), mixed along the first axis so that noise shared by readings is shared no more.

        Where each row's noise is its own, `rows` as they are; it must be linear and symmetric, as C^-1/2 is. `Model`
        passes residuals, Jacobian and signatures through it, so that after it the stated `sigma` is that of
        independent rows.
        """

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return target -> covariate -> (n,): what a smooth disagreement may depend on.

        A target is a reading or one of the targets that `sensors` state; `WORKSPACE` has the coordinates of the place.
        """

    def on(self, data: MeasuredData) -> Formulation:
        """Return the same constraints over other rows (a held-out part, a resampled set)."""


class Machine(Protocol):
    """A kind of robot: validates its data and states the constraints they support."""

    @property
    def name(self) -> str: ...

    def formulate(self, data: MeasuredData) -> Formulation:
        """Return the constraints that `data` support; raise `DataError` for data that cannot be of this machine."""


@final
@dataclass(frozen=True, eq=False)
class Slopes(Mapping[str, Array]):
    """Slopes in the quantities `names`, each computed by `one(name)` when it is first asked for, and kept.

    A fit asks for those of the free parameters alone: a machine has two or three times as many numbers, and rows may be
    many.
    """

    names: tuple[str, ...]
    one: Callable[[str], Array]
    _kept: dict[str, Array] = field(default_factory=dict, init=False, repr=False)

    def __getitem__(self, name: str) -> Array:
        if name not in self._kept:
            if name not in self.names:
                raise KeyError(name)
            self._kept[name] = self.one(name)
        return self._kept[name]

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


def complex_step_slopes(formulation: Formulation, q: Quantities) -> Slopes:
    """Return the slopes by complex step, exact to rounding: for a machine whose author wrote none, and for tests.

    The constraints must be analytic: no `abs`, no `np.linalg.norm`, no comparison of quantities.
    """

    def one(name: str) -> Array:
        return np.imag(formulation.constraints({**q, name: np.asarray(q[name]) + 1j * TINY})) / TINY

    return Slopes(tuple(q), one)


@final
@dataclass(frozen=True)
class Stated:
    """A key that may be stated of the data beside the file: the required value, and an example of it."""

    key: str
    rule: Literal["any", "positive", "list", "names"] = "any"
    example: str = ""


@final
@dataclass(frozen=True)
class Completed:
    """The data as a further sensor in the same run would complete them, and the name of that sensor in words."""

    data: MeasuredData
    words: str


@final
@dataclass(frozen=True)
class Correction:
    """The findings in the form in which the user enters them into the machine: the text of a file, and its ending."""

    ending: str
    text: str

    @property
    def file(self) -> str:
        """Return the name of the file beside the page."""
        return f"correction{self.ending}"


def last_word(target: str) -> str:
    """Return the part of the machine in a target: 2 for `joint 2` and for `leg 2`."""
    return target.rpartition(" ")[2]


@final
@dataclass(frozen=True)
class Description:
    """What one machine declares.

    `columns` are those of its files, `quantities` what else has a name: parameters, imperfections, covariates made of
    columns. `stated` are the keys that may be given beside a file; None: any. `helpful` are columns of sensors that
    part effects which look alike without them. `plan` makes readings of a named plan, `pool` readings that could be
    taken next, `completed` (formulation, data, parameters by name) the data with a further sensor. `printed` are sets
    of measurements that a paper prints, by name, and `demonstrations` is a folder of files. `part_of` tells the part of
    the machine that a target is about; `targets` has words for targets that are no plain parts. `general`: the general
    families are looked for beside its own; a machine whose rates were measured with a list of its own says no.
    `replaced` are general families that it has under names of its own. `files` are formats of the field, ending
    (".dat") -> a function from a file's text to what it holds; it raises `DataError`. `corrected` writes the calibrated
    numbers and the findings of a search as the machine's owner enters them; None where nothing was calibrated.
    `own_units`: the numbers of a file stay in the units that it states, as the model is its owner's.
    `named` tells of quantities whose names depend on the file (the joints of an arm); None for one it does not know.
    `orders` are columns, beside those of its roles, that tell an order, a direction or a speed: column -> the word.
    `read_from` are columns of which its constraints are computed: in these mistakes of a table are looked for.
    """

    columns: tuple[Quantity, ...] = ()
    quantities: tuple[Quantity, ...] = ()
    stated: tuple[Stated, ...] | None = None
    helpful: tuple[str, ...] = ()
    plan: Callable[..., MeasuredData] | None = None
    pool: Callable[[Formulation, Quantities], MeasuredData] | None = None
    completed: Callable[[Formulation, MeasuredData, Mapping[str, float]], Completed | None] | None = None
    printed: Mapping[str, Callable[[], MeasuredData]] = field(default_factory=dict)
    demonstrations: Path | None = None
    part_of: Callable[[str], str] = last_word
    targets: Mapping[str, str] = field(default_factory=dict)
    general: bool = True
    replaced: tuple[str, ...] = ()
    files: Mapping[str, Callable[[str], Columns]] = field(default_factory=dict)
    corrected: Callable[[Any], Correction | None] | None = None  # of a `Report`, which stands above this room
    named: Callable[[str], Quantity | None] | None = None
    own_units: bool = False
    orders: Mapping[str, str] = field(default_factory=dict)
    read_from: tuple[str, ...] = ()

    def quantity(self, name: str) -> Quantity | None:
        """Return the declaration of a quantity; None where there is none."""
        known = next((q for q in (*self.columns, *self.quantities) if q.name == name), None)
        return self.named(name) if known is None and self.named is not None else known
