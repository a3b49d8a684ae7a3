"""`bench design`: what data or a plan could tell apart, as tables and as JSON, before anything is fitted."""

import json

import pytest

from tests.bench.test_discover import call


def test_a_plan_tells_its_classes_and_what_could_be_seen(capsys):
    code, out, _ = call("design machine=gpm2002 plan=disc plan.n=30 next=2", capsys)
    assert code == 0
    assert "compliance of joint 1 | proximal bending of leg 1" in out
    assert "timing lag of all encoders" in out
    assert "invisible" in out
    assert "tracker lag: needs columns x, y" in out
    assert "separation before" in out


def test_json_holds_the_same(capsys):
    code, out, _ = call("design machine=gpm2002 data=demo_twins next=0 --json", capsys)
    assert code == 0
    found = json.loads(out)
    assert ["compliance joint 1", "proximal_bending leg 1"] in [sorted(names)[:2] for names in found["classes"]]
    sizes = {c["effect"]: c["minimum_detectable"] for c in found["candidates"]}
    assert sizes["lag all"] is None
    assert 0 < sizes["backlash joint 2"] < 1e-3
    assert found["next"] is None


def test_larger_effects_are_told_apart_more_easily(capsys):
    classes = [
        json.loads(call(f"design machine=gpm2002 plan=disc plan.n=30 next=0 size={size} --json", capsys)[1])["classes"]
        for size in (0.5, 8)
    ]
    assert len(classes[0]) < len(classes[1])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("machine=gpm2002", "one of data=FILE and plan=NAME is needed"),
        ("machine=gpm2002 plan=disk", "did you mean 'disc'?"),
        ("machine=gpm2002 plan=disc plan.radiu=3", "plan.radiu: did you mean 'radius'?"),
        ("machine=gpm2002 plan=disc plan.n=many", "plan.n=many: a whole number is needed"),
        ("machine=gpm2002 plan=disc size=-1", "size=-1"),
        ("machine=gpm2002 plan=disc next=99", "next=99"),
        ("machine=gpm2002 plan=disc rivals=backlash", "rivals"),
        ("machine=gpm2002 plan=disc plan.radius=900", "out of reach"),
        ("machine=gpm2002 data=demo_twins,demo_nothing", "names 2 sets"),
        ("machine=orthoglide plan=disc", "plan=disc: choices: paper, positions"),
    ],
)
def test_a_wrong_question_is_one_line(words, said, capsys):
    code, out, err = call(f"design {words}", capsys)
    assert (code, out) == (2, "")
    assert said in err
    assert err.count("\n") == 1


def test_readings_that_a_model_meets_to_rounding_are_none_too_far_off_and_show_effects(capsys):
    """A parallel leg of the plan reads exactly 0, and rows that share their Zero are known by exact numbers."""
    code, out, err = call("design machine=orthoglide plan=cross next=0 --json", capsys)
    assert (code, err) == (0, "")
    seen = {one["effect"]: one["visible_fraction"] for one in json.loads(out)["candidates"]}
    assert seen["guide_lean axis x"] == pytest.approx(
        seen["guide_lean axis z"], rel=1e-6
    )  # the plan is alike in x, y, z
    assert 0.2 < seen["guide_lean axis x"] < 0.6
    assert seen["axis_orthogonality all"] > 0.9


def test_readings_are_proposed_for_names_that_readings_can_split(capsys):
    """Twins that no reading tells apart come first in the catalogue, and are passed over."""
    found = json.loads(call("design machine=gpm2002 plan=disc next=2 --json", capsys)[1])
    start, *_, end = found["next"]["separation"]
    assert end > start
    assert "proximal_bending leg 1" not in found["next"]["rivals"]
