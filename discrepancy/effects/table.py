"""The catalogue as the tables of its page: ``python -m calibench.discrepancy.effects.table``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from calibench.discrepancy.model.effect import EffectFamily
from calibench.discrepancy.registries import GENERAL, machines, own_families

_HEAD = (
    "Family",
    "What goes wrong",
    "Formula",
    "Columns",
    "Unit",
    "Targets",
    "Twins",
)


def table(machine: str) -> str:
    """Return the families entered for one machine as a Markdown table, a row each, in the order of their names.

    A column in which all rows agree stands above the table once; cosine and sine of one cause share a row.
    """
    rows = _waves([_row(family) for family in sorted(own_families(machine), key=lambda family: family.name)])
    same = [i for i in range(2, len(_HEAD)) if len({row[i] for row in rows}) == 1 and len(rows) > 1]
    shown = [tuple(cell for i, cell in enumerate(line) if i not in same) for line in (_HEAD, *rows)]
    lines = [shown[0], ("---",) * len(shown[0]), *shown[1:]]
    common = "; ".join(f"{_HEAD[i].lower()}: {rows[0][i] or 'none'}" for i in same)
    above = f"Of all: {common}.\n\n" if common else ""
    return above + "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _row(family: EffectFamily) -> tuple[str, ...]:
    columns = ", ".join(f"`{column}`" for column in family.columns)
    formula = f"`{family.formula}`".replace("|", "\\|")
    targets = _grouped(family.targets)
    return (f"`{family.name}`", family.cause, formula, columns, family.unit, targets, family.twins or "")


def _waves(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the rows with those joined whose causes differ in nothing but an ending "(cos)" or "(sin)"."""
    groups: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for row in rows:
        groups.setdefault((re.sub(r" \((cos|sin)\)$", "", row[1]), *row[3:]), []).append(row)
    return [
        (", ".join(row[0] for row in group), cause, ", ".join(row[2] for row in group), *others)
        for (cause, *others), group in groups.items()
    ]


def _grouped(targets: Sequence[str]) -> str:
    """Return the targets with a first word that they share said once.

    >>> _grouped(("joint 1", "joint 2", "all"))
    'joint 1, 2; all'
    """
    groups: dict[str, list[str]] = {}
    for target in targets:
        first, _, rest = target.partition(" ")
        groups.setdefault(first, []).append(rest)
    return "; ".join(f"{first} {', '.join(rest)}".rstrip() for first, rest in groups.items())


if __name__ == "__main__":
    for name in (GENERAL, *machines.names()):
        print(f"## {name}\n\n{table(name)}\n")
