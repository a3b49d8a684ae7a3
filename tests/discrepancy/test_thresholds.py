"""The numbers at which the search decides stand in one place, each with its unit, its meaning and its origin."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.thresholds import (
    CONVENTION,
    JUDGED,
    MEASURED,
    NUMERICAL,
    THRESHOLDS,
    about,
    thresholds,
    using,
)

ROOT = Path(__file__).resolve().parents[2] / "discrepancy"


@pytest.mark.parametrize("name", about())
def test_every_threshold_tells_its_unit_its_meaning_and_its_origin(name: str) -> None:
    told = about()[name]
    assert told.metadata["unit"]
    assert len(told.metadata["meaning"]) > 5
    assert told.metadata["chosen"] in (JUDGED, CONVENTION, MEASURED, NUMERICAL)
    assert float(told.default) > 0


def test_every_threshold_is_asked_for_somewhere_in_the_rooms() -> None:
    asked = {
        node.attr
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute)
    }
    assert set(about()) <= asked


def test_thresholds_hold_inside_their_block_and_nowhere_else() -> None:
    with using(replace(THRESHOLDS, close=1.0)):
        assert thresholds().close == 1.0
    assert thresholds() is THRESHOLDS


def test_a_search_decides_by_the_thresholds_it_is_given() -> None:
    made = case(3, family="backlash", lam=2.0, noise="gauss", xy=False)
    data = MeasuredData(made.columns, "gpm2002", made.metadata, "case")
    assert explain("gpm2002", data).verdict in ("named", "ambiguous")
    assert explain("gpm2002", data, thresholds=replace(THRESHOLDS, matters=100.0)).verdict == "negligible"
    assert thresholds() is THRESHOLDS
