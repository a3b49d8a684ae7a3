"""`fmincon` as MATLAB's releases had it: difference steps and stops computed by hand, presets, bad values."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from calibench import bench, optimizers, problems
from calibench.bench.provenance.run_id import chosen_options, options_of
from calibench.optimizers.derivatives import differences
from calibench.optimizers.fmincon import Result, fmincon, optimoptions

ROOT_EPS = np.finfo(float).eps ** 0.5
PLACES = ("after_step", "next_gradient", "before_step")


def asked_by(x0: list[float], **options: Any) -> tuple[list[np.ndarray], list[tuple[np.ndarray, np.ndarray]]]:
    """Return every point asked, and the iterates with their gradients, of a search on a valley of fourth powers."""
    points: list[np.ndarray] = []
    path: list[tuple[np.ndarray, np.ndarray]] = []

    def fun(x: Any) -> float:
        points.append(x)
        return float((x**4).sum() + (x[0] - 2.0) ** 2)

    def note(x: Any, values: Any, state: str) -> bool:
        if state != "done":
            path.append((x, values.gradient))
        return False

    fmincon(fun, x0, options={"OutputFcn": note, "MaxIterations": 5, **options})
    return points, path


def steps_at(x: np.ndarray, points: list[np.ndarray]) -> np.ndarray:
    """Return the steps of the n differences that follow x among the points asked."""
    first = next(i for i, point in enumerate(points) if np.array_equal(point, x)) + 1
    return np.array([(points[first + i] - x)[i] for i in range(len(x))])


# ---- steps


def test_typical_x_steps_by_the_larger_of_x_and_typical_x_to_the_side_of_its_sign() -> None:
    points, path = asked_by([-3.0, 0.0, 0.5], FiniteDifferenceStepRule="typical_x")
    np.testing.assert_allclose(steps_at(path[0][0], points), ROOT_EPS * np.array([-3.0, 1.0, 1.0]), rtol=1e-7)


def test_step_size_and_typical_x_are_one_number_or_one_a_variable() -> None:
    given = {"FiniteDifferenceStepRule": "typical_x", "TypicalX": (1.0, 2.0, 4.0)}
    points, path = asked_by([-3.0, 0.0, 0.5], FiniteDifferenceStepSize=0.1, **given)
    np.testing.assert_allclose(steps_at(path[0][0], points), [-0.3, 0.2, 0.4])
    points, path = asked_by([-3.0, 0.0, 0.5], FiniteDifferenceStepSize=np.array([0.1, 0.2, 0.3]), **given)
    np.testing.assert_allclose(steps_at(path[0][0], points), [-0.3, 0.4, 1.2])


def test_central_differences_step_to_both_sides() -> None:
    points, _ = asked_by(
        [-3.0, 0.5], FiniteDifferenceStepRule="typical_x", FiniteDifferenceStepSize=0.1, FiniteDifferenceType="central"
    )
    moved = np.array(points[1:5]) - points[0]
    np.testing.assert_allclose(moved, [[0.3, 0.0], [-0.3, 0.0], [0.0, 0.1], [0.0, -0.1]], atol=1e-15)


def test_gradient_steps_change_f_by_1e_8_as_the_gradient_of_the_iterate_before_tells() -> None:
    points, path = asked_by([1.0, 3.0], FiniteDifferenceStepRule="gradient", ScaleProblem=False)
    assert len(path) >= 4
    for x, _ in path[:2]:  # it knows no gradient yet
        np.testing.assert_allclose(steps_at(x, points), [-1e-8, -1e-8], rtol=1e-6)
    for (_, before), (x, _) in itertools.pairwise(path[1:4]):
        wanted = -1e-8 / before
        wanted = np.sign(wanted) * np.clip(np.abs(wanted), 1e-8, 0.1)
        np.testing.assert_allclose(steps_at(x, points), wanted, rtol=1e-6)
    assert any(abs(steps_at(x, points)).max() > 1.1e-8 for x, _ in path[2:])


@pytest.mark.parametrize(("rule", "least", "most"), [("typical_x", 1e-3, 0.1), ("gradient", 1e-5, 1e-4)])
def test_no_step_is_shorter_or_longer_than_the_limits(rule: str, least: float, most: float) -> None:
    limits = {"DiffMinChange": least, "DiffMaxChange": most}
    points, path = asked_by([1.0, 3.0], FiniteDifferenceStepRule=rule, **limits)
    for x, _ in path:
        steps = np.abs(steps_at(x, points))
        assert (steps >= least * (1 - 1e-6)).all()
        assert (steps <= most * (1 + 1e-6)).all()


def test_a_step_out_of_the_box_turns_and_a_narrow_box_is_stepped_through() -> None:
    asked: list[float] = []

    def function(at: Any) -> float:
        asked.append(float(at[0]))
        return 2.0 * float(at[0])

    one = np.ones(1)
    for x, step, goes_to in ((0.9, 0.2, 0.7), (0.1, -0.2, 0.3), (0.4, 0.7, 1.0), (0.6, 0.7, 0.0), (0.0, -1.5, 1.0)):
        slope = differences(function, x * one, 2.0 * x, 0 * one, one, one, steps=step * one)
        assert asked[-1] == pytest.approx(goes_to)
        assert slope[0] == pytest.approx(2.0)


def test_a_variable_at_its_bound_is_differenced_inside_by_every_rule() -> None:
    for rule in ("typical_x", "gradient"):

        def fun(x: Any) -> float:
            assert ((x >= -1.0) & (x <= 2.0)).all()
            return float(((x - 3.0) ** 2).sum())

        options = {"FiniteDifferenceStepRule": rule}
        result = fmincon(fun, [2.0, -1.0], lb=[-1.0, -1.0], ub=[2.0, 2.0], options=options)
        np.testing.assert_allclose(result.x, [2.0, 2.0])


# ---- stops. f = x^2 / 4 from 1: d = -1/2 (B = 1), g d = -1/4, at the new point -1/8; then d = -1/2 (B = 1/2) to 0


def halving(**options: Any) -> Result:
    given = {"SpecifyObjectiveGradient": True, "ScaleProblem": False, "OptimalityTolerance": 0.0, "StepTolerance": 0.0}
    return fmincon(lambda x: (0.25 * x[0] ** 2, 0.5 * x), [1.0], options={**given, "StopRule": "absolute", **options})


@pytest.mark.parametrize(
    ("place", "tolerance", "x", "iterations"),
    [
        ("after_step", 0.13, 0.5, 1),  # 1/4 < .26, by the gradient at the point left
        ("after_step", 0.1, 0.0, 2),  # 1/4 > .2, then 1/8 < .2
        ("next_gradient", 0.1, 0.5, 1),  # 1/8 < .2, by the gradient at the point reached
        ("before_step", 0.26, 1.0, 0),  # 1/4 < .26, and no step is taken
        ("before_step", 0.13, 0.5, 1),  # 1/4 > .13, then 1/8 < .13
    ],
)
def test_the_directional_derivative_stops_where_the_place_says(
    place: str, tolerance: float, x: float, iterations: int
) -> None:
    result = halving(StopPlace=place, FunctionTolerance=tolerance)
    assert (result.exitflag, result.output.iterations) == (5, iterations)
    assert result.x[0] == pytest.approx(x, abs=1e-12)
    assert "FunctionTolerance" in result.output.message


@pytest.mark.parametrize(("place", "x"), [("after_step", 0.5), ("next_gradient", 0.5), ("before_step", 1.0)])
def test_the_search_direction_stops_at_twice_the_step_tolerance(place: str, x: float) -> None:
    small = halving(StopPlace=place, FunctionTolerance=0.0, StepTolerance=0.251)
    assert (small.exitflag, small.x[0]) == (4, pytest.approx(x))
    large = halving(StopPlace=place, FunctionTolerance=0.0, StepTolerance=0.249)
    assert large.x[0] == pytest.approx(0.0, abs=1e-12)


def test_the_place_is_the_next_gradient_unless_said() -> None:
    assert halving(FunctionTolerance=0.1).x[0] == halving(FunctionTolerance=0.1, StopPlace="next_gradient").x[0] == 0.5


def test_after_the_step_the_gradient_is_that_of_the_point_left() -> None:
    result = halving(StopPlace="after_step", FunctionTolerance=0.13)
    assert result.grad.tolist() == [0.5]
    assert result.fval == 0.25 * 0.5**2


@pytest.mark.parametrize("place", PLACES)
def test_an_absolute_stop_waits_until_the_constraints_are_met(place: str) -> None:
    options = {"StopRule": "absolute", "StopPlace": place, "FunctionTolerance": 1e9, "OptimalityTolerance": 0.0}
    valley = lambda x: float(x[0] ** 2 + (x[1] - 3.0) ** 4)  # noqa: E731
    result = fmincon(valley, [0.0, 0.0], nonlcon=lambda x: ([1.0 - x[0]], []), options=options)
    assert result.exitflag == 5
    assert result.x[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("place", PLACES)
def test_a_smaller_unit_of_f_ends_an_absolute_search_earlier_and_not_a_relative_one(place: str) -> None:
    def iterations(unit: float, **options: Any) -> int:
        def fun(x: Any) -> tuple[float, Any]:
            return unit * float((x**4).sum()), unit * 4.0 * x**3

        given = {"SpecifyObjectiveGradient": True, "OptimalityTolerance": 0.0, "StepTolerance": 1e-6, **options}
        return fmincon(fun, [1.0, 3.0], options=given).output.iterations

    assert iterations(1.0) == iterations(2.0**20)
    absolute = {"StopRule": "absolute", "StopPlace": place}
    assert iterations(1.0, **absolute) < iterations(2.0**20, **absolute)


# ---- through the gate, and as presets


def preset(name: str) -> dict[str, Any]:
    """Return the options of a preset of conf/optimizer, with those of what it stands on."""
    path = Path(bench.__file__).parents[1] / "conf" / "optimizer" / f"{name}.yaml"
    if not path.exists():
        return {}
    found: Any = OmegaConf.to_container(OmegaConf.load(path))
    (below,) = found.pop("defaults")
    return {**preset(below), **found}


RULES_1998 = {
    "OptimalityTolerance": 0, "StepTolerance": 1e-6, "FunctionTolerance": 1e-6, "SpecifyObjectiveGradient": False,
    "FiniteDifferenceStepRule": "gradient", "DiffMinChange": 1e-8, "DiffMaxChange": 0.1, "StopRule": "absolute",
    "StopPlace": "after_step", "MaxIterations": 400, "ScaleVariables": False,
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("fmincon_matlab_1998", {}),
        ("fmincon_matlab", {"OptimalityTolerance": 1e-6, "StopPlace": "next_gradient"}),
        (
            "fmincon_matlab_2003",
            {"OptimalityTolerance": 1e-6, "StopPlace": "next_gradient", "FiniteDifferenceStepRule": "typical_x"},
        ),
        (
            "fmincon_matlab_2009",
            {"OptimalityTolerance": 1e-6, "StopPlace": "before_step", "FiniteDifferenceStepRule": "typical_x"},
        ),
    ],
)
def test_a_preset_is_exactly_the_rules_of_its_release(name: str, changes: dict[str, Any]) -> None:
    assert preset(name) == {**RULES_1998, **changes}
    run = bench.execute(problems.make("sensor_zero"), optimizers.make("fmincon", **preset(name)), 2_000)
    assert (run.status, run.stop_reason) == ("ok", "converged")


def test_the_registered_optimizer_steps_and_stops_as_the_function_does() -> None:
    problem, options = problems.make("link_length", error="J3"), preset("fmincon_matlab")
    direct = fmincon(
        problem, problem.start, lb=problem.lower, ub=problem.upper, options={**options, "MaxFunctionEvaluations": 9_000}
    )
    run = bench.execute(problem, optimizers.make("fmincon", **options), 10_000)
    assert run.evaluations == direct.output.funcCount
    assert run.best_value <= direct.fval


def test_new_options_leave_the_names_of_old_runs_alone() -> None:
    plain = optimizers.make("fmincon", OptimalityTolerance=1e-6, SpecifyObjectiveGradient=False)
    kept = chosen_options(optimizers.registry, "fmincon", options_of(plain))
    assert kept == {"OptimalityTolerance": 1e-6, "SpecifyObjectiveGradient": False}


# ---- bad values: one line each


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"FiniteDifferenceStepRule": "typical"}, "FiniteDifferenceStepRule=typical: did you mean 'typical_x'"),
        ({"TypicalX": 2.0}, "TypicalX is an option of FiniteDifferenceStepRule='typical_x'; FiniteDif.* is 'box'"),
        ({"FiniteDifferenceStepSize": 1e-6, "FiniteDifferenceStepRule": "gradient"}, "='typical_x'; .* is 'gradient'"),
        ({"DiffMinChange": 1e-8}, "DiffMinChange is an option of FiniteDifferenceStepRule='typical_x' or 'gradient'"),
        ({"FiniteDifferenceStepRule": "typical_x", "TypicalX": (1.0, 0.0)}, r"TypicalX=\[1.0,0.0\]: must be above 0"),
        ({"FiniteDifferenceStepRule": "typical_x", "FiniteDifferenceStepSize": -1e-8}, "=-1e-08: must be above 0"),
        ({"FiniteDifferenceStepRule": "typical_x", "DiffMinChange": -1.0}, "DiffMinChange=-1.0: must be 0 or more"),
        ({"FiniteDifferenceStepRule": "gradient", "DiffMinChange": 0.2}, "DiffMinChange=0.2 must be below .*=0.1"),
        ({"FinDiffRelStep": 1e-6}, "now called 'FiniteDifferenceStepSize'"),
        ({"StopPlace": "before_step"}, "StopPlace is an option of StopRule='absolute'; StopRule is 'relative'"),
        ({"FunctionTolerance": 1e-6}, "FunctionTolerance is an option of StopRule='absolute'"),
        ({"StopRule": "absolute", "StopPlace": "before"}, "StopPlace=before: .*choices: after_step, next_gradient"),
        ({"StopRule": "absolute", "FunctionTolerance": -1.0}, "FunctionTolerance=-1.0: must be 0 or more"),
        ({"StopRule": "absolute", "Algorithm": "interior-point"}, "is an option of Algorithm='sqp'"),
        ({"StopRule": 3}, "StopRule=3: choices: relative, absolute"),
    ],
)
def test_a_wrong_rule_is_one_clear_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        optimoptions(**options)
    assert "\n" not in str(caught.value)
    if "FinDiffRelStep" not in options:
        with pytest.raises(ValueError, match=words):
            optimizers.make("fmincon", **options)


@pytest.mark.parametrize("name", ["TypicalX", "FiniteDifferenceStepSize"])
def test_values_for_other_variables_than_there_are_is_one_clear_line(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} has 3 values"):
        fmincon(lambda x: float(x @ x), [1.0, 1.0], options={"FiniteDifferenceStepRule": "typical_x", name: (1, 2, 3)})
