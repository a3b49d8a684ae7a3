"""A digest of the code that searched a set: after an edit of a machine its data are searched again."""

from __future__ import annotations

from calibench.bench.provenance.code_digest import digest_of
from calibench.bench.provenance.run_id import digest
from calibench.core.sources import module_digest
from calibench.discrepancy.model.machine import Machine
from calibench.discrepancy.registries import families


def search_digest(machine: Machine) -> str:
    """Return the digest of the code that searches a machine's data: the machine's, its effects', the procedure's."""
    effects = {digest_of(getattr(family.build, "func", family.build)) for family in families(machine.name)}
    return digest(digest_of(machine), sorted(effects), module_digest("calibench.discrepancy.explain"))
