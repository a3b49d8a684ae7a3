"""The tables of docs/effects.md, made from what the catalogue holds.

``python -m benchmarks.tables`` prints them; their rows are put there by hand, and a test holds the page to them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from calibench.bench.report.shared.page import table
from calibench.discrepancy.model.effect import EffectFamily
from calibench.discrepancy.registries import GENERAL, machines, own_families
from calibench.discrepancy.thresholds import about

_OF_EFFECTS = ("Family", "What goes wrong", "Formula", "Columns", "Unit", "Targets", "Twins")


def effects_table(machine: str) -> str:
    """Return the families entered for one machine as a Markdown table, a row each, in the order of their names.

    A column in which all rows agree stands above the table once; cosine and sine of one cause share a row. A general
    cause that the machine has in its own words, and without twins, is a name, its columns and targets below the table.
    """
    general = () if machine == GENERAL else {_acts(family) for family in own_families(GENERAL)}
    mine = sorted(own_families(machine), key=lambda family: family.name)
    known = [family for family in mine if _acts(family) in general and not family.twins]
    rows = _waves([_row(family) for family in mine if family not in known])
    same = [i for i in range(2, len(_OF_EFFECTS)) if len({row[i] for row in rows}) == 1 and len(rows) > 1]
    head, *shown = ([cell for i, cell in enumerate(line) if i not in same] for line in (_OF_EFFECTS, *rows))
    common = "; ".join(f"{_OF_EFFECTS[i].lower()}: {rows[0][i] or 'none'}" for i in same)
    as_there = "; ".join(f"{name} ({columns}): {targets}" for name, _, _, columns, _, targets, _ in map(_row, known))
    below = f"\n\nAs in [general](#general): {as_there}." if as_there else ""
    return (f"Of all: {common}.\n\n" if common else "") + table(head, shown) + below


def _acts(family: EffectFamily) -> tuple[str, str, int]:
    return family.name, family.channel, len(family.columns)


def bounds_table() -> str:
    """Return the sizes above which no machine has an effect: threshold, value, the families and the reason."""
    bounded: dict[str, list[str]] = {}
    for machine in (GENERAL, *machines.names()):
        for family in sorted(own_families(machine), key=lambda one: one.name):
            for bound in family.bounds:
                bounded.setdefault(bound, []).append(f"`{family.name}`")
    rows = [
        [f"{field.default:g} {field.metadata['unit']}".removesuffix(" 1"), f"`{name}`",
         ", ".join(dict.fromkeys(bounded[name])), field.metadata["meaning"]]
        for name, field in about().items() if name in bounded
    ]  # fmt: skip
    return table(["most", "threshold", "families", "why"], rows)


def _row(family: EffectFamily) -> tuple[str, ...]:
    columns = ", ".join(f"`{column}`" for column in family.columns)
    formula = f"`{family.formula}`".replace("|", "\\|")
    targets: dict[str, list[str]] = {}  # a first word that several share is said once: joint 1, 2; all
    for target in family.targets:
        first, _, rest = target.partition(" ")
        targets.setdefault(first, []).append(rest)
    grouped = "; ".join(f"{first} {', '.join(rest)}".rstrip() for first, rest in targets.items())
    return (f"`{family.name}`", family.cause, formula, columns, family.unit, grouped, family.twins or "")


def _waves(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the rows with those joined whose causes differ in nothing but an ending "(cos)" or "(sin)"."""
    groups: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for row in rows:
        groups.setdefault((re.sub(r" \((cos|sin)\)$", "", row[1]), *row[3:]), []).append(row)
    return [
        (", ".join(row[0] for row in group), cause, ", ".join(row[2] for row in group), *others)
        for (cause, *others), group in groups.items()
    ]


if __name__ == "__main__":
    print(f"{bounds_table()}\n")
    for name in (GENERAL, *machines.names()):
        print(f"## {name}\n\n{effects_table(name)}\n")
