"""Methods of extra packages: each is the package's own search, and its absence is told in one line."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.gate.evaluator import Evaluator


class Line:
    """Residuals of a line in the unit box; keeps the points that it was asked for."""

    lower, upper, start = np.zeros(2), np.ones(2), np.array([0.9, 0.2])

    def __init__(self) -> None:
        self.asked: list[list[float]] = []

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.asked.append(x.tolist())
        return np.array([x[0] - 0.3, 3 * (x[1] - x[0] ** 2), 0.1 * x[1]])

    def __call__(self, x: np.ndarray) -> float:
        r = self.residuals(x)
        return float(r @ r)


@pytest.mark.filterwarnings("ignore")
def test_dfols_asks_for_the_points_of_a_direct_call() -> None:
    dfols = pytest.importorskip("dfols", reason="an extra: pip install 'calibench[methods]'")
    ours, direct = Line(), Line()
    optimizers.make("dfols").minimize(Evaluator(ours, 500), np.random.default_rng(0))
    size = np.linalg.norm(Line().residuals(direct.start))
    options = {"model.abs_tol": 0.0, "model.rel_tol": 0.0, "init.random_initial_directions": False}
    dfols.solve(
        lambda x: direct.residuals(x) / size, direct.start, bounds=(direct.lower, direct.upper), rhobeg=0.1,
        rhoend=1e-15, maxfun=500, do_logging=False, user_params=options | {"slow.max_slow_iters": 500},
    )  # fmt: skip
    assert len(direct.asked) > 10
    assert ours.asked == direct.asked


def test_dfols_finds_a_calibration_without_derivatives() -> None:
    pytest.importorskip("dfols", reason="an extra: pip install 'calibench[methods]'")
    problem = problems.make("sensor_zero")
    run = bench.execute(problem, optimizers.make("dfols"), budget=200)
    assert (run.stop_reason, run.row["jacobian_evaluations"]) == ("converged", 0)
    assert run.best_value < problem.targets[-1]


class Coarse:
    """Residuals as a simulator writes them: rounded to a millionth of the largest at the start."""

    def __init__(self) -> None:
        self.exact = problems.make("sensor_zero")
        self.lower, self.upper, self.start = self.exact.lower, self.exact.upper, self.exact.start
        self.step = 1e-6 * np.abs(self.exact.residuals(self.start)).max()

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.round(self.exact.residuals(x) / self.step) * self.step

    def __call__(self, x: np.ndarray) -> float:
        r = self.residuals(x)
        return float(r @ r)


def test_dfols_goes_on_where_differences_see_nothing() -> None:
    pytest.importorskip("dfols", reason="an extra: pip install 'calibench[methods]'")
    problem = Coarse()
    found = {
        name: problem.exact(bench.execute(problem, optimizers.make(name), budget=120, start="random").best_x)
        for name in ("dfols", "lm", "trf")
    }
    assert found["dfols"] < 1e-3 * min(found["lm"], found["trf"])


@pytest.mark.filterwarnings("ignore")
def test_pycma_asks_for_the_points_of_a_direct_call() -> None:
    cma = pytest.importorskip("cma", reason="an extra: pip install 'calibench[methods]'")
    ours, rng = Line(), np.random.default_rng(4)
    run = Evaluator(ours, 60)
    with pytest.raises(optimizers.BudgetExhausted):
        optimizers.make("pycma_cmaes").minimize(run, np.random.default_rng(4))
    search = cma.CMAEvolutionStrategy(
        Line.start, 0.3,
        {"bounds": [0, 1], "randn": lambda *k: rng.standard_normal(k), "seed": np.nan, "verbose": -9, "tolx": 0},
    )  # fmt: skip
    direct = Line()
    while len(direct.asked) < 60:
        members = search.ask()
        search.tell(members, [direct(x) for x in members])
    assert ours.asked == direct.asked[:60]


def test_a_package_that_is_missing_is_told_with_the_way_to_it() -> None:
    code = "import importlib.util as u\nfind = u.find_spec\n"
    code += "u.find_spec = lambda name, *rest: None if name in ('dfols', 'cma') else find(name, *rest)\n"
    code += (
        "from calibench import optimizers\nprint([n for n in optimizers.names() if n in ('dfols', 'pycma_cmaes')])\n"
    )
    code += "try:\n    optimizers.make('dfols')\nexcept ValueError as error:\n    print(error)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    none, said = done.stdout.splitlines()
    assert none == "[]"
    assert said == (
        "optimizer 'dfols' is left out: its package dfols is not installed here: pip install 'calibench[methods]'"
    )
