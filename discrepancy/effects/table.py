"""The catalogue as the tables of its page: ``python -m discrepancy.effects.table``."""

from __future__ import annotations

from calibench.discrepancy.model.family import EffectFamily
from calibench.discrepancy.registries import GENERAL, machines, own_families

_HEAD = (
    "Family",
    "What goes wrong",
    "Formula (true minus recorded, or nominal)",
    "Columns",
    "Unit",
    "Targets",
    "Twins",
)


def table(machine: str) -> str:
    """Return the families entered for one machine as a Markdown table, a row each, in the order of their names.

    A column in which all rows agree stands above the table once.
    """
    rows = [_row(family) for family in sorted(own_families(machine), key=lambda family: family.name)]
    same = [i for i in range(2, len(_HEAD)) if len({row[i] for row in rows}) == 1 and len(rows) > 1]
    shown = [tuple(cell for i, cell in enumerate(line) if i not in same) for line in (_HEAD, *rows)]
    lines = [shown[0], ("---",) * len(shown[0]), *shown[1:]]
    common = "; ".join(f"{_HEAD[i].lower()}: {rows[0][i] or 'none'}" for i in same)
    above = f"Of all: {common}.\n\n" if common else ""
    return above + "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _row(family: EffectFamily) -> tuple[str, ...]:
    columns = ", ".join(f"`{column}`" for column in family.columns)
    formula = f"`{family.formula}`".replace("|", "\\|")
    targets = ", ".join(family.targets)
    return (f"`{family.name}`", family.cause, formula, columns, family.unit, targets, family.twins or "")


if __name__ == "__main__":
    for name in (GENERAL, *machines.names()):
        print(f"## {name}\n\n{table(name)}\n")
