"""Hidden effects on a simulated Orthoglide, found and named: the bars (slow), and a few fixed seeds of each kind."""

from __future__ import annotations

import pytest

from tests.discrepancy.orthoglide_score import CONFOUNDED, explained, tally
from tests.sealed.orthoglide import TARGETS, case, unequal


@pytest.mark.parametrize("family", TARGETS)
def test_a_hidden_effect_is_named_on_the_cross_plan(family: str) -> None:
    hidden = case(1, family, plan="loaded" if family == "gravity" else "cross")
    report = explained(hidden)
    assert report.findings[0].effect == f"{family} {hidden.truth['target']}"
    assert report.gap.held_out_after < 1.15 < report.gap.held_out_before
    low, high = sorted(report.findings[0].amplitude.ci95)
    size = hidden.truth["amplitude"]  # its sign is the simulator's own
    assert low * 0.9 <= size <= high * 1.1 or low * 1.1 <= -size <= high * 0.9


@pytest.mark.parametrize("plan", ["cross", "loaded", "paper"])
def test_nothing_is_found_where_nothing_is_hidden(plan: str) -> None:
    assert [explained(case(seed, plan=plan)).verdict for seed in (0, 1)] == ["none", "none"]


@pytest.mark.parametrize("family", CONFOUNDED)
def test_what_the_papers_plan_cannot_part_is_not_guessed(family: str) -> None:
    told = tally(family, range(3), "paper")
    assert told.guessed == 0
    assert told.inside + told.silent == told.cases


def test_lengths_beside_offsets_are_not_identifiable_on_the_papers_plan() -> None:
    hidden = unequal(2, "rho")
    report = explained(hidden)
    assert report.verdict in ("none", "negligible")
    assert all(c.visible_fraction < 0.05 for c in report.candidates if c.family == "leg_length" and c.target != "all")
    for k, axis in enumerate("xyz"):  # the offsets take the lengths up
        offset, length = hidden.truth["parameters"][[k, 3 + k]]
        assert report.parameters[f"drho_{axis}"].after == pytest.approx(offset - length, abs=0.15)
    both = explained(unequal(2, "full"))
    assert both.verdict in ("none", "negligible")
    assert all(change.sd > 0.2 for change in both.parameters.values())  # mm: they are there, and worth nothing


@pytest.mark.slow
@pytest.mark.parametrize("family", TARGETS)
def test_nine_in_ten_are_named_right_on_the_cross_plan(family: str) -> None:
    told = tally(family, range(100, 120), "loaded" if family == "gravity" else "cross")
    assert told.right >= 18, told.line()


@pytest.mark.slow
def test_nothing_is_named_in_97_of_100_empty_cases() -> None:
    told = [tally("", range(100, 200), plan) for plan in ("cross", "loaded", "paper")]
    assert sum(t.right for t in told) >= 291, [t.line() for t in told]


@pytest.mark.slow
@pytest.mark.parametrize("family", CONFOUNDED)
def test_the_confounded_come_back_as_sets_or_not_at_all(family: str) -> None:
    told = tally(family, range(100, 120), "paper")
    assert told.guessed <= 1, told.line()
    assert told.inside + told.silent >= 19, told.line()
