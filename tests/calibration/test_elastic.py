"""Joints that give way to gravity: compliances in the same fit, by an arm and its potential energy written by hand."""

import numpy as np
import pytest

import calibench
from calibench.calibration.urdf import read_urdf
from calibench.calibration.walk import torques
from tests.bench.arm_by_hand import AXES, NAMES, PLACES, TARGET, about, placed, urdf
from tests.calibration.test_rig import codes, error

MASSES = (20.0, 18.0, 12.0, 6.0, 4.0, 2.0)  # kg
CENTRES = ((0, 0.02, 0.05), (0.01, 0, 0.3), (0, 0.03, 0.2), (0, 0, 0.05), (0.01, 0, 0.04), (0, 0, 0.03))  # m
KAPPA = np.array([0.0, 2e-5, 4e-5, 0.0, 3e-5, 0.0])  # rad / (N m)
SOFT = ("elastic_joint_2", "elastic_joint_3")


def heavy_urdf():
    text = urdf()
    for name, mass, centre in zip((f"link_{k}" for k in range(1, 7)), MASSES, CENTRES, strict=True):
        inertial = f'<inertial><origin xyz="{" ".join(map(str, centre))}"/><mass value="{mass}"/></inertial>'
        text = text.replace(f'  <link name="{name}"/>', f'  <link name="{name}">{inertial}</link>')
    return text


def energy(q, payload):
    """Return the potential energy (...) [J] of links and of a payload at the target, base level, at joints (..., 6)."""
    at, turn, height = np.zeros(3), np.eye(3), 0.0
    for k in range(6):
        at = at + turn @ PLACES[k]
        turn = turn @ about(AXES[k], q[..., k])
        height += MASSES[k] * (at + turn @ CENTRES[k])[..., 2]
    return 9.81 * (height + payload * (at + turn @ (TARGET / 1000))[..., 2])


def held(q, payload=0.0, step=1e-5):
    """Return what gravity asks of each joint, (..., 6) [N m]: the slope of the energy."""
    ways = step * np.eye(6)
    return np.stack([energy(q + s, payload) - energy(q - s, payload) for s in ways], axis=-1) / (2 * step)


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "my.urdf").write_text(heavy_urdf())
    return tmp_path / "my.urdf"


def read(n=60, seed=2):
    rng = np.random.default_rng(seed)
    q, payload = rng.uniform(-2.4, 2.4, (n, 6)), np.where(np.arange(n) % 2, 0.0, 5.0)
    seen = placed(q - KAPPA * held(q, payload))[0]
    seen += rng.normal(0, 0.03, seen.shape)
    return dict(zip(NAMES, q.T, strict=True)) | dict(zip("xyz", seen.T, strict=True)) | {"payload_kg": payload}


def test_the_torque_is_the_slope_of_the_potential_energy(arm):
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    found = torques(read_urdf(arm).chain(tip="link_6"), q, TARGET, np.full(5, 3.0), {}, "URDF")
    assert np.allclose(found, held(q, 3.0), atol=1e-4)


def test_compliances_are_found_beside_lengths_and_zeros_and_stand_beside_the_urdf(arm):
    columns = read()
    rigid = calibench.calibrate(arm, columns, level="geometry", resamples=30, limits=False)
    soft = calibench.calibrate(arm, columns, level="elastic", resamples=30, limits=False)
    changes = {change.parameter: change for change in soft.changes}
    for k, name in enumerate(NAMES[1:], start=1):
        change = changes[f"elastic_{name}"]
        assert abs(change.change - KAPPA[k]) < 4 * change.sd, name
        assert change.unit == "rad/(N m)"
    assert all(changes[name].sd < 2e-6 for name in SOFT)
    assert soft.error_after < 0.1 < 0.5 * rigid.error_after
    assert error(soft, arm.parent) < 0.15 < error(rigid, arm.parent)
    assert "compliances have no place in a URDF" in codes(soft)["gains_elsewhere"].text


def test_without_masses_payload_or_torques_nothing_tells_a_compliance(arm):
    (arm.parent / "bare.urdf").write_text(urdf())
    columns = read()
    del columns["payload_kg"]
    with pytest.raises(ValueError, match="level=elastic: nothing tells what the joints hold: masses in the URDF"):
        calibench.calibrate(arm.parent / "bare.urdf", columns, level="elastic")
    holds = np.array([held(row) for row in np.column_stack([columns[name] for name in NAMES])])
    measured = {f"torque_{name}": 1000 * holds[:, k] for k, name in enumerate(NAMES)}  # N mm
    found = calibench.calibrate(arm.parent / "bare.urdf", columns | measured, level="elastic", resamples=20)
    assert {change.parameter for change in found.changes} >= set(SOFT)
