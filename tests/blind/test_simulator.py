"""The simulator of hidden effects is itself held against physics: closure, statics, sizes, noise, seeds."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks.blind import laws, malformed
from benchmarks.blind.gpm2002 import families, noise
from benchmarks.blind.gpm2002.design import random_plan
from benchmarks.blind.gpm2002.effect import coarsened, run
from benchmarks.blind.gpm2002.machine import (
    ANGLE_ONLY_FREE,
    DISTAL,
    HOME,
    MAKERS,
    NAMES,
    OFFSETS,
    closure,
    inverse,
    leg_errors,
    random_machine,
)
from benchmarks.blind.gpm2002.simulate import KINDS, Case, case, write
from benchmarks.blind.gpm2002.statics import geometry, settle
from benchmarks.blind.gpm2002.visible import amplitude_for, open_eye, rms

ALL = [*families.KNOWN, *families.FOREIGN]
TEETH = (60, 75, 90)


def stage(seed=0):
    machine = random_machine(np.random.default_rng(seed))
    plan = random_plan(machine, np.random.default_rng(seed + 1))
    members = np.broadcast_to(machine, (len(plan.t), 15))
    return machine, plan, settle(members, plan.position, plan.branch, plan.load, plan.preload, None, None)


MACHINE, PLAN, STILL = stage()


def an_effect(family, leg=1, seed=3):
    return families.make(family, leg, PLAN, TEETH, np.random.default_rng(seed))


def parameters(one):
    return np.array([one.truth["parameters"][name] for name in NAMES])


def readings(one):
    return np.column_stack([one.columns[f"enc_{i}"] for i in (1, 2, 3)])


def tracked(one):
    return np.column_stack([one.columns["x"], one.columns["y"]])


def test_the_makers_machine_at_home_stands_at_the_papers_angles():
    home = inverse(MAKERS, HOME[None], np.ones(3))[0]
    np.testing.assert_allclose(home, [1.111132, 3.110680, -1.458332], atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_without_effect_and_noise_the_legs_meet(seed):
    machine, plan, still = stage(seed)
    clean = run(machine, plan, still, [])
    assert np.abs(leg_errors(machine, clean.readings, clean.tracker)).max() < 1e-12 * 488
    assert np.abs(closure(machine, clean.readings)).max() < 1e-12 * 488**2


@pytest.mark.parametrize("family", ALL)
def test_an_effect_at_amplitude_zero_is_the_identity(family):
    clean, none = run(MACHINE, PLAN, STILL, []), run(MACHINE, PLAN, STILL, [(an_effect(family), 0.0)])
    np.testing.assert_allclose(coarsened(none.readings, [(an_effect(family), 0.0)]), clean.readings, atol=1e-13)
    np.testing.assert_allclose(none.tracker, clean.tracker, atol=1e-10)


@pytest.mark.parametrize("family", ALL)
def test_an_effect_at_its_typical_amplitude_is_felt_where_its_target_says(family):
    effect = an_effect(family)
    clean, bent = run(MACHINE, PLAN, STILL, []), run(MACHINE, PLAN, STILL, [(effect, effect.typical)])
    moved = np.abs(coarsened(bent.readings, [(effect, effect.typical)]) - clean.readings).max(axis=0) > 1e-9
    seen = np.abs(bent.tracker - clean.tracker).max() > 1e-9
    if effect.target == "tracker":
        assert seen
        assert not moved.any()
    elif effect.target.startswith("joint") and effect.windup is None:
        np.testing.assert_array_equal(moved, [False, True, False])
        assert not seen
    else:
        assert moved[1]


@pytest.mark.parametrize("family", ["compliance", "proximal_bending", "axial_compliance", "clearance"])
def test_a_yielding_machine_rests_in_equilibrium_and_its_deformed_legs_meet(family):
    effect = an_effect(family)
    a = 5 * effect.typical
    rest = run(MACHINE, PLAN, STILL, [(effect, a)]).rest
    members = np.broadcast_to(MACHINE, (len(PLAN.t), 15)).copy()
    if effect.stretch is not None:
        members[:, DISTAL] += effect.stretch(a, rest.axial)
        np.testing.assert_allclose(members[:, DISTAL], rest.distal, atol=1e-9)
    theta = inverse(members, rest.position, PLAN.branch)
    np.testing.assert_allclose(theta, rest.link_angles, atol=1e-12)
    wound = effect.windup(a, rest.torque) if effect.windup is not None else 0.0
    np.testing.assert_allclose(rest.motor_angles, theta + wound, atol=1e-12)
    g, arm = geometry(members, rest.position, theta)
    np.testing.assert_allclose(np.einsum("nik,nk->ni", g, rest.torque), -PLAN.load, atol=1e-6)
    np.testing.assert_allclose(rest.axial, -rest.torque / arm, atol=1e-6)
    errors = rest.motor_angles - STILL.motor_angles
    np.testing.assert_allclose(np.einsum("nik,nk->ni", g, errors), 0.0, atol=1e-12)  # least squares of three errors
    assert np.abs(rest.position - STILL.position).max() > 1e-4


def test_axial_forces_carry_the_load_and_torques_do_its_work():
    g, arm = geometry(np.broadcast_to(MACHINE, (len(PLAN.t), 15)), STILL.position, STILL.link_angles)
    u = np.moveaxis(g, 1, 2) * arm[..., None]
    np.testing.assert_allclose((STILL.axial[..., None] * u).sum(axis=1), PLAN.load, atol=1e-9)
    h = 1e-4
    ahead, behind = (inverse(MACHINE, PLAN.position + s * h * PLAN.velocity, PLAN.branch) for s in (1, -1))
    work = (STILL.torque * (ahead - behind) / (2 * h)).sum(axis=1) + (PLAN.load * PLAN.velocity).sum(axis=1)
    assert np.abs(work).max() < 1e-3 * np.abs(PLAN.load * PLAN.velocity).max()


def test_a_stiffening_spring_obeys_its_law():
    from benchmarks.blind.gpm2002.member_effects import stiffening

    force = np.linspace(-9e4, 9e4, 11)
    x = stiffening(force, 3e4)
    np.testing.assert_allclose(x + x**3 / 3e4**2, force, rtol=1e-12)


@pytest.mark.parametrize("xy", [False, True])
@pytest.mark.parametrize("family", [f for f in ALL if f != "tracker_lag"])
def test_lambda_is_met(family, xy):
    one = case(7, family=family, target=2, lam=1.0, xy=xy)
    [effect] = one.truth["effects"]
    assert not effect["invisible"]
    assert effect["lambda"] == pytest.approx(1.0, rel=0.05 if family == "quantisation" else 0.02)


def test_a_late_tracker_is_invisible_to_angles_and_said_so():
    [blind] = case(7, family="tracker_lag", xy=False, lam=1.5).truth["effects"]
    [seeing] = case(7, family="tracker_lag", xy=True, lam=1.5).truth["effects"]
    assert blind["invisible"]
    assert blind["lambda"] < 1e-3
    assert seeing["lambda"] == pytest.approx(1.5, rel=0.02)


def test_lambda_is_what_an_independent_calibration_leaves():
    from scipy.optimize import least_squares

    effect = an_effect("eccentricity")
    clean, bent = run(MACHINE, PLAN, STILL, []), run(MACHINE, PLAN, STILL, [(effect, 0.03)])
    eye = open_eye(MACHINE, clean.readings, None, 5e-5, 0.0)

    def residuals(change):
        machine = MACHINE.copy()
        machine[ANGLE_ONLY_FREE] += change
        return eye.residuals(machine, bent.readings, None)

    fit = least_squares(residuals, np.zeros(11), x_scale=[1.0] * 8 + [4e-3] * 3, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert eye.left(bent.readings, None) == pytest.approx(rms(fit.fun), rel=2e-3)


def test_whitened_closure_of_noise_alone_has_variance_one():
    rng, clean = np.random.default_rng(0), run(MACHINE, PLAN, STILL, [])
    for tracker in (None, clean.tracker):
        eye, sizes = open_eye(MACHINE, clean.readings, tracker, 5e-5, 0.02), []
        for _ in range(40):
            shaken = clean.readings + 5e-5 * rng.standard_normal(clean.readings.shape)
            seen = None if tracker is None else tracker + 0.02 * rng.standard_normal(tracker.shape)
            sizes.append(eye.signature(shaken, seen) ** 2)
        n = np.size(sizes)
        assert np.mean(sizes) == pytest.approx(1.0, abs=5 * np.sqrt(2 / n) + 0.002)


@pytest.mark.parametrize("law", noise.LAWS)
def test_noise_has_the_stated_sigma_and_memory(law):
    drawn = noise.draw(law, (200_000, 2), np.random.default_rng(1))
    assert drawn.std() == pytest.approx(1.0, abs=0.05 if law == "t3" else 0.006)
    after = float((drawn[1:] * drawn[:-1]).mean())
    assert after == pytest.approx(noise.CARRIED if law == "ar1" else 0.0, abs=0.02)
    beyond = float((np.abs(drawn) > 4).mean())
    assert beyond > 1e-3 if law == "t3" else beyond < 3e-4


def test_a_seed_is_a_case_to_the_last_bit_and_another_seed_another():
    one, again, other = case(11), case(11), case(12)
    assert one.truth == again.truth
    assert one.metadata == again.metadata
    for name, column in one.columns.items():
        np.testing.assert_array_equal(column, again.columns[name])
    assert not np.array_equal(readings(one)[:50], readings(other)[:50])


def test_asking_for_a_noise_law_changes_nothing_but_the_noise():
    plain, heavy = case(13, kind="none", noise="gauss"), case(13, kind="none", noise="t3")
    assert plain.truth["parameters"] == heavy.truth["parameters"]
    np.testing.assert_array_equal(plain.columns["t_s"], heavy.columns["t_s"])
    assert 0 < np.abs(readings(plain) - readings(heavy)).max() < 1.0


def test_designs_are_those_that_the_rates_are_stated_for():
    for seed in range(12):
        one = case(seed, kind="none", xy=seed % 2 == 0)
        train = one.columns["split"] == "train"
        poses, times = np.unique(one.columns["pose_id"][train], return_counts=True)
        assert 45 <= len(poses) <= 90
        assert set(times) == {4}
        assert 35 <= len(np.unique(one.columns["pose_id"][~train])) <= 60
        visits = {v for p in poses[:5] for v in one.columns["visit_id"][one.columns["pose_id"] == p]}
        assert len(visits) == 10
        assert (np.diff(one.columns["t_s"]) > 0).all()
        assert 2.5e-5 <= one.metadata["sigma_enc"] <= 1e-4
        assert ("x" in one.columns) == (seed % 2 == 0)


def test_a_large_file_can_be_had():
    one = case(3, family="drift", target=1, lam=1.0, poses=2500)
    assert (one.columns["split"] == "train").sum() == 10_000
    assert one.truth["effects"][0]["lambda"] == pytest.approx(1.0, rel=0.02)


@pytest.mark.slow
def test_kinds_and_sizes_are_drawn_in_the_stated_shares():
    truths = [case(seed).truth for seed in range(150)]
    for kind, share in zip(KINDS, (0.20, 0.45, 0.15, 0.20)):
        found = np.mean([t["kind"] == kind for t in truths])
        assert abs(found - share) < 4 * np.sqrt(share * (1 - share) / len(truths))
    sizes = [e["lambda_asked"] for t in truths for e in t["effects"]]
    assert 0.4 <= min(sizes) < 0.6
    assert 3.2 < max(sizes) <= 4.0
    assert all(e["known"] == (t["kind"] != "outside") for t in truths for e in t["effects"])


@pytest.mark.slow
def test_columns_that_the_effect_needs_are_there_unless_the_truth_says_withheld():
    withheld = 0
    for seed in range(60):
        one = case(seed, family="axial_compliance", target=3)
        assert one.truth["withheld"] == ("axial_3" not in one.columns)
        withheld += one.truth["withheld"]
    assert withheld < 12


def test_no_truth_is_in_the_file(tmp_path):
    one = case(21, family="backlash", target=2, lam=2.0, xy=True)
    write(one, tmp_path / "data", tmp_path / "blind", "first")
    raw = pq.read_table(tmp_path / "data" / "first.parquet")
    assert set(json.loads(raw.schema.metadata[b"measured_data"])) == {
        "schema_version", "machine", "sigma_enc", "sigma_xy", "encoder_lsb", "tooth_numbers", "fixed_parameters",
        "nominal",
    }  # fmt: skip
    assert raw.schema.field("enc_1").metadata == {b"unit": b"rad"}
    assert "backlash" not in str(raw.schema.metadata)
    np.testing.assert_array_equal(raw["enc_2"].to_numpy(), one.columns["enc_2"])
    truth = json.loads((tmp_path / "blind" / "first.json").read_text())
    assert truth["effects"][0]["target"] == "joint 2"
    with pytest.raises(ValueError, match="apart"):
        write(one, tmp_path / "data", tmp_path / "data", "first")


def test_contradictory_requests_are_refused():
    for wrong in ({"kind": "none", "family": "gear"}, {"kind": "outside", "family": "gear"}, {"family": "gaer"},
                  {"target": 2}, {"lam": 0.0}, {"noise": "white"}, {"kind": "some"}):  # fmt: skip
        with pytest.raises(ValueError, match=next(iter(wrong))):
            case(0, **wrong)


@pytest.mark.parametrize("xy", [False, True])
def test_a_case_told_otherwise_is_still_the_same_machine(xy):
    one = case(31, kind="one", family="slip", target=2, xy=xy)
    one = replace(one, columns={k: v for k, v in one.columns.items() if k != "valid"})

    def missed(told: Case):
        if xy:
            return leg_errors(parameters(told), readings(told), tracked(told))
        return closure(parameters(told), readings(told))

    np.testing.assert_allclose(missed(laws.rotated(one, 0.7, (10.0, -4.0))), missed(one), atol=1e-8)
    other = missed(laws.relabelled(one, (3, 1, 2)))
    np.testing.assert_allclose(other, missed(one)[:, [2, 0, 1]] if xy else missed(one), atol=1e-8)
    assert laws.relabelled(one, (3, 1, 2)).truth["effects"][0]["target"] == "joint 3"
    later = laws.delayed(one, 500.0)
    np.testing.assert_allclose(later.columns["t_s"] - one.columns["t_s"], 500.0)
    mixed = laws.repeats_permuted(one, 4)
    np.testing.assert_array_equal(mixed.columns["pose_id"], one.columns["pose_id"])
    assert not np.array_equal(mixed.columns["enc_1"], one.columns["enc_1"])
    assert sorted(mixed.columns["enc_1"]) == sorted(one.columns["enc_1"])
    assert sorted(laws.rows_shuffled(one, 4).columns["t_s"]) == sorted(one.columns["t_s"])


def test_every_way_to_spoil_a_file_differs_from_the_good_one_and_can_be_written(tmp_path):
    good = case(41, kind="none", xy=True)
    made = malformed.write_spoiled(good, tmp_path)
    assert len(made) >= 20
    for name, one in made.items():
        same = one.metadata == good.metadata and list(one.columns) == list(good.columns)
        same = same and all(np.array_equal(one.columns[k], good.columns[k]) for k in good.columns)
        assert not same, name
        assert pq.read_table(tmp_path / f"{name}.parquet").num_columns == len(one.columns)


def test_the_amplitude_search_meets_a_law_of_any_power_and_stops_at_the_largest():
    for power in (1.0, 2.0):
        _, seen = amplitude_for(2.0, lambda a, p=power: 1e3 * a**p, 1e-6, 1.0)
        assert seen == pytest.approx(2.0, rel=0.01)
    assert amplitude_for(2.0, lambda a: a, 0.1, 0.5) == (0.5, 0.5)


def test_offsets_turn_readings_into_joint_angles():
    clean = run(MACHINE, PLAN, STILL, [])
    np.testing.assert_allclose(clean.readings + MACHINE[OFFSETS], STILL.link_angles, atol=1e-14)


@pytest.mark.parametrize("xy", [False, True])
def test_an_empty_case_is_calibrated_down_to_its_noise(xy):
    squares, freedom = 0.0, 0
    for seed in range(8):
        one = case(seed, kind="none", noise="gauss", xy=xy)
        good = (one.columns["split"] == "train") & one.columns.get("valid", np.ones(len(one.columns["t_s"]), bool))
        seen = tracked(one)[good] if xy else None
        eye = open_eye(
            parameters(one), readings(one)[good], seen, one.metadata["sigma_enc"], one.metadata["sigma_xy"] or 0.0
        )
        residuals = eye.left(readings(one)[good], seen) ** 2 * good.sum() * (3 if xy else 1)
        squares, freedom = squares + residuals, freedom + good.sum() * (3 if xy else 1) - len(eye.free)
    assert squares / freedom == pytest.approx(1.0, abs=5 * np.sqrt(2 / freedom))
