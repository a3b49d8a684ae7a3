"""The pointing terms as families of effects: each changes one quantity of the mount by a function of the place."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from calibench.discrepancy.machines.mount.geometry import AXES, TERMS, Kind, Term, direction, zenith
from calibench.discrepancy.model.effect import Effect, EffectFamily, LinearEffect, NotTestable
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.problems.base import Array

TARGET = "mount"  # a term has one place in a mount; the word for it is the term's own name
_SCALES = ("PHH", "PDD", "PAA", "PEE")
TWINS: dict[Kind, dict[str, tuple[str, ...]]] = {  # of one signature, beside what is calibrated
    "equatorial": {"DAF": ("HCEC",), "HCEC": ("DAF",)},
    "altaz": {"TF": ("ECEC",), "ECEC": ("TF",)},
}


def build(formulation: Formulation, target: str, *, term_name: str) -> tuple[LinearEffect, ...]:
    """Return the candidate of a term; () for one of the other kind of mount, which these data do not lack."""
    data = formulation.data
    kind: Kind = "equatorial" if "ha" in data else "altaz"
    terms = {term.name: term for term in TERMS if term.kind == kind}
    term = terms.get(term_name)
    if term is None:
        return ()
    if term.name in (p.name for p in formulation.parameters):
        raise NotTestable("is calibrated in every case (machine.base=geometry)")
    if term.name.startswith("pier_") and not np.ptp(data["side"]):
        raise NotTestable("all stars were observed on one side of the pier")
    latitude = float(np.radians(data.metadata.get("latitude_deg", 0.0)))

    def changes(terms: Sequence[Term], q: Quantities, data: MeasuredData) -> dict[str, Array]:
        roll, pitch = (np.asarray(data[name], dtype=float) for name in AXES[kind])
        side = np.asarray(data["side"], dtype=float) if "side" in data else np.where(np.cos(pitch) < 0, -1.0, 1.0)
        at = {"roll": roll, "pitch": pitch, "height": direction(roll, pitch) @ zenith(kind, latitude), "side": side}
        return {term.quantity: np.stack([one.shape(at) for one in terms], axis=1)}

    def effect(*terms: Term, whole: Effect | None = None) -> LinearEffect:
        unit = "arcsec/rad" if term.name in _SCALES else "arcsec"
        own = ("side",) if term.name.startswith("pier_") else ()
        twins = tuple(f"{twin} {target}" for twin in TWINS[kind].get(term.name, ()))
        return LinearEffect(
            term.name, target, term.formula, channel="link", columns=own,
            coefficients=tuple(one.name for one in terms), units=(unit,) * len(terms), unit=unit,
            changes=partial(changes, terms), twins=twins, over=AXES[kind], whole=whole,
        )  # fmt: skip

    other = terms.get(term.phase)
    return (effect(term, whole=effect(term, other) if other else None),)


FAMILIES: dict[str, EffectFamily] = {}
for _term in {term.name: term for term in TERMS}.values():  # TF and TX are terms of both kinds, in the same words
    # by the field's name with the cause behind it: `CH (the tube is not square to ...)`
    _words, _, _which = _term.cause.partition(" (")
    _begins = _words if _words.startswith(_term.quantity) else f"{_words[0].lower()}{_words[1:]}"
    _circle = _words.startswith("The circle")  # HCES beside HCEC
    _part = {"sin)": ", sine", "cos)": ", cosine"}.get(_which, "") if _circle else ""
    FAMILIES[_term.name] = EffectFamily(
        _term.name, "mount", _term.cause, formula=_term.formula, channel="link", columns=(),
        unit="arcsec/rad" if _term.name in _SCALES else "arcsec", targets=(TARGET,),
        build=partial(build, term_name=_term.name), label=f"{_term.name} ({_begins}{_part})", code=_term.name,
    ).enter()  # fmt: skip
