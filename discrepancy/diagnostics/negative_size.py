"""Names whose size came out negative, where no machine has a negative one.

From 30 random poses of a measured arm, one search named a compliance that gives way against its load, and one a
negative play; both made the error of the other poses larger (`docs/discovery-statistics.md`).
"""

from __future__ import annotations

from collections.abc import Sequence

from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.labels import effect_label, quantity_label
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.registries import family_of
from calibench.discrepancy.report import Finding


def negative_size(final: Fit, findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return a note for each finding whose whole interval is negative, though its family's size never is."""
    formulation = final.model.formulation
    machine, words = formulation.data.machine, words_of(roles_of(formulation))
    columns = {name_of(e): e.columns for e in final.model.effects}
    notes = []
    for one in findings:
        family = family_of(machine, one.family)
        what = family.never_negative if family else ""
        if not what or not max(one.amplitude.ci95) < 0:
            continue
        told = " and ".join(f"the {quantity_label(machine, name, words)}" for name in columns.get(one.effect, ()))
        notes.append(
            f"the size of {effect_label(machine, one.family, one.target)} is negative, and a {what} never is: either "
            f"{told or 'a column'} has the other sign, or another cause acts like it"
        )
    return tuple(notes)
