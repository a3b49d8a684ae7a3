"""The Orthoglide as a measured machine: its model against twins, its shared Zero, and what its door refuses."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from calibench import discrepancy, problems
from calibench.discrepancy import DataError, MeasuredData, Model, machines
from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide, planned
from calibench.discrepancy.machines.orthoglide.kinematics import printed
from calibench.problems.orthoglide.plans import SetName, covariance, paper_plan

pytestmark = pytest.mark.usefixtures("at_one_noise")

_ANGLES = ("tilt", "gauge_roll", "gauge_pitch")


def _spoiled(name: str) -> tuple:
    """Return a formulation and quantities of a machine with everything wrong with it at once."""
    formulation = machines.make("orthoglide").formulate(printed(name))
    rng, n = np.random.default_rng(5), len(formulation.data)
    q = dict(Model(formulation).quantities(np.array([0.4, -0.7, 1.1]))[0])
    for key in q:
        if key != "deviation":
            q[key] = q[key] + rng.normal(size=n) * (0.01 if key.startswith(_ANGLES) else 0.3)
    return formulation, q


@pytest.mark.parametrize("name", ["exp2", "exp1"])
def test_slopes_are_differences_on_a_machine_with_everything_wrong(name: str) -> None:
    formulation, q = _spoiled(name)
    for key, slope in formulation.slopes(q).items():
        step = 1e-6 if key.startswith(_ANGLES) else 1e-4
        ends = [formulation.constraints(q | {key: q[key] + side * step}) for side in (1, -1)]
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * step), rtol=1e-6, atol=1e-6, err_msg=key)


@pytest.mark.parametrize("name", get_args(SetName))
def test_the_machine_without_imperfections_is_the_problem_orthoglide6(name: str) -> None:
    problem = problems.make("orthoglide6", data=name, free="rho")
    model = Model(machines.make("orthoglide").formulate(printed(name)))
    constraints = model.formulation.constraints(model.quantities(problem.best)[1])[:, 0]
    np.testing.assert_allclose(constraints, problem.residuals(problem.best), atol=1e-11)


def test_rows_that_share_a_zero_are_mixed_until_their_covariance_of_equation_14_is_the_identity() -> None:
    formulation = machines.make("orthoglide").formulate(printed("exp2"))
    root = formulation.decorrelate(np.eye(12))
    data, paper = formulation.data, problems.make("orthoglide6", data="exp2")
    assert [(r.leg, r.direction) for r in paper.plan] == list(zip(data["leg"], data["direction"]))
    np.testing.assert_allclose(root @ covariance(paper_plan()) @ root.T, np.eye(12), atol=1e-12)
    differences = machines.make("orthoglide").formulate(printed("exp1"))
    np.testing.assert_allclose(differences.decorrelate(np.eye(6)), np.eye(6) / np.sqrt(2), atol=1e-12)


def test_six_differences_free_the_joint_offsets_only_and_say_so() -> None:
    data = printed("exp1")
    free = MeasuredData(data.columns, data.machine, {"sigma": 0.01}, data.name)
    formulation = machines.make("orthoglide").formulate(free)
    assert [p.name for p in formulation.parameters] == ["drho_x", "drho_y", "drho_z"]
    assert any("only the joint offsets" in note.text for note in formulation.data.notes)
    twelve = MeasuredData(printed("exp2").columns, "orthoglide", {"sigma": 0.01}, "exp2")
    assert len(machines.make("orthoglide").formulate(twelve).parameters) == 6


def test_other_rows_of_the_same_table_keep_their_deviations_and_their_zero() -> None:
    formulation = machines.make("orthoglide").formulate(printed("exp2"))
    kept = np.arange(12) < 8
    part = formulation.on(formulation.data.rows(kept))
    model, parted = Model(formulation), Model(part)
    x = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(parted.residuals(x), model.residuals(x)[kept], atol=1e-14)  # x_y y_x y_z z_y: own Zeros


def _with(**columns: object) -> MeasuredData:
    data = printed("exp2")
    return MeasuredData({**data.columns, **columns}, "orthoglide", data.metadata, "mine")


def _changed(name: str, row: int, value: object) -> MeasuredData:
    column = printed("exp2").columns[name].astype(object)
    column[row] = value
    return _with(**{name: column})


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (_changed("leg", 2, "w"), ("mine", "row 3", "leg=w", "x, y or z")),
        (_changed("direction", 0, "y"), ("gauge along its own leg y",)),
        (_changed("level_mm", 4, 90.0), ("out of reach", "-100 .. 60")),
        (_changed("gauge_position", 3, 0.05), ("off the leg", "move the gauge")),
        (_changed("pass", 1, "back"), ("row 2", "pass=back", "fwd or rev")),
        (_changed("payload_N", 3, float("nan")), ("row 4", "payload_N", "finite")),
        (_changed("deviation", 3, "soft"), ("'deviation'", "not a number")),
        (_with(deviation=printed("exp2")["deviation"] * 1e-3), ("millimetres are needed",)),
        (MeasuredData({"enc_1": np.zeros(3)}, "orthoglide", {}, "mine"), ("no column leg",)),
        (MeasuredData(printed("exp2").columns, "gpm2002", {}, "mine"), ("'gpm2002'", "not of an orthoglide")),
        (MeasuredData(printed("exp2").columns, "orthoglide", {"sigma": -1.0}, "mine"), ("sigma=-1", "positive number")),
        (MeasuredData(printed("exp2").columns, "orthoglide", {"free": "lengths"}, "mine"), ("free=lengths", "choices")),
    ],
)
def test_the_door_names_the_row_the_value_and_the_way_out(data: MeasuredData, words: tuple[str, ...]) -> None:
    with pytest.raises(DataError) as error:
        _ = Orthoglide().formulate(data).sigma
    for word in words:
        assert word in str(error.value)


def test_rows_without_a_deviation_are_left_out_and_repeats_without_a_number_are_numbered() -> None:
    holes = Orthoglide().formulate(_changed("deviation", 5, float("nan")))
    assert len(holes.data) == 11
    assert any("1 rows without" in note.text for note in holes.data.notes)
    data = printed("exp2")
    twice = MeasuredData({k: np.concatenate([c, c]) for k, c in data.columns.items()}, "orthoglide", {}, "twice")
    formulation = Orthoglide().formulate(twice)
    assert set(formulation.data["repeat"]) == {0.0, 1.0}
    np.testing.assert_allclose(formulation.decorrelate(np.eye(24))[:12, 12:], 0.0, atol=1e-15)


def test_an_unknown_printed_set_lists_those_there_are() -> None:
    with pytest.raises(DataError, match="exp1, exp2, exp2_t1, exp3_t1, exp3_t2"):
        printed("exp3")


def test_a_calibration_that_runs_away_without_some_poses_tells_no_gap_on_unseen_ones() -> None:
    data = planned("both_ways")
    off = np.where(data["leg"] == "x", 0.04 * np.sign(data["level_mm"]), 0.0)
    noise = np.random.default_rng(1).normal(0.0, 0.01, len(data))
    report = discrepancy.explain("orthoglide", data.with_columns({"deviation": data["deviation"] + noise + off}))
    assert report.gap.train_after < report.gap.train_before
    assert np.isnan(report.gap.held_out_before)


def test_a_refused_row_has_its_number_in_the_file_where_rows_before_it_were_left_out() -> None:
    data = printed("exp2")
    deviation, passes = data["deviation"].copy(), data["pass"].astype("U4")
    deviation[0], passes[2] = np.nan, "back"
    with pytest.raises(DataError, match="row 3: pass=back"):
        machines.make("orthoglide").formulate(data.with_columns({"deviation": deviation, "pass": passes}))
