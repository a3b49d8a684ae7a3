"""What an effect is: named physics that changes quantities of a machine, and is the identity at zero coefficients."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, cast, final, runtime_checkable

from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.problems.base import Array


class Effect(Protocol):
    """One candidate: a family (`backlash`) on a target (`joint 2`), with its exact form and its derivative.

    `columns` are those it needs; `channel` says what it acts on (reading, link, base, prediction); `twins` are names
    (`family target`) of candidates that leave the same signature whatever the data, by declared physics.
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


@final
@dataclass(frozen=True, eq=False)
class Moment:
    """The position of something, `at` (n,), while an effect acts: its change of `of` is one of `quantity` there.

    Where `quantity` is another than `of`, it is the change of `of` at this moment relative to home, where `at` is zero.
    """

    quantity: str
    of: str
    at: Array


Along = Callable[[MeasuredData], Mapping[str, Sequence[Moment]]]  # covariate -> the moments at which an effect acts


def along_of(effect: Effect) -> Along | None:
    """Return the function that gives the positions at which an effect acts; None for an effect without one."""
    return cast(Along | None, getattr(effect, "along", None))


def over_of(effect: Effect) -> tuple[str, ...]:
    """Return the columns that together are the place on which an effect's size may depend; () for one without."""
    return cast(tuple[str, ...], getattr(effect, "over", ()))


def whole_of(effect: Effect) -> Effect | None:
    """Return the cause, of any phase, of which an effect is the sine or the cosine; None for any other effect."""
    return cast("Effect | None", getattr(effect, "whole", None))


@final
@dataclass(frozen=True, eq=False)
class Alternative:
    """A candidate that is never named alone, but joins a set beside a name that data cannot tell from it.

    `largest` is the amplitude, in the effect's unit, up to which it does.
    """

    effect: Effect
    largest: float = math.inf


@final
@dataclass(frozen=True, eq=False)
class HeldBack:
    """The result of a family for a target that is not searched for alone: the reason, and its alternatives."""

    reason: str
    alternatives: tuple[Alternative, ...]


@final
@dataclass(frozen=True)
class Untestable:
    """A family, or one target of it, that these data cannot test, and the reason.

    `columns` are those in the reason. `missing`: the data do not have them; with them the target could be tested.
    """

    family: str
    target: str
    reason: str
    columns: tuple[str, ...] = ()
    missing: bool = False


@final
@dataclass(frozen=True, eq=False)
class Catalogue:
    """What data can test: candidates that are looked for, alternatives to what is named, and what cannot be tested.

    Several candidates of one name are several forms or places of one cause, of which the best is kept.
    """

    candidates: tuple[Effect, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    untestable: tuple[Untestable, ...] = ()

    def __add__(self, other: Catalogue) -> Catalogue:
        return Catalogue(
            (*self.candidates, *other.candidates),
            (*self.alternatives, *other.alternatives),
            (*self.untestable, *other.untestable),
        )


class NotTestable(Exception):
    """Raised where these data cannot test one target of a family.

    `columns` are those in the message; `missing`: the data do not have them.
    """

    def __init__(self, why: str, columns: tuple[str, ...] = (), missing: bool = False) -> None:
        super().__init__(why)
        self.columns = columns
        self.missing = missing


def name_of(effect: Effect) -> str:
    """Return the name of an instance: its family and its target."""
    return f"{effect.family} {effect.target}"


@runtime_checkable
class OfFreePeriod(Protocol):
    """An effect whose period is fitted, by its last coefficient, which moves the frequency."""

    @property
    def period_unit(self) -> str:
        """Return the unit of the column over which it repeats, "" where nobody states it."""
        ...

    def period(self, c: Array) -> float:
        """Return the period at coefficients c, in `period_unit`."""
        ...


def has_free_period(effect: Effect) -> bool:
    """Return whether an effect is `OfFreePeriod`.

    The answer is cached for each class, because a protocol check is slow.
    """
    kind = type(effect)
    if kind not in _FREE:
        _FREE[kind] = isinstance(effect, OfFreePeriod)
    return _FREE[kind]


_FREE: dict[type, bool] = {}  # what a class is does not change


def still_open(candidates: Iterable[Effect], taken: Collection[str]) -> list[Effect]:
    """Return the candidates beside effects whose names are `taken`, without these and those that must come later.

    A candidate that comes after another comes after all before that one: the fourth of a kind is tried when three are
    taken.
    """
    known = list(candidates)
    before = {name_of(e): str(getattr(e, "after", "")) for e in known}

    def is_open(name: str) -> bool:
        while name := before.get(name, ""):
            if name not in taken:
                return False
        return True

    opened = {name: name not in taken and is_open(name) for name in before}
    return [e for e in known if opened[name_of(e)]]


def is_possible(effect: Effect, size: float) -> bool:
    """Return whether an effect may have such an amplitude; any is possible for an effect that states no `largest`."""
    return bool(abs(size) <= getattr(effect, "largest", math.inf))
