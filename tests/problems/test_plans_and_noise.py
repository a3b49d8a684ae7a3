"""The data of a problem: sampling plans, their seeds, encoder noise, and parameters held at their true values."""

import typing

import numpy as np
import pytest
from planar_cases import PLANAR, coordinates_of, made, named, over, points, true_machine

from calibench import problems
from calibench.problems.planar.gpm2002 import PlanName, home, plan_points

PLANS = typing.get_args(PlanName)
DRAWN = ("disc", "box")
SIZES = {"grid": [9, 21, 50], "disc": [11, 50], "box": [11, 50], "line": [12, 50], "circle": [50], "two_circles": [60]}


def test_the_plans_are_the_six_of_the_contract():
    assert set(PLANS) == {"grid", "disc", "box", "line", "circle", "two_circles"} == set(SIZES)


@pytest.mark.parametrize("plan", PLANS)
def test_a_plan_has_the_size_asked_for_and_keeps_within_its_radius(plan):
    for n in SIZES[plan]:
        offsets = plan_points(plan, home(), 80.0, n, np.random.default_rng(0)) - home()
        assert offsets.shape == (n, 2)
        assert np.unique(offsets, axis=0).shape == (n, 2)
        reach = np.abs(offsets[:, 0]) if plan in ("grid", "box") else np.hypot(*offsets.T)
        assert reach.max() <= 80 * (1 + 1e-12)
        assert reach.max() > 80 * 0.7


def test_a_grid_of_nine_has_pitch_60_and_one_of_21_is_seven_by_three():
    nine = problems.make("sensor_zero").true_positions - home()
    assert sorted(map(tuple, nine.tolist())) == [(x, y) for x in (-60.0, 0.0, 60.0) for y in (-60.0, 0.0, 60.0)]
    x, y = (problems.make("link_length").true_positions - home()).T
    np.testing.assert_allclose(np.unique(x.round(9)), np.arange(-3, 4) * 40.0)
    np.testing.assert_allclose(np.unique(y.round(9)), [-40.0, 0.0, 40.0])


def test_a_grid_of_three_is_a_corner_at_home():
    corner = problems.make("sensor_zero", n=3).true_positions - home()
    assert corner.tolist() == [[0.0, 0.0], [60.0, 0.0], [0.0, 60.0]]


def test_a_line_runs_along_x_through_home():
    x, y = (problems.make("full11", plan="line", n=11, radius=50).true_positions - home()).T
    np.testing.assert_allclose(x, np.linspace(-50, 50, 11), atol=1e-12)
    assert (y == 0).all()


def test_a_circle_is_even_and_two_circles_are_one_at_half_the_radius_with_a_third_of_the_points():
    one = problems.make("full11", plan="circle", n=12, radius=80).true_positions - home()
    np.testing.assert_allclose(np.hypot(*one.T), 80)
    np.testing.assert_allclose(one.mean(axis=0), 0, atol=1e-10)
    two = np.hypot(*(problems.make("full11", plan="two_circles", n=60, radius=120).true_positions - home()).T)
    assert np.isclose(two, 120).sum() == 40
    assert np.isclose(two, 60).sum() == 20


def test_a_disc_is_filled_evenly():
    # half the points within radius / sqrt 2; 2000 points know that share to .011
    offsets = plan_points("disc", home(), 100.0, 2000, np.random.default_rng(1)) - home()
    assert (np.hypot(*offsets.T) < 100 / np.sqrt(2)).mean() == pytest.approx(0.5, abs=0.045)
    assert np.abs(offsets.mean(axis=0)).max() < 6  # 50 mm / sqrt 2000, five times


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("name", sorted({name for name, _ in PLANAR}))
def test_every_plan_is_in_reach_of_every_problem_at_its_radius(name, plan):
    problem = problems.make(name, plan=plan, n=60)
    assert problem.options["plan"] == plan
    assert problem.readings.shape == (60, 3)
    assert np.isfinite(problem.readings).all()
    np.testing.assert_allclose(problem.positions(problem.truth.copy()), problem.true_positions, rtol=0, atol=1e-8)


@pytest.mark.parametrize("plan", PLANS)
def test_the_data_follow_from_the_data_seed_and_nothing_else(plan):
    np.random.seed(1)  # noqa: NPY002  (the global generator must not matter)
    first = problems.make("full11", plan=plan, data_seed=3, noise=1e-4)
    np.random.seed(2)  # noqa: NPY002
    again = problems.make("full11", plan=plan, data_seed=3, noise=1e-4, error="J3")
    assert first.readings.tobytes() == again.readings.tobytes()
    assert first.data_id == again.data_id


@pytest.mark.parametrize("plan", PLANS)
def test_another_seed_draws_another_plan_but_moves_no_fixed_one(plan):
    first, other = (problems.make("full11", plan=plan, data_seed=seed) for seed in (0, 1))
    moved = np.abs(first.true_positions - other.true_positions).max()
    assert (moved > 1) if plan in DRAWN else (moved == 0)
    assert (first.data_id != other.data_id) == (plan in DRAWN)


def test_the_plan_does_not_change_with_the_noise():
    quiet, noisy = (problems.make("full11", noise=noise) for noise in (0.0, 1e-3))
    assert quiet.true_positions.tobytes() == noisy.true_positions.tobytes()


def test_the_noise_has_the_standard_deviation_asked_for():
    # 15000 draws know a standard deviation to .6 % and a mean to .008 of one
    quiet, noisy = (problems.make("full11", n=5000, noise=noise, data_seed=5).readings for noise in (0.0, 2e-4))
    shake = (noisy - quiet) / 2e-4
    assert shake.std() == pytest.approx(1, rel=0.03)
    assert abs(shake.mean()) < 0.04
    assert np.abs(np.corrcoef(shake.T) - np.eye(3)).max() < 0.07  # each encoder by itself
    assert np.abs(shake).max() > 3


def test_noise_only_scales_with_its_size_so_levels_can_be_compared():
    quiet, some, more = (problems.make("full11", noise=noise).readings for noise in (0.0, 1e-4, 3e-4))
    np.testing.assert_allclose(more - quiet, 3 * (some - quiet), rtol=0, atol=1e-15)


def test_noise_and_its_seed_make_other_data():
    made_ = [
        problems.make("sensor_zero", **options)
        for options in ({}, {"noise": 1e-4}, {"noise": 2e-4}, {"noise": 1e-4, "data_seed": 1})
    ]
    assert len({problem.data_id for problem in made_}) == 4


def test_with_noise_the_truth_is_no_zero():
    problem = problems.make("full11", noise=1e-4)
    assert problem.noise == 1e-4
    # J2 = 3 sum g^2, and a reading's noise of 1e-4 rad moves g by some 2 * 244 * 24 * 1e-4 mm^2
    assert 1e1 < problem(problem.truth) < 1e4


@over([case for case in PLANAR if case[0] != "sensor_zero"])
def test_free_holds_the_other_parameters_at_their_true_values(case):
    name, options = case
    whole = made(case)
    wanted = ("z2", "lb3", "la2")
    part = problems.make(name, **dict(options), free=wanted)
    assert [p.name for p in part.parameters] == [p.name for p in whole.parameters if p.name in wanted]
    by_name = {c.name: c for c in whole.coordinates}
    assert part.coordinates == tuple(by_name[c.name] for c in part.coordinates)
    assert part.data_id == whole.data_id
    for x in points(part, 3, seed=30):
        everywhere = named(whole, whole.truth) | named(part, x)
        assert part(x) == whole(np.array([everywhere[c.name] for c in whole.coordinates]))


def test_free_takes_a_list_or_words_with_commas():
    listed, text = (problems.make("full11", free=free) for free in (["z1", "xa3"], "z1,xa3"))
    assert [p.name for p in listed.parameters] == [p.name for p in text.parameters] == ["z1", "xa3"]
    assert listed.options["free"] == ["z1", "xa3"]


def test_free_is_one_problem_in_whatever_order_and_however_often_a_name_stands_in_it():
    z1, twice, both, turned = (
        problems.make("full11", free=free).options["free"]
        for free in (["z1"], ["z1", "z1"], ["z1", "xa3"], ["xa3", "z1"])
    )
    assert (z1, both) == (twice, turned)
    whole = problems.make("full12")
    every = problems.make("full12", free=[p.name for p in whole.parameters])
    assert every.options == whole.options


def test_fewer_free_parameters_need_fewer_samples():
    assert problems.make("full11", free=["z1", "z2"], n=2).readings.shape == (2, 3)
    with pytest.raises(ValueError, match=r"full11\.n=10"):
        problems.make("full11", n=10)


def test_free_of_a_problem_with_gauge_has_none_left():
    problem = problems.make("full12", free=["ya2", "xa3"])
    machine = true_machine(("full12", ()))
    assert problem.gauge is None
    assert problem(coordinates_of(problem, machine)) < 1e-18


@pytest.mark.parametrize("n", [4, 6, 9, 12, 15, 21, 50])
def test_a_grid_is_no_higher_than_wide(n):
    points = plan_points("grid", np.zeros(2), 60.0, n, np.random.default_rng(0))
    assert len(points) == n
    assert np.abs(points).max(axis=0).max() == pytest.approx(60.0)
    assert np.ptp(points[:, 1]) <= np.ptp(points[:, 0]) + 1e-9


@pytest.mark.parametrize("noise", [1.5, 1e308])
def test_noise_without_bound_is_refused(noise):
    with pytest.raises(ValueError, match=r"must lie in 0 \.\. 1 \(a standard deviation, rad\)"):
        problems.make("full12", noise=noise)
