"""The catalogue as the tables of its page: ``python -m calibench.discrepancy.effects.table``."""

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
    """Return the families entered for one machine as a Markdown table, a row each, in the order of their names."""
    rows = [_row(family) for family in sorted(own_families(machine), key=lambda family: family.name)]
    lines = [_HEAD, ("---",) * len(_HEAD), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _row(family: EffectFamily) -> tuple[str, ...]:
    columns = ", ".join(f"`{column}`" for column in family.columns) or "those of any reading"
    formula = f"`{family.formula}`".replace("|", "\\|")
    targets = ", ".join(family.targets)
    return (f"`{family.name}`", family.cause, formula, columns, family.unit, targets, family.twins or "none")


if __name__ == "__main__":
    for name in (GENERAL, *machines.names()):
        print(f"## {name}\n\n{table(name)}\n")
