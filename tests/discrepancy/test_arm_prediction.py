"""A report on an arm predicts poses from a file as it lies: joints by name, turns, temperature, sockets; each row."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench import discrepancy
from calibench.bench.measured import sources
from calibench.discrepancy import DataError, MeasuredData, Model
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.machines.arm import Arm
from calibench.discrepancy.noise.whiten import Noise
from tests.bench.arm_by_hand import NAMES, in_sockets, measured, placed, urdf

pytestmark = pytest.mark.usefixtures("at_one_noise")

PLAY = 1.2e-3  # rad
WARM = 4e-5  # rad/K


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    file = tmp_path_factory.mktemp("arm") / "my.urdf"
    file.write_text(urdf())
    return Arm(str(file))


def columns(q, seen=None):
    told = dict(zip(NAMES, q.T, strict=True))
    return told | ({} if seen is None else dict(zip("xyz", seen.T, strict=True)))


@pytest.fixture(scope="module")
def played(arm):
    """Joints, places and directions of an arm whose joint 2 has play, and a report on the first 80 rows."""
    q, seen, _ = measured(110)
    came = np.sign(np.diff(q, axis=0, prepend=q[:1]))
    stood = q - PLAY / 2 * came * [0, 1, 0, 0, 0, 0]
    seen = seen + placed(stood)[0] - placed(q)[0]
    return q, seen, came, discrepancy.explain(arm, MeasuredData(columns(q[:80], seen[:80]), "arm"))


def test_poses_are_predicted_from_joints_alone(played):
    q, seen, came, report = played
    assert [one.effect for one in report.findings[0].set] == ["backlash joint_2"]
    told = report.predict(MeasuredData(columns(q[80:]), "arm"))
    off = np.stack([told.measured[name] for name in "xyz"], axis=-1) - seen[80:]
    assert np.abs(off[1:]).max() < 0.2  # the noise is .03; before the first row nothing is known
    stated = {f"direction_{name}": came[80:, k] for k, name in enumerate(NAMES)}
    told = report.predict(MeasuredData(columns(q[80:], seen[80:]) | stated, "arm"))
    assert told.residuals.shape == (30, 3)
    assert np.sqrt(np.mean(told.residuals**2)) == pytest.approx(0.03, rel=0.25)


def test_every_row_of_the_fitted_file_is_predicted(played):
    q, seen, _, report = played
    told = report.predict(MeasuredData(columns(q[:80], seen[:80]), "arm"))
    assert told.residuals.shape == (80, 3)
    assert np.abs(told.residuals[1:]).max() < 0.2


def test_a_joint_that_is_missing_is_named(played):
    q, _, _, report = played
    with pytest.raises(DataError, match="joint_4"):
        report.predict(MeasuredData({n: c for n, c in columns(q[:5]).items() if n != "joint_4"}, "arm"))


@pytest.mark.slow
def test_turns_are_predicted_beside_places(arm):
    q, seen, turns = measured(60)
    turns = Rotation.from_rotvec(np.random.default_rng(1).normal(0, 1e-4, (60, 3))).as_matrix() @ turns
    turned = dict(zip(("rx", "ry", "rz"), Rotation.from_matrix(turns).as_euler("xyz").T, strict=True))
    report = discrepancy.explain(
        arm, MeasuredData({n: c[:50] for n, c in (columns(q, seen) | turned).items()}, "arm", {"sigma_mrad": 0.1})
    )
    told = report.predict(MeasuredData({n: c[50:] for n, c in (columns(q, seen) | turned).items()}, "arm"))
    assert told.residuals.shape == (10, 6)
    assert np.abs(told.residuals).max() < 0.5  # mm and mrad
    alone = report.predict(MeasuredData(columns(q[50:]), "arm"))
    np.testing.assert_allclose(alone.measured["turn_x"], told.measured["turn_x"], atol=1e-6)


@pytest.mark.slow
def test_temperatures_count_from_those_that_were_fitted(arm):
    q, seen, _ = measured(90)
    warm = np.linspace(20.0, 30.0, 90)
    moved = q + np.outer(warm - 25, [0, WARM, 0, 0, 0, 0])
    seen = seen + placed(moved)[0] - placed(q)[0]
    order = np.random.default_rng(0).permutation(90)
    q, seen, warm = q[order], seen[order], warm[order]
    report = discrepancy.explain(arm, MeasuredData(columns(q, seen) | {"temperature_C": warm}, "arm"))
    assert report.findings[0].effect == "thermal_zero joint_2"
    hot = warm > 28
    told = report.predict(MeasuredData(columns(q[hot], seen[hot]) | {"temperature_C": warm[hot]}, "arm"))
    assert np.abs(told.residuals).max() < 0.2


@pytest.mark.slow
def test_a_ball_is_predicted_in_sockets_that_are_known(arm, tmp_path):
    in_sockets(tmp_path / "plate", places=3, postures=20)
    [source] = sources(str(tmp_path / "plate"), "arm")
    data = source.read({"socket_distance_mm": 50})
    report = discrepancy.explain(arm, data)
    told = report.predict(data.rows(np.arange(25, 40)))
    assert told.residuals.shape == (15, 3)
    assert np.abs(told.residuals).max() < 0.2
    elsewhere = data.rows(np.arange(3)).with_columns({"place": np.full(3, "shelf")})
    with pytest.raises(DataError, match="shelf, socket 0"):
        report.predict(elsewhere)


def test_thirty_poses_of_three_numbers_each_are_enough_to_leave_some_out(arm):
    q, seen, _ = measured(30)
    report = discrepancy.explain(arm, MeasuredData(columns(q, seen), "arm", {"sigma_mm": 0.03}))
    assert (
        len(report.parameters) > 24
    )  # more than the rows that four of five folds have, and fewer than their equations
    assert report.gap.cross_validated
    assert report.gap.held_out_before < 3


def test_a_number_that_the_poses_hardly_tell_keeps_its_nominal_value(arm):
    """Forty poses in which a joint hardly moves: where all is free, other poses are off by a centimetre and more."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.4, 2.4, (240, 6))
    q[:40, 4] = 0.3 + rng.uniform(-0.02, 0.02, 40)
    seen = placed(q)[0] + rng.normal(0, 0.3, (240, 3))
    told = columns(q, seen) | {"split": np.repeat(["train", "hold"], [40, 200])}
    formulation = arm.formulate(MeasuredData(told, "arm"))
    assert any("no better than to 2 mm" in note.text for note in formulation.data.notes)
    held = np.asarray(formulation.data["split"]) == "hold"
    found = fit(Model(formulation.on(formulation.data.rows(~held))), Noise())
    left = Model(formulation.on(formulation.data.rows(held))).residuals(found.x)
    assert np.sqrt((left**2).sum(axis=1).mean()) < 1.5  # mm; the noise is .5
