"""`Recipe`: a general cause, made into a family for all machines, and into families of machines with their own words.

The changes of the quantities are stated once. A machine that has names, formulas or twins of its own enters the same
physics under them (`recipe.enter("gpm2002", targets, ...)`). All others get the general family, as their roles allow.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeVar, final

from calibench.discrepancy.model.effect import Built as Built, EffectFamily, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import ALL, Instrument, Joint, Length, roles_of
from calibench.discrepancy.registries import GENERAL

Make = Callable[[EffectFamily, Formulation, str], Built]
Twins = Callable[[Formulation, str], tuple[str, ...]]
_Part = TypeVar("_Part", Joint, Length, Instrument)


@final
@dataclass(frozen=True, eq=False)
class Recipe:
    """The words of a family, `make(words, formulation, target)` for its candidates, and the targets that roles have."""

    words: EffectFamily
    make: Make

    def enter(
        self, machine: str = GENERAL, targets: tuple[str, ...] | None = None, twins_of: Twins | None = None,
        **words: Any,
    ) -> EffectFamily:  # fmt: skip
        """Enter the family of one machine, or the general one, and return it; `words` are fields that differ.

        `twins_of(formulation, target)` are the twins by the machine's physics.
        """
        if targets is not None:
            words |= {"targets": targets, "targets_in": None}
        family = replace(self.words, machine=machine, **words)

        def build(formulation: Formulation, target: str) -> Built:
            built = self.make(family, formulation, target)
            return built if twins_of is None else changed(built, twins=twins_of(formulation, target))

        build.__wrapped__ = self.make  # type: ignore[attr-defined]  # whose code it is
        return replace(family, build=build).enter()


def changed(built: Built, **fields: Any) -> Built:
    """Return candidates with other `fields`."""
    return tuple(replace(one, **fields) for one in (built if isinstance(built, tuple) else (built,)))  # type: ignore[type-var]


def recipe(
    name: str, cause: str, formula: str, channel: str, columns: tuple[str, ...], unit: str, targets: str,
    targets_in: Callable[[Formulation], tuple[str, ...]], make: Make, **more: Any,
) -> Recipe:  # fmt: skip
    """Return a recipe; `targets` are words for what `targets_in` finds in the roles of a formulation."""
    words = EffectFamily(
        name=name, machine=GENERAL, cause=cause, formula=formula, channel=channel, columns=columns, unit=unit,
        targets=(targets,), build=lambda formulation, target: (), targets_in=targets_in, **more,
    )  # fmt: skip
    return Recipe(words, make)


def each(
    role: Literal["joints", "lengths", "instruments"], kind: str = "", *, and_all: bool = False
) -> Callable[[Formulation], tuple[str, ...]]:
    """Return the function that finds the targets of a role: its parts, those of a `kind`, and of several `all`."""

    def targets_in(formulation: Formulation) -> tuple[str, ...]:
        parts = getattr(roles_of(formulation), role)
        names = tuple(part.name for part in parts if not kind or part.kind == kind)
        return (*names, ALL) if and_all and len(names) > 1 else names

    return targets_in


of_joints = partial(
    recipe, channel="reading", unit="that of the joint", targets="each joint", targets_in=each("joints"),
)  # fmt: skip
of_columns = partial(
    recipe, channel="prediction", columns=("the column",), unit="that of the measurement",
    targets="each further column",
)  # fmt: skip


def named(parts: tuple[_Part, ...], target: str) -> tuple[_Part, ...]:
    """Return the joint, length or instrument that a target is, or all; `LookupError` where none has that name."""
    if found := tuple(part for part in parts if target in (part.name, ALL)):
        return found
    raise LookupError(f"no part is called {target!r}")


def unit_of(formulation: Formulation, *columns: str) -> str:
    """Return the unit in which measured columns are kept: the common unit of their sensors, or else the residuals'."""
    units = {sensor.unit for sensor in formulation.sensors if sensor.column in columns}
    return (units.pop() if len(units) == 1 else "") or formulation.unit


def declared(column: str, part: str, what: str) -> str:
    """Return a column that a role declares; raise `NotTestable`, which says what to declare, where it declares none."""
    if not column:
        raise NotTestable(f"{part} declares no {what}: with a column of it this could be tested", (), missing=True)
    return column


def clock_of(formulation: Formulation, part: str = "the machine") -> str:
    """Return the column of the clock; raise `NotTestable` where there is none, or it stands still."""
    clock = declared(roles_of(formulation).time, part, "time")
    needs(formulation.data, clock)
    return clock
