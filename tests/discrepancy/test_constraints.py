"""`Constraints`: a machine written as one function gets slopes, charts and sentences like those that ship."""

from dataclasses import replace

import numpy as np
import pytest

from calibench import discrepancy
from calibench.discrepancy import DataError, Instrument, Joint, Length, MeasuredData, Roles
from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.model.formulations import Constraints, check_names
from calibench.discrepancy.model.model import Model
from calibench.problems.base import Parameter

N = 60
STATED = {"turn": 1e-3, "height": 5e-3}


def screw(q):
    """A nut on a screw: `pitch` mm a turn from `zero` mm up."""
    return np.stack([q["pitch"] * q["turn"] + q["zero"] - q["height"]], axis=-1)


PARAMETERS = (Parameter("pitch", "mm", 5.0, 4.9, 5.1), Parameter("zero", "mm", 0.0, -1.0, 1.0))


class Screw:
    name = "screw"

    def __init__(self, closure=screw, noise=STATED):
        self.closure, self.noise = closure, noise

    def formulate(self, data):
        return Constraints(data, self.closure, PARAMETERS, self.noise)


def readings(seed=0, wave=0.0):
    rng = np.random.default_rng(seed)
    turn = np.linspace(0.0, 20.0, N)
    height = 5.02 * turn + 0.3 + wave * np.sin(turn / 3) + 5e-3 * rng.standard_normal(N)
    columns = {"turn": turn + 1e-3 * rng.standard_normal(N), "height": height, "pose_id": np.arange(N)}
    return MeasuredData(columns, "screw", {}, "nut")


def test_the_slopes_of_a_function_are_exact():
    formulation = Screw().formulate(readings())
    q, _ = Model(formulation).quantities(np.array([5.01, 0.2]))
    slopes = formulation.slopes(q)
    np.testing.assert_allclose(slopes["pitch"][:, 0], q["turn"], rtol=1e-14)
    np.testing.assert_allclose(slopes["turn"], np.full((N, 1), 5.01), rtol=1e-14)
    np.testing.assert_allclose(slopes["height"], -np.ones((N, 1)), rtol=1e-14)


def test_a_perfect_screw_lacks_nothing_and_gets_its_pitch():
    report = discrepancy.explain(Screw(), readings())
    assert report.verdict == "none"
    pitch = report.parameters["pitch"]
    assert abs(pitch.after - 5.02) < 4 * pitch.sd < 0.002


def test_what_no_effect_explains_is_unknown_and_has_a_place():
    report = discrepancy.explain(Screw(), readings(wave=0.05))
    assert report.verdict == "unknown"
    assert min(place.p for place in report.where) < 1e-6
    assert {place.target for place in report.where} == {"turn", "height"}
    assert "pose_id" not in {place.covariate for place in report.where}


def test_a_number_that_is_held_stays():
    held = Constraints(readings(), screw, PARAMETERS[1:], STATED, held={"pitch": 5.02})
    _, true = Model(held).quantities(np.array([0.3]))
    assert float(true["pitch"]) == 5.02
    assert set(held.slopes(true)) == {"pitch", "zero", "turn", "height"}


@pytest.mark.parametrize(
    ("machine", "said"),
    [
        (
            Screw(lambda q: screw(q)[:, 0]),
            r"returned shape \(5,\) for 5 readings: a row a reading, a column a constraint",
        ),
        (
            Screw(lambda q: np.abs(screw(q))),
            "slope in pitch by complex step is not its difference; write it with analytic",
        ),
        (Screw(lambda q: np.hypot(screw(q), 1.0)), "closure.q. takes no complex numbers .*no abs, norm, hypot"),
        (Screw(noise={"turn": 1e-3, "hight": 5e-3}), "column 'hight' is missing"),
        (Screw(noise={"turn": 1e-3}), "asks for 'height': state the column .* or in inputs= where it carries no noise"),
        (Screw(lambda q: q["pich"] * screw(q)), "asks for 'pich': no column .*did you mean 'pitch'"),
        (Screw(lambda q: 1 / 0), r"closure\(q\) failed .* ZeroDivisionError: .* \(test_constraints.py, line [0-9]+\)"),
        (Screw(noise=("turn", "height")), "noise: each column with its standard deviation is needed"),
        (Screw(noise={"turn": 0.0, "height": 5e-3}), "noise of turn: 0; a standard deviation above 0"),
    ],
    ids=["shape", "modulus", "hypot", "column", "unstated", "misspelt", "failing", "names alone", "noise"],
)
def test_a_mistake_of_the_author_is_a_sentence(machine, said):
    with pytest.raises(DataError, match=said):
        discrepancy.explain(machine, readings())


def test_a_parameter_whose_bounds_are_exchanged_is_refused():
    exchanged = Parameter("scale", "1", 1.0, 1.01, 0.99)
    with pytest.raises(DataError, match=r"scale: its lower bound 1\.01"):
        check_names("noise", {"turn": 1e-3}, (), {}, [exchanged])


@pytest.mark.parametrize(("cell", "also"), [(np.nan, ""), (-np.inf, ""), (1e308, " (beyond 1e+60 in 1 of them)")])
def test_a_reading_that_is_no_number_or_has_no_square_costs_its_row_and_is_told(cell, also):
    data = readings()
    data = data.with_columns({"height": np.where(np.arange(N) == 7, cell, data["height"])})
    told = Screw().formulate(data).data
    assert len(told) == N - 1
    assert f"1 row is left out for cells that hold no finite number: height in 1{also}" in map(str, told.notes)


def test_a_column_without_noise_is_an_input_whose_errors_are_searched_for():
    rng, data = np.random.default_rng(1), readings()
    side = rng.choice([-1.0, 1.0], N)
    exact = np.round(data["turn"], 2)
    height = 5.02 * exact + 0.3 - 0.02 * side + 5e-3 * rng.standard_normal(N)
    columns = {"turn": exact, "height": height, "side": side}
    roles = Roles(joints=(Joint("nut", "turn", "sliding", direction="side"),))

    class Driven:
        name = "driven"

        def formulate(self, data):
            return Constraints(data, screw, PARAMETERS, {"height": 5e-3}, roles=roles, inputs=("turn",))

    report = discrepancy.explain(Driven(), MeasuredData(columns, "driven", {}, "nut"))
    assert [finding.effect for finding in report.findings] == ["backlash nut"]


def test_rows_at_the_same_inputs_are_no_repeats_where_constraints_are_stated():
    data = readings()
    data = data.with_columns({"load": np.repeat([0.0, 1.0, 0.0], N // 3)})
    formulation = Constraints(data, screw, PARAMETERS, STATED, inputs=("load",))
    machine = type("Loaded", (), {"name": "loaded", "formulate": lambda self, rows: formulation.on(rows)})()
    told = MeasuredData({n: c for n, c in data.columns.items() if n != "pose_id"}, "loaded")
    assert "visit_id" not in validate(machine, told).data


def test_a_column_of_noise_is_in_the_unit_of_its_joint_or_of_the_file():
    roles = Roles(joints=(Joint("nut", "turn"),))
    data = replace(readings(), units={"height": "mm"})
    sensors = Constraints(data, screw, PARAMETERS, STATED, roles=roles).sensors
    assert [(sensor.column, sensor.unit) for sensor in sensors] == [("turn", "rad"), ("height", "mm")]


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (
            lambda: Constraints(readings(), screw, PARAMETERS, STATED, inputs="turn"),
            "inputs: 'turn' is one word; a tuple",
        ),
        (
            lambda: Constraints(readings(), screw, (("pitch", 5.0),), STATED),
            r"parameters: \('pitch', 5.0\) is no Param",
        ),
        (lambda: Joint("nut", "turn", teeth="60"), "nut: teeth '60': a number above 0"),
        (lambda: Roles(joints=Joint("nut", "turn")), "roles: joints is one Joint; a tuple is needed"),
        (lambda: Instrument("laser", "height"), "laser: columns: 'height' is one word"),
        (lambda: Roles(columns="height"), "roles: columns: 'height' is one word"),
    ],
)
def test_what_is_of_another_kind_is_refused_in_a_line(made, said):
    with pytest.raises(DataError, match=said):
        made()


def test_a_machine_that_formulates_nothing_is_told():
    forgetful = type("Forgetful", (), {"name": "forgetful", "formulate": lambda self, data: None})()
    with pytest.raises(DataError, match=r"forgetful: .* returned NoneType"):
        discrepancy.explain(forgetful, readings())


def test_names_that_leave_one_trace_are_not_parted_by_more_of_the_same():
    """A leg that reads its stroke, and a rod that carries on: both grow with the one temperature."""
    rng = np.random.default_rng(4)
    stroke, warmth = rng.uniform(0.0, 100.0, N), rng.uniform(0.0, 8.0, N)
    laser = stroke + 400.2 + 0.01 * warmth + 5e-3 * rng.standard_normal(N)
    roles = Roles((Joint("leg", "stroke", "sliding"),), (Length("rod", "rod"),), temperature="warmth")

    class Leg:
        name = "leg"

        def formulate(self, data):
            rod = (Parameter("rod", "mm", 400.0, 390.0, 410.0),)
            closure = lambda q: np.stack([q["stroke"] + q["rod"] - q["laser"]], axis=-1)  # noqa: E731
            return Constraints(data, closure, rod, {"laser": 5e-3}, roles=roles, inputs=("stroke",))

    report = discrepancy.explain(Leg(), MeasuredData({"stroke": stroke, "warmth": warmth, "laser": laser}, "leg"))
    [found] = report.findings
    assert {rival.effect for rival in found.set} == {"thermal_zero leg", "thermal_length rod"}
    assert found.separated_by.startswith(
        "in all of these readings they leave the same signature, and more of the kind do not"
    )
