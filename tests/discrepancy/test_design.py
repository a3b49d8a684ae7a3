"""What a design can tell before any fit, and the readings that would tell more."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

from calibench.bench.measured.sources import sources
from calibench.discrepancy import explain, machines
from calibench.discrepancy.design.detectability import WhitenedDesign, design
from calibench.discrepancy.design.next_poses import NoPoses, next_poses
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.measured import DataError, MeasuredData

pytestmark = pytest.mark.usefixtures("at_one_noise")

SIGMA = 5e-5  # rad


def together(found: object, *names: str) -> bool:
    return any(set(names) <= set(group) for group in found.classes)  # type: ignore[attr-defined]


def test_twins_are_one_class_and_what_is_read_decides_which() -> None:
    angles, tracked = (design("gpm2002", planned(n=60, tracked=t)) for t in (False, True))
    for found in (angles, tracked):
        assert together(found, "compliance joint 3", "proximal_bending leg 3")
        assert not together(found, "backlash joint 1", "backlash joint 2")
    assert together(angles, "thermal_links all", "thermal_base all")
    assert not together(tracked, "thermal_links all", "thermal_base all")
    assert together(tracked, "lag all", "tracker_lag tracker")


def test_what_is_invisible_has_no_detectable_amplitude_and_no_class() -> None:
    found = design("gpm2002", planned(n=60)).to_dict()
    [lag] = [row for row in found["candidates"] if row["effect"] == "lag all"]
    assert found["invisible"] == ["lag all"]
    assert lag["minimum_detectable"] is None
    assert lag["class"] == -1
    assert [gap["family"] for gap in found["not_testable"]] == ["tracker_lag"]
    json.dumps(found)


def test_calibration_absorbs_most_of_a_gear_and_little_of_a_backlash() -> None:
    found = {sight.effect: sight for sight in design("gpm2002", planned(n=60)).candidates}
    for i in (1, 2, 3):
        assert found[f"gear joint {i}"].visible_fraction < 0.11  # 89-99.6 % absorbed
        assert found[f"backlash joint {i}"].visible_fraction > 0.5


def test_the_detectable_amplitude_is_found_nine_times_in_ten() -> None:
    """Drawn, not derived: noise on a least-squares fit with and without the effect at that amplitude."""
    data = planned(n=40)
    view = WhitenedDesign(machines.make("gpm2002").formulate(data))
    found = design("gpm2002", data)
    [sight] = [s for s in found.candidates if s.effect == "backlash joint 2"]
    [effect] = [e for e in catalogue(view.formulation).candidates if name_of(e) == sight.effect]
    signal = view.signature(effect)[:, 0] * sight.minimum_detectable
    rest = view.rest(effect).projected[:, 0]
    rest = rest / np.linalg.norm(rest)
    rng = np.random.default_rng(3)
    scores = (signal + rng.normal(size=(3000, len(signal)))) @ rest
    level = 0.01 / len(found.candidates)
    power = float((scores**2 > chi2.isf(level, 1)).mean())
    assert power == pytest.approx(0.9, abs=0.025)


def test_more_readings_detect_less() -> None:
    few, many = (design("gpm2002", planned(n=n)) for n in (40, 160))
    for a, b in zip(few.candidates, many.candidates, strict=True):
        if np.isfinite(a.minimum_detectable) and a.family in ("backlash", "compliance", "clearance"):
            assert b.minimum_detectable < 0.7 * a.minimum_detectable, a.effect


def test_larger_effects_are_told_apart_more_finely() -> None:
    data = planned(n=60)
    small, large = (design("gpm2002", data, size=size) for size in (0.2, 3.0))
    assert large.threshold < small.threshold
    assert len(large.classes) > len(small.classes)


def test_frames_and_names_of_joints_do_not_matter() -> None:
    """The plan turned by a third of a turn with its machine: what can be seen stays."""
    data = planned(n=40, tracked=True)
    turn, x, y = 2.1, data["x"], data["y"]
    nominal = dict(data.metadata["nominal"])
    for i in (1, 2, 3):
        ax, ay = nominal[f"xa{i}"], nominal[f"ya{i}"]
        nominal[f"xa{i}"], nominal[f"ya{i}"] = (
            ax * np.cos(turn) - ay * np.sin(turn),
            ax * np.sin(turn) + ay * np.cos(turn),
        )
        nominal[f"z{i}"] += turn
    turned = data.with_columns(
        {
            "x": x * np.cos(turn) - y * np.sin(turn),
            "y": x * np.sin(turn) + y * np.cos(turn),
            "heading": data["heading"] + turn,
        }
    )
    turned = type(data)(turned.columns, data.machine, {**data.metadata, "nominal": nominal}, data.name)
    for a, b in zip(design("gpm2002", data).candidates, design("gpm2002", turned).candidates, strict=True):
        assert a.visible_fraction == pytest.approx(b.visible_fraction, rel=0.03), a.effect


def test_columns_left_out_of_a_plan_are_not_testable() -> None:
    found = design("gpm2002", planned(n=40, without=("tau", "temp_K", "tooth_numbers")))
    gone = {gap.family for gap in found.not_testable}
    assert {"compliance", "proximal_bending", "thermal_links", "thermal_leg", "thermal_base", "cyclic"} <= gone


def test_a_plan_out_of_reach_is_refused() -> None:
    with pytest.raises(DataError, match="out of reach"):
        planned(n=60, radius=400)


def test_the_next_readings_separate_rivals_further_than_random_ones() -> None:
    data, rivals = planned(n=45, repeats=1), ["compliance joint 2", "axial_compliance leg 2"]
    best = next_poses("gpm2002", data, rivals, k=4)
    assert best.helps
    assert np.all(np.diff(best.separation) > 0)
    random = planned(n=60, radius=150, seed=9, visits=1, repeats=1)
    gained = [
        next_poses("gpm2002", data, rivals, k=4, pool=random.rows(np.arange(4 * j, 4 * j + 4))).separation[-1]
        for j in range(6)
    ]
    assert best.separation[-1] > max(gained)


def test_the_separation_after_a_reading_is_that_of_all_readings_together() -> None:
    data = planned(n=40, repeats=1)
    pool = planned(n=20, radius=140, seed=4, visits=1, repeats=1)
    rivals = ["axial_compliance leg 1", "clearance leg 1"]
    told = next_poses("gpm2002", data, rivals, k=3, pool=pool)
    joined = data.rows(np.arange(len(data))).with_columns({})
    rows = {name: np.concatenate([data[name], told.readings[name]]) for name in data.columns}
    joined = type(data)(rows, data.machine, data.metadata, "joined")
    closure = machines.make("gpm2002").formulate(data)
    small, large = WhitenedDesign(closure), WhitenedDesign(closure.on(joined))
    effects = {name_of(e): e for e in catalogue(closure).candidates}
    distances = []
    for a, b in (rivals, rivals[::-1]):
        c = 1.0 / np.linalg.norm(small.rest(effects[a]).projected) * np.sqrt(small.rows)
        mimic = np.concatenate([large.jacobian, large.signature(effects[b])], axis=1)
        mimic = mimic / np.linalg.norm(mimic, axis=0)
        signal = large.signature(effects[a])[:, 0] * c
        distances.append(np.linalg.norm(signal - mimic @ np.linalg.lstsq(mimic, signal, rcond=None)[0]))
    assert told.separation[-1] == pytest.approx(min(distances), rel=1e-5)


def test_no_reading_separates_twins() -> None:
    found = next_poses("gpm2002", planned(n=40), ["compliance joint 1", "proximal_bending leg 1"], k=2)
    assert not found.helps
    assert found.separation.max() < 1e-6
    json.dumps(found.to_dict())


@pytest.mark.parametrize(
    ("rivals", "k", "said"),
    [
        (["backlash joint 1"], 2, "two or more"), (["backlash joint 1", "backlsh joint 2"], 2, "did you mean"),
        (["backlash joint 1", "gear joint 1"], 0, "k=0"),
    ],
)  # fmt: skip
def test_rivals_there_are_not_are_refused(rivals: list[str], k: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        next_poses("gpm2002", planned(n=40), rivals, k=k)


def test_power_is_that_of_the_noncentral_chi_square() -> None:
    from calibench.discrepancy.diagnostics.score import noncentrality

    assert ncx2.sf(chi2.isf(0.01, 2), 2, noncentrality(2, 0.01, 0.9)) == pytest.approx(0.9)


def test_the_smallest_size_is_told_by_one_rule_before_a_fit_and_after() -> None:
    data = planned(n=60, sigma_enc=SIGMA)
    rng = np.random.default_rng(0)
    read = {name: data[name] + SIGMA * rng.standard_normal(len(data)) for name in ("enc_1", "enc_2", "enc_3")}
    before = {sight.effect: sight for sight in design("gpm2002", data).candidates}
    after = {c.effect: c for c in explain("gpm2002", data.with_columns(read)).candidates}
    one_form = ("backlash", "compliance", "axial_compliance", "clearance", "gear", "eccentricity", "lag")
    compared = [name for name, sight in before.items() if sight.family in one_form and sight.visible]
    ratios = [after[name].minimum_detectable / before[name].minimum_detectable for name in compared]
    assert len(ratios) == 21
    assert ratios == pytest.approx([1.0] * 21, rel=0.01)


def test_next_poses_look_at_the_readings_that_the_door_lets_in() -> None:
    data = planned(n=40)
    wild = data.with_columns({"valid": np.arange(len(data)) % 10 != 0})
    wild = wild.with_columns({"enc_1": np.where(wild["valid"], data["enc_1"], 1.0)})
    rivals = ["compliance joint 1", "axial_compliance leg 1"]
    told = [next_poses("gpm2002", one, rivals, k=1).separation for one in (wild, data.rows(wild["valid"]))]
    np.testing.assert_allclose(*told)
    with pytest.raises(DataError, match="column valid holds 'maybe'"):
        next_poses("gpm2002", data.with_columns({"valid": np.full(len(data), "maybe")}), rivals, k=1)


@pytest.mark.parametrize("name", ["demo_warm", "demo_nothing"])
def test_what_cancels_on_the_calibrated_machine_is_invisible_in_data_of_an_uncalibrated_one(name: str) -> None:
    """All encoders late together show nothing; by the nominal machine 2 % of their signature were left."""
    [found] = sources(name, "gpm2002")
    seen = {sight.effect: sight for sight in design("gpm2002", found.read({})).candidates}
    assert not seen["lag all"].visible
    assert np.isinf(seen["lag all"].minimum_detectable)
    assert seen["lag joint 1"].visible_fraction > 0.9


def test_no_readings_are_proposed_for_what_angles_alone_cannot_part() -> None:
    """Links that grow and a base that grows are alike on a calibrated machine; rounding splits them a little."""
    [found] = sources("demo_backlash", "gpm2002")
    further = next_poses("gpm2002", found.read({}), ["thermal_links all", "thermal_base all"], 4)
    assert further.separation[-1] < 0.1
    assert not further.helps


def test_readings_of_a_machine_without_a_map_of_its_workspace_are_chosen_from_those_that_are_handed_over() -> None:
    """It said "next_poses(..., pool=readings) of calibench", and that ended in a KeyError."""

    def table(u: np.ndarray) -> MeasuredData:
        return MeasuredData({"u": u, "y": np.zeros(len(u))}, "table", {}, "made")

    machine, rivals = Table(model="line", inputs=("u",), sigma=0.05), ["power u squared", "power u cubed"]
    with pytest.raises(NoPoses, match=r"pool=readings"):
        next_poses(machine, table(np.linspace(0, 3, 30)), rivals, k=2)
    told = next_poses(machine, table(np.linspace(0, 3, 30)), rivals, k=2, pool=table(np.linspace(0, 9, 19)))
    assert told.positions.shape == (2, 0)
    data, unread = table(np.linspace(0, 3, 30)), table(np.linspace(0, 9, 19)).with_columns({"y": np.full(19, np.nan)})
    with pytest.raises(TypeError, match="pool is a dict: MeasuredData"):
        next_poses(machine, data, rivals, k=2, pool={"u": np.arange(9.0)})  # type: ignore[arg-type]
    with pytest.raises(DataError, match="y: "):
        next_poses(machine, data, rivals, k=2, pool=unread)
    assert told.helps
    assert [set(row) for row in told.to_dict()["poses"]] == 2 * [{"u", "y"}]
    assert told.to_dict()["poses"][0]["u"] == 9.0  # far from all readings the two differ most


def test_a_name_of_which_some_forms_are_visible_is_not_called_invisible() -> None:
    for tracked in (False, True):
        found = design("gpm2002", planned(n=60, tracked=tracked)).to_dict()
        classed = {name for group in found["classes"] for name in group}
        assert not classed & set(found["invisible"])
        for row in found["candidates"]:
            assert (row["effect"] in classed) == (row["effect"] not in found["invisible"])
            assert (row["minimum_detectable"] is None) == (row["effect"] in found["invisible"])
