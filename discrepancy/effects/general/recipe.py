"""`Recipe`: a general cause, made into a family for all machines, and into families of machines with their own words.

The changes of the quantities are stated once. A machine that has names, formulas or twins of its own enters the same
physics under them (`recipe.enter("gpm2002", targets, ...)`). All others get the general family, as far as their roles
allow it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, final

from calibench.discrepancy.model.effect import Effect, EffectFamily, HeldBack, NotTestable
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import ALL, Instrument, Joint, Length, roles_of
from calibench.discrepancy.registries import GENERAL

Built = tuple[Effect, ...] | HeldBack
Make = Callable[[EffectFamily, Formulation, str], Built]
Twins = Callable[[Formulation, str], tuple[str, ...]]


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
        """Enter the family of one machine, or the general one, and return it.

        `words` are fields of `EffectFamily` that differ. `twins_of(formulation, target)` are the twins by the machine's
        physics.
        """

        if targets is not None:
            words |= {"targets": targets, "targets_in": None}
        family = replace(self.words, machine=machine, **words)
        make = self.make if twins_of is None else _twinned(self.make, twins_of)
        family = replace(family, build=partial(make, family))
        return family.enter()


def _twinned(make: Make, twins_of: Twins) -> Make:
    def twinned(family: EffectFamily, formulation: Formulation, target: str) -> Built:
        built = make(family, formulation, target)
        if isinstance(built, HeldBack):
            return built
        twins = twins_of(formulation, target)
        return tuple(replace(effect, twins=twins) for effect in built)  # type: ignore[type-var]

    return twinned


def recipe(
    name: str, cause: str, formula: str, channel: str, columns: tuple[str, ...], unit: str, targets: str,
    targets_in: Callable[[Formulation], tuple[str, ...]], make: Make, **more: Any,
) -> Recipe:  # fmt: skip
    """Return a recipe; `targets` are words for what `targets_in` finds in the roles of a formulation."""

    def build(formulation: Formulation, target: str) -> Built:
        raise NotImplementedError(name)

    words = EffectFamily(
        name,
        GENERAL,
        cause,
        formula=formula,
        channel=channel,
        columns=columns,
        unit=unit,
        targets=(targets,),
        build=build,
        targets_in=targets_in,
        **more,
    )
    return Recipe(words, make)


def each_joint(formulation: Formulation) -> tuple[str, ...]:
    """Return the names of the joints."""
    return tuple(joint.name for joint in roles_of(formulation).joints)


def each_joint_and_all(formulation: Formulation) -> tuple[str, ...]:
    """Return the names of the joints, and of several `all`."""
    return (*each_joint(formulation), *(ALL,) * (len(roles_of(formulation).joints) > 1))


def each_length(formulation: Formulation) -> tuple[str, ...]:
    """Return the names of the lengths."""
    return tuple(length.name for length in roles_of(formulation).lengths)


def each_length_and_all(formulation: Formulation) -> tuple[str, ...]:
    """Return the names of the lengths, and of several `all`."""
    return (*each_length(formulation), *(ALL,) * (len(roles_of(formulation).lengths) > 1))


def each_instrument(formulation: Formulation) -> tuple[str, ...]:
    """Return the names of the instruments."""
    return tuple(instrument.name for instrument in roles_of(formulation).instruments)


def joints_of(formulation: Formulation, target: str) -> tuple[Joint, ...]:
    """Return the joint that a target is, or all of them; `LookupError` where there is none of that name."""
    return tuple(j for j in roles_of(formulation).joints if target in (j.name, ALL)) or _none(target)


def lengths_of(formulation: Formulation, target: str) -> tuple[Length, ...]:
    """Return the length that a target is, or all of them."""
    return tuple(one for one in roles_of(formulation).lengths if target in (one.name, ALL)) or _none(target)


def instrument_of(formulation: Formulation, target: str) -> Instrument:
    """Return the instrument that a target is."""
    return next((one for one in roles_of(formulation).instruments if one.name == target), None) or _none(target)


def unit_of(formulation: Formulation, *columns: str) -> str:
    """Return the unit in which measured columns are kept: the common unit of their sensors, or else the residuals'."""
    units = {sensor.unit for sensor in formulation.sensors if sensor.column in columns}
    return (units.pop() if len(units) == 1 else "") or formulation.unit


def declared(column: str, part: str, what: str) -> str:
    """Return a column that a role declares; raise `NotTestable`, which says what to declare, where it declares none."""
    if not column:
        raise NotTestable(f"{part} declares no {what}: with a column of it this could be tested", (), missing=True)
    return column


def _none(target: str) -> Any:
    raise LookupError(f"no part is called {target!r}")
