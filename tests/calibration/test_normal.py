"""Normal equations by groups of poses: they are J'J and J'r, they add up, and a fold or a prior costs one solution."""

import numpy as np
import pytest

from calibench.calibration import read_urdf
from calibench.calibration.fit import fit_arm, resample
from calibench.calibration.frames import frames_of_positions
from calibench.calibration.kinematics import forward, nominal, parameter_units
from calibench.calibration.model import ArmModel
from calibench.calibration.normal import covariance_of, normal_blocks, root_of, solve
from calibench.calibration.readings import poses_of
from calibench.calibration.rigid import rotation_of
from calibench.problems.arm.families import shipped


def measured(n=5000, posed=True, seed=0):
    """Return the model of n readings of a UR10 that is wrong in zeros and lengths, with a noise of .05 mm."""
    chain, rng = read_urdf(shipped("ur10.urdf")).chain(), np.random.default_rng(seed)
    p, names = nominal(chain), tuple(parameter_units(chain))
    wrong = [k for k, name in enumerate(names) if name.startswith(("zero_", "x_"))]
    p[wrong] += rng.normal(0, 1, len(wrong)) * [1e-3 if names[k].startswith("zero") else 0.3 for k in wrong]
    joints = rng.uniform(-2, 2, (n, 6))
    seen = forward(chain, p, joints)
    turns = rotation_of(rng.normal(0, 2e-4, (n, 3))) @ seen[:, :3, :3]
    none = np.full(n, -1, dtype=np.int64)
    return ArmModel(
        chain=chain, joints=joints, position=seen[:, :3, 3] + rng.normal(0, 0.05, (n, 3)),
        turns=turns if posed else None, socket=none, place=none, sigma=(0.05, 2e-4),
    )  # fmt: skip


def stacked(rows, more, weights):
    """Return residuals (n, c), or slopes (n, c, k), by the `weights` (n,) of readings, and what is `more`."""
    weighted = np.sqrt(weights).reshape(-1, *[1] * (rows.ndim - 1)) * rows
    return np.concatenate([weighted.reshape(-1, *rows.shape[2:]), more])


def free_of(model):
    return np.array([k for k, name in enumerate(model.names) if name.startswith(("zero_", "x_", "tool_x"))])


@pytest.mark.parametrize("posed", [True, False])
def test_blocks_are_the_products_of_the_jacobian_of_each_group(posed):
    model, rng = measured(posed=posed), np.random.default_rng(1)
    p, free, group = model.start, free_of(model), rng.integers(0, 3, 5000)
    weights = rng.choice([0.0, 1.0], 5000)
    sums = normal_blocks(model, p, free, weights, group)
    for g in range(3):
        there = weights * (group == g)
        rows = stacked(*model.jacobian(p, free, there), there)
        residuals = stacked(*model.residuals(p, there), there)
        assert sums.gram[g] == pytest.approx(rows.T @ rows, rel=1e-9, abs=1e-3)
        assert sums.slope[g] == pytest.approx(rows.T @ residuals, rel=1e-7, abs=1e-3)
        assert sums.square[g] == pytest.approx(residuals @ residuals)
        assert sums.count[g] == there.sum() * (6 if posed else 3)
    rest = sums.by(np.array([[1.0, 0.0, 1.0]]))
    assert rest.gram[0] == pytest.approx(sums.gram[0] + sums.gram[2])
    assert root_of(rest.gram[0]).T @ root_of(rest.gram[0]) == pytest.approx(rest.gram[0], rel=1e-9, abs=1e-3)


def test_a_step_leaves_the_least_and_a_prior_holds_what_nothing_tells():
    model = measured(600)
    free, ones = free_of(model), np.ones(600)
    sums = normal_blocks(model, model.start, free, ones)
    step = solve(sums.gram[0], sums.slope[0])
    rows = stacked(*model.jacobian(model.start, free, ones), ones)
    residuals = stacked(*model.residuals(model.start, ones), ones)
    assert step == pytest.approx(np.linalg.lstsq(rows, -residuals, rcond=None)[0], rel=1e-6)
    assert covariance_of(sums.gram[0]) == pytest.approx(np.linalg.inv(rows.T @ rows), rel=1e-6)

    prior, off = np.full(len(free), 4.0), np.full(len(free), 0.1)  # the same as rows of 2 (off + s)
    wide, more = np.vstack([rows, 2 * np.eye(len(free))]), np.concatenate([residuals, 2 * off])
    wanted = np.linalg.lstsq(wide, -more, rcond=None)[0]
    assert solve(sums.gram[0] + np.diag(prior), sums.slope[0] + prior * off) == pytest.approx(wanted, rel=1e-6)
    nothing = np.zeros_like(sums.gram[0])
    assert solve(nothing + np.diag(prior), nothing[0] + prior * off) == pytest.approx(-off)


def test_many_poses_scatter_in_draws_as_their_covariance_says():
    model = measured(8000, posed=False)
    order = free_of(model).tolist()
    fit = fit_arm(model, order)
    draws = resample(fit, 400)
    assert draws.std(axis=0) == pytest.approx(np.sqrt(np.diag(fit.covariance)), rel=0.15)


def test_repeats_have_the_number_of_the_first_of_them():
    joints = np.random.default_rng(2).uniform(-2, 2, (300, 4))
    again = np.concatenate([joints[:100], joints[:50] + 4e-4, joints[100:], joints[7:8] - 4e-4])
    numbers = poses_of(again)
    assert numbers[:100].tolist() == list(range(100))
    assert numbers[100:150].tolist() == list(range(50))
    assert numbers[150:350].tolist() == list(range(100, 300))
    assert numbers[350] == 7


def test_frames_are_found_of_as_many_poses_as_were_logged():
    chain = read_urdf(shipped("ur10.urdf")).chain()
    rng = np.random.default_rng(3)
    poses = forward(chain, {}, rng.uniform(-2, 2, (70_000, 6)))
    turn = rotation_of(np.array([[0.3, -0.2, 1.0]]))[0]
    read = (poses[:, :3, 3] + poses[:, :3, :3] @ [10, 50, 80]) @ turn.T + [900, -300, 20]
    read[:20_000] += 300.0  # wild
    found = frames_of_positions(poses, read, 1.0)
    assert found.base[:3, :3] == pytest.approx(turn, abs=1e-9)
    assert found.tool[:3, 3] == pytest.approx([10, 50, 80], abs=1e-6)
