"""What is never named by itself stands beside a name it cannot be told from, and changes nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.blind.orthoglide import case
from calibench.discrepancy import MeasuredData, machines
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.model.effect import Alternative, EffectFamily, NotTestable, Untestable, name_of
from calibench.discrepancy.search.finding import _held
from tests.discrepancy.orthoglide_score import explained
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


def _beside(hidden):
    data = MeasuredData(hidden.columns, "orthoglide", hidden.metadata, "case")
    known = catalogue(machines.make("orthoglide").formulate(data))
    return known.candidates, {name_of(held.effect): held for held in known.alternatives}


@pytest.mark.slow
def test_legs_that_warm_up_are_not_named_alone_where_the_drives_may_as_well() -> None:
    hidden = case(3, "thermal_legs", "leg y", 1.3, "paper")
    report = explained(hidden)
    names = [rival.effect for rival in report.findings[0].set]
    assert report.verdict == "ambiguous"
    assert {"thermal_legs leg y", "thermal_drives axis y"} <= set(names)
    assert names[0] != "thermal_drives axis y"  # it is never put first
    assert any(u.family == "thermal_drives" and "thermal_legs" in u.reason for u in report.not_testable)


def test_without_temperatures_nothing_warms_up() -> None:
    hidden = case(3, plan="paper")
    bare = replace(hidden, columns={k: v for k, v in hidden.columns.items() if k != "temp_K"})
    assert not any(name.startswith("thermal") for name in _beside(bare)[1])


@pytest.mark.slow
def test_a_gauge_too_far_out_of_true_to_be_looked_for_stands_in_the_set() -> None:
    hidden = case(1013, "gauge_tilt", plan="paper")
    found, beside = _beside(hidden)
    truth = f"gauge_tilt {hidden.truth['target']}"
    assert truth in beside
    assert truth not in {f"{e.family} {e.target}" for e in found}
    assert beside[truth].effect.coefficients == ("roll",)  # no gauge pitches by the radians that would show
    report = explained(hidden)
    assert truth in {rival.effect for finding in report.findings for rival in finding.set}
    assert [u for u in report.not_testable if f"{u.family} {u.target}" == truth and "it takes" in u.reason]


@pytest.mark.parametrize("plan", few(1, ["cross", "loaded"]))
def test_every_gauge_is_looked_for_where_it_shows(plan: str) -> None:
    found, beside = _beside(case(0, plan=plan))
    assert not any(name.startswith("gauge") for name in beside)
    assert {e.coefficients for e in found if e.family == "gauge_tilt"} == {("roll", "pitch")}


def test_what_a_family_leaves_beside_is_kept_with_its_reason() -> None:
    one, other = _beside(case(0, plan="cross"))[0][:2]

    def build(formulation, target):
        if target == "leg x":
            raise NotTestable("why", alternatives=(Alternative(one, 2.0),))
        if target == "leg z":
            raise NotTestable("needs column wind", ("wind",), missing=True)
        return (other,)

    family = EffectFamily("faint", "orthoglide", "", "", "base", (), "mm", ("leg x", "leg y", "leg z"), build)
    known = family.candidates(None)
    assert known.untestable == (
        Untestable("faint", "leg x", "why"),
        Untestable("faint", "leg z", "needs column wind", ("wind",), missing=True),
    )
    assert [(held.effect, held.largest) for held in known.alternatives] == [(one, 2.0)]
    assert known.candidates == (other,)


def test_many_unlikely_rivals_are_not_unlikely_together() -> None:
    crowd = {"best": 1.0, **{f"rival {k}": 0.15 for k in range(7)}}
    kept = _held(crowd, "best", 0.1)
    left_out = sum(crowd.values()) - sum(kept.values())
    assert len(kept) == 7
    assert left_out < 0.1 * sum(crowd.values())
    assert list(_held({"best": 1.0, "rival": 0.11}, "best", 0.1)) == ["best"]
    assert list(_held({"best": 1.0, "rival": 0.12}, "best", 0.1)) == ["best", "rival"]
    assert "first" in _held({"first": 0.01, "other": 1.0}, "first", 0.1)  # the name itself is never left out
