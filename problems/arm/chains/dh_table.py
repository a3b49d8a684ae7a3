"""`DhTable`: the rows of Denavit and Hartenberg's table as values, in mm and rad, and the chain that they make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.dh import Form, RowKind, chain_of_table

NUMBERS = ("theta", "d", "a", "alpha", "beta")
BASE, TIP = "base", "flange"


@final
@dataclass(frozen=True)
class DhRow:
    """One row: its joint's name, its numbers [mm, rad] and the joint's limits (infinite where there is no stop)."""

    name: str
    kind: RowKind = "rotary"
    theta: float = 0.0
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf


@final
@dataclass(frozen=True, eq=False)
class DhTable:
    """Rows from base to flange, in the `form` "standard" or "modified" (Craig's).

    `length` and `angle` are the units in which its file has its numbers; `notes` say what was found and not stated.
    """

    rows: tuple[DhRow, ...]
    form: Form = "standard"
    name: str = "arm"
    length: str = "mm"
    angle: str = "rad"
    notes: tuple[str, ...] = ()

    @cached_property
    def chain(self) -> Chain:
        """Return the chain from `base` to `flange`. Raises `ChainError` where no row moves, or two have one name."""
        made = chain_of_table([vars(row) for row in self.rows], self.form, self.name)
        return replace(made, base=BASE, tip=TIP, told="table")

    @property
    def moving(self) -> tuple[DhRow, ...]:
        """Return the rows whose joints move."""
        return tuple(row for row in self.rows if row.kind != "fixed")
