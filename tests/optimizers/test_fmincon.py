"""`fmincon`: textbook optima and multipliers, exit flags, display, bad input, and the gate's law."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from fmincon_textbook import EXAMPLES, Example
from scipy.optimize import minimize

from calibench import bench, optimizers, problems
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Stop
from calibench.optimizers.derivatives import differences
from calibench.optimizers.fmincon import Options, Result, fmincon, optimoptions
from tests.few import few

KINDS = ("lower", "upper", "ineqlin", "eqlin", "ineqnonlin", "eqnonlin")
ALGORITHMS = ("sqp", "interior-point")


def solve(example: Example, analytic: bool = False, **options: Any) -> Result:
    given, fun = dict(example.given), example.fun
    if analytic:
        options["SpecifyObjectiveGradient"] = True
        fun = lambda x: (example.fun(x), example.gradient(x))  # noqa: E731
        slopes, nonlcon = example.constraint_gradients, given.get("nonlcon")
        if slopes is not None and nonlcon is not None:
            options["SpecifyConstraintGradient"] = True
            given["nonlcon"] = lambda x: (*nonlcon(x), *slopes(x))
    return fmincon(fun, example.x0, **given, options=Options(**options))


def check(result: Result, example: Example, tolerance: float = 1e-6) -> None:
    np.testing.assert_allclose(result.x, example.x, atol=tolerance, rtol=0)
    assert result.fval == pytest.approx(example.f, abs=tolerance)
    assert result.output.constrviolation <= 1e-6
    for kind in KINDS:
        found = getattr(result.lambda_, kind)
        known = example.multipliers.get(kind, np.zeros(len(found)))
        np.testing.assert_allclose(found, known, atol=tolerance, rtol=0, err_msg=kind)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_sqp_finds_the_known_optimum_and_multipliers_at_default_options(example: Example) -> None:
    result = solve(example)
    check(result, example)
    assert result.exitflag in (1, 2)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_both_algorithms_find_them_with_gradients_and_tight_tolerances(example: Example, algorithm: str) -> None:
    result = solve(example, True, Algorithm=algorithm, OptimalityTolerance=2e-8, StepTolerance=1e-14)
    check(result, example, 1e-7 if algorithm == "sqp" else 6e-7)  # a slack is 2e-8 / multiplier, .04 in HS21
    assert result.exitflag == 1
    assert result.output.firstorderopt <= 2e-8


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_interior_point_stops_inside_by_what_its_barrier_leaves(example: Example) -> None:
    """At OptimalityTolerance 1e-6 a slack is 1e-6 / multiplier: in HS21 (multiplier .04) that is 2e-5 in x."""
    result = solve(example, Algorithm="interior-point")
    check(result, example, 2e-5)
    assert result.exitflag == 1


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_the_optimum_is_scipys(example: Example) -> None:
    given = example.given
    constraints: list[Any] = []
    for matrix, side, kind, sign in (("A", "b", "ineq", -1.0), ("Aeq", "beq", "eq", 1.0)):
        if matrix in given:
            rows, limits = np.array(given[matrix]), np.array(given[side])
            constraints.append({"type": kind, "fun": lambda x, r=rows, b=limits, s=sign: s * (r @ x - b)})
    if "nonlcon" in given:
        for place, kind, sign in ((0, "ineq", -1.0), (1, "eq", 1.0)):
            if len(given["nonlcon"](np.array(example.x0))[place]):
                constraints.append(
                    {"type": kind, "fun": lambda x, p=place, s=sign: s * np.array(given["nonlcon"](x)[p])}
                )
    n = len(example.x0)
    bounds = list(zip(given.get("lb", [None] * n), given.get("ub", [None] * n)))
    start = np.clip(example.x0, given.get("lb", -np.inf), given.get("ub", np.inf))
    theirs = minimize(
        example.fun, start, jac=example.gradient, method="SLSQP", bounds=bounds, constraints=constraints,
        options={"ftol": 1e-14, "maxiter": 500},
    )  # fmt: skip
    ours = solve(example)
    np.testing.assert_allclose(ours.x, theirs.x, atol=1e-6)
    assert ours.fval == pytest.approx(theirs.fun, abs=1e-6)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.name)
def test_multipliers_balance_the_gradient_with_matlabs_signs(example: Example) -> None:
    result, given = solve(example, True, OptimalityTolerance=1e-8, StepTolerance=1e-14), example.given
    la = result.lambda_
    left = result.grad - la.lower + la.upper
    if "A" in given:
        left = left + np.array(given["A"]).T @ la.ineqlin
    if "Aeq" in given:
        left = left + np.array(given["Aeq"]).T @ la.eqlin
    if example.constraint_gradients is not None:
        c, ceq = (np.reshape(g, (len(left), -1)) for g in example.constraint_gradients(result.x))
        left = left + c @ la.ineqnonlin + ceq @ la.eqnonlin
    np.testing.assert_allclose(left, 0.0, atol=1e-7)
    assert min(min(getattr(la, k), default=0.0) for k in KINDS if k not in ("eqlin", "eqnonlin")) >= 0


def test_the_quasi_newton_hessian_of_a_quadratic_is_nearly_its_own() -> None:
    H = np.array([[4.0, 1.0], [1.0, 3.0]])
    result = fmincon(lambda x: 0.5 * x @ H @ x, [3.0, -2.0], options={"FiniteDifferenceType": "central"})
    np.testing.assert_allclose(result.hessian, H, rtol=0.1)


# ---- exit flags


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_linear_contradictions_are_flag_minus_2_before_anything_is_asked(algorithm: str) -> None:
    def fun(x: Any) -> float:
        raise AssertionError("asked")

    options = Options(Algorithm=algorithm)  # type: ignore[arg-type]
    crossed = fmincon(fun, [0.0, 0.0], lb=[0.0, 2.0], ub=[1.0, 1.0], options=options)
    assert crossed.exitflag == -2
    assert "lb[1]=2 is above ub[1]=1" in crossed.output.message
    apart = fmincon(fun, [0.0, 0.0], A=[[1.0, 1.0], [-1.0, -1.0]], b=[-1.0, -1.0], options=options)
    assert apart.exitflag == -2
    assert apart.output.funcCount == 0


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_region_that_curves_away_is_flag_minus_2(algorithm: str) -> None:
    result = fmincon(
        lambda x: x[0], [1.0, 1.0], nonlcon=lambda x: ([x @ x + 1.0], []), options={"Algorithm": algorithm}
    )
    assert result.exitflag == -2
    assert "No feasible point" in result.output.message


def test_a_start_where_the_linearised_constraints_contradict_finds_its_way() -> None:
    """At .1 the tangent of 1 - x^2 <= 0 asks for a step of 5, out of the box, and at 1e-9 for one of 1e9."""
    for start, box in (([0.1, 0.0], 2.0), ([1e-9, 0.0], np.inf)):
        result = fmincon(lambda x: x @ x, start, lb=[-box, -box], ub=[box, box], nonlcon=lambda x: ([1.0 - x @ x], []))
        assert result.exitflag in (1, 2)
        assert result.fval == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("fun", [lambda x: x[0], lambda x: -(x @ x), lambda x: -np.exp(min(x[0], 800.0))])
def test_a_bottomless_objective_is_flag_minus_3(fun: Any, algorithm: str) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        result = fmincon(fun, [1.0, 1.0], options={"Algorithm": algorithm})
    assert result.exitflag == -3
    assert result.fval < -1e20


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1.0 + 2.0j])
def test_an_objective_undefined_at_the_start_is_an_error(bad: Any) -> None:
    with pytest.raises(ValueError, match="objective is undefined at the initial point"):
        fmincon(lambda x: bad, [1.0])
    with pytest.raises(ValueError, match="constraints are undefined at the initial point"):
        fmincon(lambda x: x[0], [1.0], nonlcon=lambda x: ([bad], []))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_nan_later_is_a_refused_step(algorithm: str) -> None:
    """The first step of this valley leads where the logarithm is not defined."""

    def fun(x: Any) -> Any:
        return x[0] - np.log(x[0]) if x[0] > 0 else (float("nan") if x[0] > -1 else 1j)

    result = fmincon(fun, [8.0], options={"Algorithm": algorithm})
    assert result.exitflag in (1, 2)
    assert result.x[0] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_output_function_stops_the_search(algorithm: str) -> None:
    seen: list[tuple[str, int]] = []

    def stop(x: Any, values: Any, state: str) -> bool:
        seen.append((state, values.iteration))
        return bool(values.iteration == 2)

    result = solve(EXAMPLES[0], Algorithm=algorithm, OutputFcn=stop)
    assert result.exitflag == -1
    assert result.output.iterations == 2
    assert seen == [("init", 0), ("iter", 1), ("iter", 2), ("done", 2)]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_limits_are_flag_0(algorithm: str) -> None:
    few = solve(EXAMPLES[0], Algorithm=algorithm, MaxIterations=3)
    assert (few.exitflag, "MaxIterations = 3" in few.output.message) == (0, True)
    assert few.output.iterations <= 3
    short = solve(EXAMPLES[0], True, Algorithm=algorithm, MaxFunctionEvaluations=5)
    assert (short.exitflag, short.output.funcCount) == (0, 5)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_small_step_is_flag_2(algorithm: str) -> None:
    result = solve(EXAMPLES[6], Algorithm=algorithm, OptimalityTolerance=0, StepTolerance=1e-3)
    assert result.exitflag == 2
    assert "step" in result.output.message.lower()


# ---- what it prints and tells


def test_display_prints_matlabs_columns_and_one_line_an_iterate(capsys: pytest.CaptureFixture[str]) -> None:
    result = solve(EXAMPLES[7], Display="iter")
    printed = capsys.readouterr().out
    heads = printed.splitlines()[:2]
    for column in ("Iter", "Func-count", "Fval", "Feasibility", "Step length", "step", "optimality"):
        assert column in heads[1]
    assert re.search(r"Norm of +First-order", heads[0])
    rows = [line.split() for line in printed.splitlines() if re.match(r" *\d+ ", line)]
    assert [int(row[0]) for row in rows] == list(range(result.output.iterations + 1))
    assert float(rows[-1][2]) == pytest.approx(result.fval, abs=1e-5)
    assert all(len(row) == 7 for row in rows)
    assert result.output.message in printed


def test_final_prints_the_message_and_off_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    result = solve(EXAMPLES[0], Display="final")
    assert capsys.readouterr().out.strip() == result.output.message
    solve(EXAMPLES[0])
    assert capsys.readouterr().out == ""


def test_fixed_variables_stay_and_carry_their_multiplier() -> None:
    def fun(x: Any) -> Any:
        return (x[0] - 1) ** 2 + (x[1] + x[0]) ** 2, np.array([2 * (x[0] - 1) + 2 * (x[1] + x[0]), 2 * (x[1] + x[0])])

    for algorithm in ALGORITHMS:
        options = {"Algorithm": algorithm, "SpecifyObjectiveGradient": True}
        result = fmincon(fun, [9.0, 9.0], lb=[2.0, -9.0], ub=[2.0, 9.0], options=options)
        np.testing.assert_allclose(result.x, [2.0, -2.0], atol=1e-6)
        assert result.lambda_.lower[0] == pytest.approx(2.0, abs=1e-5)
        all_fixed = fmincon(fun, [0.0, 0.0], lb=[0.0, 1.0], ub=[0.0, 1.0], options=options)
        assert (all_fixed.exitflag, all_fixed.x.tolist()) == (1, [0.0, 1.0])
        assert all_fixed.lambda_.lower.tolist() == [0.0, 2.0]


def test_a_call_never_leaves_the_bounds_and_no_point_is_asked_twice() -> None:
    for algorithm in ALGORITHMS:
        asked: list[bytes] = []

        def fun(x: Any, asked: list[bytes] = asked) -> float:
            assert (x >= [0.5, -1.0]).all()
            assert (x <= [2.0, 3.0]).all()
            asked.append(x.tobytes())
            return float(100 * (x[1] - x[0] ** 2) ** 2 + (1 - x[0]) ** 2)

        result = fmincon(fun, [2.0, 3.0], lb=[0.5, -1.0], ub=[2.0, 3.0], options={"Algorithm": algorithm})
        np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-3)
        assert result.output.funcCount == len(asked) == len(set(asked))


def test_a_repeated_call_gives_the_same_bits() -> None:
    for algorithm in ALGORITHMS:
        first, second = (solve(EXAMPLES[7], Algorithm=algorithm) for _ in range(2))
        assert first.x.tobytes() == second.x.tobytes()
        assert first.output == second.output
        assert first.lambda_.eqnonlin.tobytes() == second.lambda_.eqnonlin.tobytes()


# ---- bad input: one line each


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"A": [[1.0, 2.0, 3.0]], "b": [1.0]}, r"A has shape \(1, 3\).*2 columns"),
        ({"A": [[1.0, 2.0]], "b": [1.0, 2.0]}, r"b has shape \(2,\)"),
        ({"A": [[1.0, 2.0]]}, "A is given without b"),
        ({"beq": [1.0]}, "beq is given without Aeq"),
        ({"Aeq": [[np.nan, 2.0]], "beq": [1.0]}, "Aeq and beq must be finite"),
        ({"lb": [0.0, 0.0, 0.0]}, r"lb has shape \(3,\)"),
        ({"ub": [0.0, np.nan]}, "ub holds NaN"),
        ({"ub": ["a", "b"]}, "ub must hold real numbers"),
        ({"nonlcon": lambda x: x[0]}, "nonlcon returned float64.*(c, ceq)"),
        ({"nonlcon": lambda x: (np.eye(2), [])}, r"nonlcon returned c of shape \(2, 2\)"),
        ({"nonlcon": 3}, "nonlcon=3"),
        ({"options": {"SpecifyConstraintGradient": True}, "nonlcon": lambda x: ([x[0]], [])}, "gradceq"),
        (
            {
                "options": {"SpecifyConstraintGradient": True},
                "nonlcon": lambda x: (x - 1, [], [1.0, 0, 0], []),
            },
            r"gradc of shape \(3,\): \(2, 2\)",
        ),
        ({"options": {"SpecifyObjectiveGradient": True}}, "as SpecifyObjectiveGradient"),
        ({"options": 7}, "options=7"),
    ],
)
def test_bad_input_is_one_clear_line(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        fmincon(lambda x: float(x @ x), [1.0, 1.0], **given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("x0", [[[1.0, 2.0]], [], [np.nan], ["a"], [1j]])
def test_a_start_that_is_no_vector_of_numbers_is_refused(x0: Any) -> None:
    with pytest.raises(ValueError, match="x0"):
        fmincon(lambda x: float(x @ x), x0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"StepTolerence": 1}, "did you mean 'StepTolerance'"),
        ({"TolX": 1}, "now called 'StepTolerance'"),
        ({"MaxSQPIterations": 1}, "option of active-set, which is not here"),
        ({"InitBarrierParam": 1}, "option of Algorithm='interior-point'; Algorithm is 'sqp'"),
        ({"Algorithm": "active-set"}, "Algorithm=active-set.*choices: sqp, interior-point"),
        ({"OptimalityTolerance": "small"}, "OptimalityTolerance=small: a finite number is needed"),
        ({"StepTolerance": -1}, "StepTolerance=-1: must be 0 or more"),
        ({"MaxFunctionEvaluations": 0}, "MaxFunctionEvaluations=0: must be above 0"),
        ({"MaxIterations": 2.5}, "MaxIterations=2.5: a whole number is needed"),
        ({"OutputFcn": 3}, "OutputFcn=3"),
    ],
)
def test_a_wrong_option_is_one_clear_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        optimoptions(**options)
    assert "\n" not in str(caught.value)


def test_the_registered_optimizer_refuses_the_same() -> None:
    with pytest.raises(ValueError, match="InitBarrierParam"):
        optimizers.make("fmincon", InitBarrierParam=0.5)
    with pytest.raises(ValueError, match="did you mean 'StepTolerance'"):
        optimizers.make("fmincon", StepTolerence=1e-3)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_output_function_that_raises_is_named(algorithm: str) -> None:
    def broken(x: Any, values: Any, state: str) -> bool:
        raise KeyError("colour")

    with pytest.raises(RuntimeError, match=r"KeyError at iteration 0 \(init\): 'colour'"):
        solve(EXAMPLES[0], Algorithm=algorithm, OutputFcn=broken)


def test_what_the_objective_raises_passes_through() -> None:
    def fun(x: Any) -> float:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        fmincon(fun, [1.0])


# ---- differences


@pytest.mark.parametrize("x", [[0.0, 0.5], [1.0, 0.0], [0.3, 1.0]])
def test_central_differences_are_second_order_and_stay_inside_at_every_edge(x: list[float]) -> None:
    lower, upper = np.zeros(2), np.ones(2)

    def function(at: Any) -> float:
        assert ((at >= lower) & (at <= upper)).all()
        return float(np.exp(at[0]) * np.sin(3 * at[1]))

    at = np.array(x)
    slopes = differences(function, at, function(at), lower, upper, upper - lower, "central")
    known = [np.exp(at[0]) * np.sin(3 * at[1]), 3 * np.exp(at[0]) * np.cos(3 * at[1])]
    np.testing.assert_allclose(slopes, known, atol=2e-9)


# ---- through the gate


class Counted:
    """full12 with a record of what was asked where."""

    def __init__(self, error: str) -> None:
        self.inner = problems.make("full12", error=error)
        self.lower, self.upper, self.start = self.inner.lower, self.inner.upper, self.inner.start
        self.asked: list[bytes] = []
        self.sloped: list[bytes] = []

    def __call__(self, x: Any) -> float:
        self.asked.append(x.tobytes())
        return float(self.inner(x))

    def residuals(self, x: Any) -> Any:
        self.asked.append(x.tobytes())
        return self.inner.residuals(x)

    def jacobian(self, x: Any) -> Any:
        self.sloped.append(x.tobytes())
        return self.inner.jacobian(x)


@pytest.mark.slow
@pytest.mark.parametrize("error", ["J2", "J3"])
def test_full12_reaches_1e_17_in_250_objective_and_gradient_passes_10_of_10(error: str) -> None:
    for seed in range(10):
        run = bench.execute(
            problems.make("full12", error=error), optimizers.make("fmincon"), 20_000, seed, start="random"
        )
        assert run.best_value < 1e-17
        assert run.evaluations + run.row["jacobian_evaluations"] <= 250
        assert (run.status, run.stop_reason) == ("ok", "converged")


@pytest.mark.parametrize(("kind", "low", "high"), few(1, [("forward", 1e-3, 10.0), ("central", 1e-9, 1e-6)]))
def test_differences_stall_where_their_error_says(kind: str, low: float, high: float) -> None:
    """J stalls at the square of the gradient's error: steps of eps^(1/2) and eps^(1/3) of the box."""
    optimizer = optimizers.make("fmincon", SpecifyObjectiveGradient=False, FiniteDifferenceType=kind)
    values = [
        bench.execute(problems.make("full12", error="J3"), optimizer, 5_000, seed, start="random").best_value
        for seed in range(4)
    ]
    assert low < np.median(values) < high


def test_one_point_is_one_pass_and_one_jacobian() -> None:
    problem = Counted("J2")
    run = bench.execute(problem, optimizers.make("fmincon"), 20_000, start=problem.inner.lower + 0.3)
    assert len(set(problem.asked)) == len(problem.asked) == run.evaluations
    assert len(set(problem.sloped)) == len(problem.sloped) == run.row["jacobian_evaluations"]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("options", [{}, {"SpecifyObjectiveGradient": False}, {"restarts": True}])
@pytest.mark.parametrize("budget", [1, 7, 50])
def test_the_budget_is_a_wall(budget: int, options: dict[str, Any], algorithm: str) -> None:
    problem = Counted("J2")
    gate = Evaluator(problem, budget)
    try:
        optimizers.make("fmincon", Algorithm=algorithm, **options).minimize(gate, np.random.default_rng(0))
    except Stop:
        pass
    assert gate.charged == budget == len(problem.asked) + 12 * len(problem.sloped)
    assert gate.stopped == "budget"


def test_max_function_evaluations_ends_a_run_before_its_budget() -> None:
    run = bench.execute(problems.make("full12"), optimizers.make("fmincon", MaxFunctionEvaluations=20), 20_000)
    assert (run.evaluations, run.stop_reason) == (20, "converged")


class Holed:
    """A bowl that is not defined on one side of its start."""

    lower, upper, start = np.array([-1.0, -1.0]), np.array([1.0, 1.0]), np.array([-0.5, 0.0])

    def __call__(self, x: Any) -> float:
        return float(x @ x) if x[0] > -0.2 else float("nan")


EDGE = np.array([-0.2 + 1e-12, 0.5])


def test_a_start_that_is_not_defined_is_replaced() -> None:
    run = bench.execute(Holed(), optimizers.make("fmincon"), 200)
    assert run.status == "ok"
    assert run.best_value < 1e-12
    for kind in ("forward", "central"):
        edge = bench.execute(Holed(), optimizers.make("fmincon", FiniteDifferenceType=kind), 200, start=EDGE)
        assert edge.status == "ok"
    nowhere = Holed()
    nowhere.__class__ = type("Nowhere", (Holed,), {"__call__": lambda self, x: float("nan")})
    run = bench.execute(nowhere, optimizers.make("fmincon"), 50)
    assert (run.status, run.row["error_type"], run.evaluations) == ("failed", "NoFiniteValue", 50)


def test_unscaled_slsqp_stops_in_mm4_where_it_stands() -> None:
    """Why ScaleProblem is on: the first gradient is 1e10, and SLSQP calls its own subproblem incompatible."""
    run = bench.execute(problems.make("full12"), optimizers.make("fmincon", ScaleProblem=False), 20_000, start="random")
    assert run.best_value > 1.0
