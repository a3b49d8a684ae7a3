"""The registered machines and effects, by name; other packages register theirs through entry points.

The machines that ship are loaded when one of them, or what they declare, is first asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from calibench.core.registry import Registry
from calibench.discrepancy.model.machine import Description, Machine

if TYPE_CHECKING:
    from calibench.discrepancy.model.effect import EffectFamily

machines: Registry[Machine] = Registry("machine", "calibench.machines")
effects: Registry[EffectFamily] = Registry("effect", "calibench.effects")
_FOLDERS = iter_modules([str(Path(__file__).parent / "machines")])  # a folder each, of its name
machines.promise("calibench.discrepancy.machines", *(one.name for one in _FOLDERS if one.ispkg))
DEMONSTRATIONS = Path(__file__).resolve().parent / "demo"  # a folder for each machine of which sets of data ship
GENERAL = "general"  # the machine of families that serve every machine whose roles allow it
_descriptions: dict[str, Description] = {}


def load_shipped() -> None:
    """Load the machines that ship, each of which registers itself and its effects; again it does nothing."""
    import_module("calibench.discrepancy.machines")


def describe(machine: str, description: Description) -> None:
    """Declare the columns, words, plans and shipped sets of a machine, once. Raises `ValueError` the second time."""
    load_shipped()  # first, so that they stand first
    if machine in _descriptions:
        raise ValueError(f"machine {machine!r} is described twice")
    if description.demonstrations is None and (DEMONSTRATIONS / machine).is_dir():
        description = replace(description, demonstrations=DEMONSTRATIONS / machine)
    _descriptions[machine] = description


def description_of(machine: str) -> Description:
    """Return the description of a machine; an empty one where it declares none."""
    return descriptions().get(machine, Description())


def descriptions() -> Mapping[str, Description]:
    """Return machine -> its description, in order of registration."""
    load_shipped()
    return _descriptions


def families(machine: str) -> tuple[EffectFamily, ...]:
    """Return the families of effects that a machine is searched for, by name: its own, then the general ones.

    A family of its own replaces a general one of the same name. A machine may also declare that it has no others.
    """
    own = own_families(machine)
    if machine == GENERAL or not description_of(machine).general:
        return own
    taken = {*(family.name for family in own), *description_of(machine).replaced}
    return (*own, *(family for family in own_families(GENERAL) if family.name not in taken))


def own_families(machine: str) -> tuple[EffectFamily, ...]:
    """Return the families entered for one machine, by name, those of other packages among them."""
    load_shipped()
    known = (entered() for entered in effects.factories().values())
    return tuple(family for family in known if family.machine == machine)


def family_of(machine: str, name: str) -> EffectFamily | None:
    """Return one family that a machine is searched for; None where there is none of that name."""
    return next((family for family in families(machine) if family.name == name), None)
