"""The tables of docs/optimizers.md, written by hand, which tests hold to the adapters."""

from __future__ import annotations

from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "optimizers.md"


def table_of(name: str) -> list[list[str]]:
    """Return the cells of the rows between the marks of a table."""
    text = PAGE.read_text(encoding="utf-8").split(f"<!-- begin {name} -->")[1].split(f"<!-- end {name} -->")[0]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.strip().splitlines()[2:]]


def sized_by_value() -> set[str]:
    """Return NLopt's algorithms to whose candidates the size of the value matters, as the page says."""
    return {name for cells in table_of("nlopt") if cells[1] != "no effect" for name in named(cells[0])}


def named(cell: str) -> list[str]:
    """Return the names of a cell that lists them as code."""
    return [name.strip(" `") for name in cell.split(",")]
