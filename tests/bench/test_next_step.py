"""What to measure next is decided from the report alone; the page only puts it into words."""

from dataclasses import replace

import pytest

from calibench.bench.discovery.page.words import clearest_place, next_step
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.report import Place
from tests.bench.test_discovery_page import FINDING, told


@pytest.mark.parametrize(("p", "shown"), [(0.009, True), (0.011, False), (float("nan"), False)])
def test_a_place_is_told_where_it_shows(p, shown):
    place = Place("joint 1", "t_s", p)
    report = replace(told(verdict="unknown"), where=(Place("joint 2", "t_s", 0.5), place))
    assert clearest_place(report) == (place if shown else None)
    assert next_step(report).place == clearest_place(report)
    assert next_step(report).unnamed


def test_rivals_of_each_finding_are_told_how_to_part():
    report = told(verdict="named", findings=[{**FINDING, "separated_by": "loads"}, {**FINDING, "separated_by": None}])
    step = next_step(report)
    assert (step.separating, step.unnamed) == (("loads",), False)


def test_columns_that_the_same_effects_ask_for_stand_together():
    untested = [Untestable("backlash", f"joint {i}", "no direction", (f"dir_{i}",), missing=True) for i in (1, 2)]
    untested.append(Untestable("gravity", "all", "needs columns that vary", ("payload_N",)))
    report = replace(told(), not_testable=tuple(untested))
    assert next_step(report).columns == {("dir_1", "dir_2"): ("backlash",)}
