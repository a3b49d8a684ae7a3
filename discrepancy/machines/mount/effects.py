"""The pointing terms as families of effects: each changes one quantity of the mount by a function of the place."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from calibench.discrepancy.machines.mount.geometry import TERMS, Kind, Term, of_kind, seen
from calibench.discrepancy.machines.mount.validate import AXES
from calibench.discrepancy.model.effect import Effect, EffectFamily, LinearEffect, NotTestable
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.problems.base import Array

TARGET = "mount"  # a term has one place in a mount; the word for it is the term's own name
PER_RADIAN = ("PHH", "PDD", "PAA", "PEE")
UNIT = "arcsec"
TWINS: dict[Kind, dict[str, tuple[str, ...]]] = {  # of one signature, beside what is calibrated
    "equatorial": {"DAF": ("HCEC",), "HCEC": ("DAF",)},
    "altaz": {"TF": ("ECEC",), "ECEC": ("TF",)},
}


def unit_of(term: Term) -> str:
    """Return the unit of a term's coefficients."""
    return f"{UNIT}/rad" if term.name in PER_RADIAN else UNIT


def _build(formulation: Formulation, target: str, *, term_name: str) -> tuple[LinearEffect, ...]:
    data = formulation.data
    kind: Kind = "equatorial" if "ha" in data else "altaz"
    term = next((term for term in of_kind(kind) if term.name == term_name), None)
    if term is None:
        return ()  # a term of the other kind of mount: nothing that these data lack
    if term.name in (p.name for p in formulation.parameters):
        raise NotTestable("is calibrated in every case (machine.base=geometry)")
    if term.name.startswith("pier_") and not np.ptp(data["side"]):
        raise NotTestable("all stars were observed on one side of the pier")
    latitude = float(np.radians(data.metadata.get("latitude_deg", 0.0)))

    def changes(terms: Sequence[Term], q: Quantities, data: MeasuredData) -> dict[str, Array]:
        at = seen(kind, latitude, *(np.asarray(data[name], dtype=float) for name in AXES[kind]))
        if "side" in data:
            at["side"] = np.asarray(data["side"], dtype=float)
        return {term.quantity: np.stack([one.shape(at) for one in terms], axis=1)}

    def effect(*terms: Term, whole: Effect | None = None) -> LinearEffect:
        unit, own = unit_of(term), ("side",) if term.name.startswith("pier_") else ()
        twins = tuple(f"{twin} {target}" for twin in TWINS[kind].get(term.name, ()))
        return LinearEffect(
            term.name, target, term.formula, channel="link", columns=own,
            coefficients=tuple(one.name for one in terms), units=(unit,) * len(terms), unit=unit,
            changes=partial(changes, terms), twins=twins, over=AXES[kind], whole=whole,
        )  # fmt: skip

    other = next((one for one in of_kind(kind) if one.name == term.phase), None)
    return (effect(term, whole=effect(term, other) if other else None),)


def own_effects(formulation: Formulation) -> tuple[LinearEffect, ...]:
    """Return every term of the field that these data can test."""
    found: tuple[LinearEffect, ...] = ()
    for name in FAMILIES:
        try:
            found += _build(formulation, TARGET, term_name=name)
        except NotTestable:
            continue
    return found


def _families() -> dict[str, EffectFamily]:
    found: dict[str, EffectFamily] = {}
    for term in TERMS:
        if term.name in found:
            continue  # TF and TX are terms of both kinds
        found[term.name] = EffectFamily(
            term.name, "mount", term.cause, formula=term.formula, channel="link", columns=(), unit=unit_of(term),
            targets=(TARGET,), build=partial(_build, term_name=term.name), label=_label(term), code=term.name,
        ).enter()  # fmt: skip
    return found


def _label(term: Term) -> str:
    """Return the field's name with the cause behind it: `CH (the tube is not square to ...)`."""
    words, _, which = term.cause.partition(" (")
    begins = words if words.startswith(term.quantity) else f"{words[0].lower()}{words[1:]}"  # a term keeps its name
    circle = words.startswith("The circle")  # HCES beside HCEC
    part = {"sin)": ", sine", "cos)": ", cosine"}.get(which, "") if circle else ""
    return f"{term.name} ({begins}{part})"


FAMILIES = _families()
