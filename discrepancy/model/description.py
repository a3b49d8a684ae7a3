"""`Description`: what a machine declares, beside its constraints, for files, commands and pages.

Columns with units, what may be stated of the data, words for what it calls its parts, plans, and the sets that ship.
A machine without a description can be searched all the same: its columns are told by their names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import Column, MeasuredData


@final
@dataclass(frozen=True)
class Quantity:
    """A named number of every reading: its unit ("" for a count), and its name in words.

    `own` is the target to which it belongs (the torque of leg 2), where each target has one. `text`: it holds words.
    """

    name: str
    unit: str = ""
    label: str = ""
    own: str = ""
    text: bool = False


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
@dataclass(frozen=True, eq=False)
class Foreign:
    """The content of a file in the field's own format: columns in base units, statements, and remarks."""

    columns: Mapping[str, Column]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


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
    columns. `stated` are the keys that may be given beside a file; none: any. `helpful` are columns of sensors that
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
    """

    columns: tuple[Quantity, ...] = ()
    quantities: tuple[Quantity, ...] = ()
    stated: tuple[Stated, ...] = ()
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
    files: Mapping[str, Callable[[str], Foreign]] = field(default_factory=dict)
    corrected: Callable[[Any], Correction | None] | None = None  # of a `Report`, which stands above this room
    named: Callable[[str], Quantity | None] | None = None
    own_units: bool = False

    def quantity(self, name: str) -> Quantity | None:
        """Return the declaration of a quantity; None where there is none."""
        known = next((q for q in (*self.columns, *self.quantities) if q.name == name), None)
        return self.named(name) if known is None and self.named is not None else known
