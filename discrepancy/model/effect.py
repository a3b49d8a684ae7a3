"""What an effect is: named physics that changes quantities of a machine, and is the identity at zero coefficients."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, final

from discrepancy.model.data import MeasuredData
from discrepancy.model.machine import Formulation, Quantities
from problems.base import Array


class Effect(Protocol):
    """One candidate: a family (`backlash`) on a target (`joint 2`), with its exact form and its derivative.

    `columns` are those it needs; `channel` says what it acts on (reading, link, base, prediction); `twins` are names
    (`family target`) of candidates that leave the same trace whatever the data, by declared physics.
    `coefficients` are the names of its numbers with `units`; `amplitude` turns them into the one number an engineer
    quotes, in `unit`. `positions` is how many places of a change point were scanned to find it: 1 for all others.
    """

    @property
    def family(self) -> str: ...
    @property
    def target(self) -> str: ...
    @property
    def formula(self) -> str: ...
    @property
    def channel(self) -> str: ...
    @property
    def columns(self) -> tuple[str, ...]: ...
    @property
    def twins(self) -> tuple[str, ...]: ...
    @property
    def coefficients(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def unit(self) -> str: ...
    @property
    def positions(self) -> int: ...

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,): what it truly is minus what is recorded or nominal, at coefficients c, (k,)."""
        ...

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the derivative of `shift` in the coefficients, quantity -> (n, k)."""
        ...

    def amplitude(self, c: Array) -> float:
        """Return the size an engineer quotes, in `unit`, of coefficients of shape (k,)."""
        ...


class Family(Protocol):
    """One physical cause on one kind of machine, with what the catalogue's page says of it.

    `columns` may hold `{i}` for the number of the target, and `metadata.NAME`. `twins` is a sentence for readers; those
    of a candidate are names. Called with the constraints of the data it returns its candidates: several of one name
    are several forms or places of one cause, of which the best is kept. For what cannot be tested it raises
    `NotTestable`.
    """

    @property
    def name(self) -> str: ...
    @property
    def machine(self) -> str: ...
    @property
    def cause(self) -> str: ...
    @property
    def formula(self) -> str: ...
    @property
    def channel(self) -> str: ...
    @property
    def columns(self) -> tuple[str, ...]: ...
    @property
    def unit(self) -> str: ...
    @property
    def targets(self) -> tuple[str, ...]: ...
    @property
    def twins(self) -> str: ...

    def candidates(self, formulation: Formulation) -> tuple[Effect, ...]: ...


@final
@dataclass(frozen=True, eq=False)
class Beside:
    """A candidate that is never named, but stands beside a name it cannot be told from, up to the size `largest`."""

    effect: Effect
    largest: float = math.inf


class NotTestable(Exception):
    """These data cannot test a family, or some of its targets; the message names the columns that are missing.

    `reasons` is target -> why; `others` are the candidates of the family that can be tested all the same, `beside`
    those of the targets with a reason that what is named is held against.
    """

    def __init__(
        self, why: str, reasons: Mapping[str, str] | None = None, others: tuple[Effect, ...] = (),
        beside: tuple[Beside, ...] = (),
    ) -> None:  # fmt: skip
        super().__init__(why)
        self.reasons = dict(reasons or {})
        self.others = others
        self.beside = beside


def name_of(effect: Effect) -> str:
    """Return the name of an instance: its family and its target."""
    return f"{effect.family} {effect.target}"


Coefficients = Mapping[str, Array]  # name of the effect -> (k,)
