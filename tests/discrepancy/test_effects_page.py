"""The page of the catalogue says what the registry holds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.tables import bounds_table, effects_table
from calibench.discrepancy import machines
from calibench.discrepancy.registries import GENERAL, own_families

PAGE = Path(__file__).parents[2] / "docs" / "effects.md"


@pytest.mark.parametrize("machine", [GENERAL, *machines.names()])
def test_the_page_holds_the_table_of_every_machine(machine: str) -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert f"## {machine}\n\n{effects_table(machine)}\n" in page, "run: python -m benchmarks.tables"


def test_the_page_holds_the_sizes_that_no_machine_has() -> None:
    assert f"\n\n{bounds_table()}\n" in PAGE.read_text(encoding="utf-8"), "run: python -m benchmarks.tables"


def test_the_page_has_no_family_that_the_registry_has_not() -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    named = [name for row in lines if row.startswith("| `") for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    as_there = [line for line in lines if line.startswith("As in [general]")]
    named += [name for line in as_there for name in re.findall(r"`(\w+)` \(", line)]
    assert sorted(named) == sorted(f.name for m in (GENERAL, *machines.names()) for f in own_families(m))
