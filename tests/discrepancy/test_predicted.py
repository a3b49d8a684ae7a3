"""`Predicted`: a machine that predicts what is measured, from inputs without noise, its noise stated or learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench.discrepancy import Constraints, DataError, EffectFamily, LinearEffect, MeasuredData, Predicted, explain
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Instrument, Joint, Roles
from calibench.discrepancy.noise.whiten import Noise
from calibench.problems.base import Parameter

N = 120
PARAMETERS = (
    Parameter("la", "mm", 400.0, 390.0, 410.0),
    Parameter("z1", "rad", 0.0, -0.1, 0.1),
    Parameter("lb", "mm", 300.0, 290.0, 310.0),
    Parameter("z2", "rad", 0.0, -0.1, 0.1),
)
TRUE = np.array([401.3, 0.013, 298.9, -0.021])
SIGMA = {"x": 0.02, "y": 0.05}


def tip(q):
    """The place of the tip of an arm of two links, mm."""
    a = q["enc_1"] + q["z1"]
    b = a + q["enc_2"] + q["z2"]
    return np.stack([q["la"] * np.cos(a) + q["lb"] * np.cos(b), q["la"] * np.sin(a) + q["lb"] * np.sin(b)], axis=-1)


def tip_slopes(q):
    """Its slopes, by hand."""
    a = q["enc_1"] + q["z1"]
    b = a + q["enc_2"] + q["z2"]
    first, second = (np.stack([np.cos(t), np.sin(t)], axis=-1) for t in (a, b))
    turned = [np.stack([-v[:, 1], v[:, 0]], axis=-1) for v in (first, second)]
    of_b = q["lb"] * turned[1]
    of_a = q["la"] * turned[0] + of_b
    return {"la": first, "lb": second, "z1": of_a, "enc_1": of_a, "z2": of_b, "enc_2": of_b}


def readings(seed=0, play=0.0):
    rng = np.random.default_rng(seed)
    drive = rng.uniform([-0.6, 0.4], [1.2, 2.0], (N, 2))
    side = rng.choice([-1.0, 1.0], N)
    q = dict(zip((p.name for p in PARAMETERS), TRUE)) | {"enc_1": drive[:, 0], "enc_2": drive[:, 1] - play / 2 * side}
    place = tip(q) + rng.standard_normal((N, 2)) * list(SIGMA.values())
    columns = {"enc_1": drive[:, 0], "enc_2": drive[:, 1], "x": place[:, 0], "y": place[:, 1], "side": side}
    return MeasuredData(columns | {"sigma_y": np.full(N, SIGMA["y"])}, "predicted_arm", {}, "arm")


def predicted(data, measured=SIGMA, **more):
    return Predicted(data, tip, PARAMETERS, measured, **({"inputs": ("enc_1", "enc_2")} | more))


class Arm:
    name = "predicted_arm"

    def __init__(self, measured=SIGMA):
        self.measured = measured

    def formulate(self, data):
        return predicted(data, self.measured)


def _play(formulation, target):
    def changes(q, data):
        return {"enc_2": -0.5 * data["side"][:, None]}

    return (
        LinearEffect(
            "play", target, "enc_2 -= play / 2 side", "reading", ("side",), ("play",), ("rad",), "rad", changes
        ),
    )


def test_an_arm_that_reads_as_stated_gets_its_numbers():
    report = explain(Arm(), readings())
    assert report.verdict == "none"
    for name, true in zip((p.name for p in PARAMETERS), TRUE):
        assert abs(report.parameters[name].after - true) < 4 * report.parameters[name].sd


def test_the_residual_is_measured_minus_predicted():
    formulation = predicted(readings())
    _, q = Model(formulation).quantities(TRUE)
    left = formulation.constraints(q)
    assert left.shape == (N, 2)
    np.testing.assert_array_equal(left, np.stack([q["x"], q["y"]], axis=-1) - tip(q))
    assert 0.8 < np.std(left[:, 0]) / SIGMA["x"] < 1.2


def test_slopes_that_are_given_are_those_of_the_complex_step():
    data = readings()
    _, q = Model(predicted(data)).quantities(TRUE)
    alone, given = (predicted(data, slopes=slopes).slopes(q) for slopes in (None, tip_slopes))
    assert set(alone) == set(given) == set(q)
    for name, slope in alone.items():
        np.testing.assert_allclose(given[name], slope, rtol=1e-12, atol=1e-12)


def test_a_fit_takes_no_slope_in_a_number_that_is_held():
    stepped = []

    def watched(q):
        stepped.extend(name for name, value in q.items() if np.iscomplexobj(value))
        return tip(q)

    held = dict(zip(("lb", "z2"), TRUE[2:]))
    formulation = Predicted(readings(), watched, PARAMETERS[:2], SIGMA, inputs=("enc_1", "enc_2"), held=held)
    stepped.clear()
    found = fit(Model(formulation), Noise())
    assert set(stepped) == {"la", "z1"}
    assert found.at.slopes["lb"].shape == (N, 2)  # and there it is as soon as a test asks for it
    assert "lb" in stepped


def test_slopes_that_are_given_wrongly_are_refused():
    with pytest.raises(DataError, match=r"slopes\(q\): its slope in la"):
        predicted(readings(), slopes=lambda q: tip_slopes(q) | {"la": 2 * tip_slopes(q)["la"]})


def test_an_effect_may_change_an_input():
    play = EffectFamily("play", "predicted_arm", "Play", "enc_2 -= play / 2 side", "reading", ("side",), "rad",
                        ("joint 2",), _play)  # fmt: skip
    data = readings(play=8e-4)
    formulation = predicted(data)
    [effect] = play.candidates(formulation).candidates
    model = Model(formulation, (effect,))
    x = np.concatenate([TRUE, [8e-4]])
    r = model.residuals(x) / list(SIGMA.values())
    assert np.mean(r**2) < 1.3 < np.mean((Model(formulation).residuals(TRUE) / list(SIGMA.values())) ** 2)
    J = model.jacobian(x)[:, :, -1]
    h = 1e-7
    np.testing.assert_allclose(J, (model.residuals(x + h * np.eye(5)[4]) - model.residuals(x)) / h, atol=1e-3)


def test_noise_may_be_a_column():
    formulation = predicted(readings(), {"x": 0.02, "y": "sigma_y"})
    np.testing.assert_array_equal(formulation.sigma["y"], np.full(N, 0.05))
    assert explain(Arm({"x": 0.02, "y": "sigma_y"}), readings()).parameters == explain(Arm(), readings()).parameters


def test_noise_that_nobody_states_is_learned_from_the_residuals():
    formulation = predicted(readings(), {"x": None, "y": None})
    assert formulation.unknown_noise == ("x", "y")
    for name, sigma in SIGMA.items():
        assert abs(np.log(formulation.sigma[name] / sigma)) < 4 / np.sqrt(N)
    few = formulation.on(formulation.data.rows(np.arange(N) < 20))
    assert dict(few.sigma) == dict(formulation.sigma)


def test_readings_far_off_do_not_make_unknown_noise_large():
    data = readings()
    wild = np.where(np.arange(N) % 15 == 0, 5.0, 0.0)
    formulation = predicted(data.with_columns({"x": data["x"] + wild}), {"x": None, "y": 0.05})
    assert formulation.sigma["x"] < 1.5 * SIGMA["x"]


def test_rows_that_are_held_out_teach_no_noise():
    data = readings()
    hold = np.arange(N) % 3 == 0
    data = data.with_columns({"x": data["x"] + 3.0 * hold, "split": np.where(hold, "hold", "train")})
    assert predicted(data, {"x": None, "y": 0.05}).sigma["x"] < 1.5 * SIGMA["x"]


def test_one_measured_thing_may_be_predicted_flat():
    data = readings()
    formulation = Predicted(data, lambda q: tip(q)[:, 0], PARAMETERS, {"x": 0.02}, inputs=("enc_1", "enc_2"))
    assert formulation.slopes(Model(formulation).quantities(TRUE)[1])["la"].shape == (N, 1)


def test_a_prediction_is_the_closure_whose_inputs_hardly_carry_noise():
    class Closed:
        name = "predicted_arm"

        def formulate(self, data):
            def closure(q):
                return np.stack([q["x"], q["y"]], axis=-1) - tip(q)

            return Constraints(data, closure, PARAMETERS, {"enc_1": 1e-12, "enc_2": 1e-12, **SIGMA})

    one, other = explain(Arm(), readings()), explain(Closed(), readings())
    for name, told in one.parameters.items():
        assert told.after == pytest.approx(other.parameters[name].after, abs=1e-9)
        assert told.sd == pytest.approx(other.parameters[name].sd, rel=1e-6)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"measured": {}}, "nothing is measured"),
        ({"measured": {"x": 0.0, "y": 0.05}}, "noise of x: 0; a standard deviation above 0 is needed, or None"),
        ({"measured": {"x": -1.0, "y": None}}, "noise of x: -1"),
        ({"measured": {"x": 0.02, "w": 0.05}}, "column 'w' is missing"),
        ({"measured": {"x": 0.02, "y": "sigma_w"}}, "column 'sigma_w' is missing"),
        ({"measured": {"x": 0.02}}, r"predict\(q\) returned shape \(5, 2\) for 5 readings of x: \(5, 1\) is needed"),
        ({"inputs": ("enc_1", "enc_2", "x")}, "x: a name is measured, an input, held, or free: one of these"),
        ({"held": {"la": 400.0}}, "la: a name is measured, an input, held, or free"),
        ({"roles": Roles((Joint("joint 1", "enk_1"),))}, "joint 1: 'enk_1' is no reading or input; there are enc_1"),
        ({"roles": Roles(instruments=(Instrument("tracker", ("enc_1",)),))}, "tracker: 'enc_1' is no measured column"),
    ],
    ids=["nothing", "zero", "negative", "column", "deviation", "shape", "twice", "held", "joint", "instrument"],
)
def test_a_mistake_of_the_author_is_a_sentence(more, said):
    with pytest.raises(DataError, match=said):
        predicted(readings(), **more)


def test_a_row_whose_input_is_no_number_is_left_out_and_told():
    data = readings()
    few = predicted(data.with_columns({"enc_1": np.where(np.arange(N) == 7, np.nan, data["enc_1"])}))
    assert len(few.data) == N - 1
    assert any("1 row" in note.text for note in few.data.notes), few.data.notes


def test_a_measured_column_is_in_the_unit_of_its_joint_or_its_file_and_so_is_what_errs_of_it() -> None:
    rng = np.random.default_rng(4)
    table, clock = rng.uniform(0, 6, N), np.arange(N) * 10.0
    mirror = table + 1e-4 + 2e-6 * rng.standard_normal(N) + 2e-5 * (clock > 600)
    stage = table / 2 + 1e-3 * rng.standard_normal(N)
    data = MeasuredData({"table": table, "mirror": mirror, "stage": stage, "t": clock}, "axis")
    roles = Roles((Joint("stage", "stage"),), time="t", instruments=(Instrument("collimator", ("mirror",)),))

    class Axis:
        name = "axis"

        def formulate(self, data: MeasuredData) -> Predicted:
            def both(q):
                return np.stack([q["table"] + q["zero"], q["table"] / 2], axis=-1)

            zero = (Parameter("zero", "rad", 0.0, -0.01, 0.01),)
            return Predicted(data, both, zero, {"mirror": 2e-6, "stage": 1e-3}, ("table",), roles=roles)

    told = Axis().formulate(replace(data, units={"mirror": "rad"}))
    assert {sensor.column: sensor.unit for sensor in told.sensors} == {"mirror": "rad", "stage": "rad"}
    assert {sensor.unit for sensor in Axis().formulate(data).sensors} == {"mm", "rad"}  # nobody says more of the mirror
    [found] = explain(Axis(), replace(data, units={"mirror": "rad"})).findings
    assert (found.family, found.amplitude.unit) == ("frame_shift", "rad")
    assert abs(found.amplitude.value) == pytest.approx(2e-5, rel=0.1)


def test_a_column_that_the_roles_name_and_the_file_lacks_is_told_with_the_nearest_one():
    class Timed:
        name = "predicted_arm"

        def __init__(self, time):
            self.roles = Roles(time=time)

        def formulate(self, data):
            return predicted(data, roles=self.roles)

    data = readings().with_columns({"clock": np.arange(float(N))})

    def lacking(time):
        return [note for note in explain(Timed(time), data).notes if note.text.startswith("no column")]

    [note] = lacking("clok")
    assert note.text.startswith(
        "no column clok: what depends on the time is not looked for; did you mean 'clock'? choices: "
    )
    assert lacking("clock") == []
