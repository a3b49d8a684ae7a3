"""What to measure next follows from the report alone."""

from dataclasses import replace

import pytest

from calibench.bench.discovery.page.words import clearest_place, column_sentence, doubt_sentences, next_sentences
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.report import OtherNoise, Place
from tests.bench.test_discovery_page import FINDING, told


@pytest.mark.parametrize(("p", "shown"), [(0.009, True), (0.011, False), (float("nan"), False)])
def test_a_place_is_told_where_it_shows(p, shown):
    place = Place("joint 1", "t_s", p)
    report = replace(told(verdict="unknown"), where=(Place("joint 2", "t_s", 0.5), place))
    assert clearest_place(report) == (place if shown else None)
    [advice, *_] = next_sentences(report)
    assert ("spread evenly over time" in advice) == shown


def test_a_rate_is_no_column_that_readings_can_be_spread_over():
    report = replace(told(verdict="unknown"), where=(Place("y", "rate of power", 1e-9),))
    assert "repeats, in which power changes at many speeds, would show" in next_sentences(report)[0]


@pytest.mark.parametrize(("verdict", "said"), [("unknown", "as much would be without a name"), ("none", "missing")])
def test_a_search_at_another_noise_that_names_nothing_says_what_it_finds(verdict, said):
    [line] = doubt_sentences(replace(told(verdict="unknown"), other_noise=(OtherNoise(0.5, verdict),)))
    assert line.endswith(f"{said}.")


def test_rivals_of_each_finding_are_told_how_to_part():
    report = told(verdict="named", findings=[{**FINDING, "separated_by": "loads"}, {**FINDING, "separated_by": None}])
    assert next_sentences(report) == ["loads."]


def test_columns_that_the_same_effects_ask_for_stand_together():
    untested = [Untestable("backlash", f"joint {i}", "no direction", (f"dir_{i}",), missing=True) for i in (1, 2)]
    untested.append(Untestable("gravity", "all", "needs columns that vary", ("payload_N",)))
    report = replace(told(), not_testable=tuple(untested))
    assert column_sentence(report) == "columns that would let more effects be tested: dir_1, dir_2 (backlash)."
