"""The objective's seconds: counts by kind, what a call of each takes, and what a run would have paid in them."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.execution.run import Spec
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.time_limit import Mirror
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics import summary
from calibench.bench.statistics.summary import KINDS, priced
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs

pytestmark = pytest.mark.usefixtures("undrawn")


class Timed:
    """A problem that takes what `clock` is told, and whose Jacobian takes 1.9 values."""

    lower, upper, start = -np.ones(3), np.ones(3), np.zeros(3)

    def __init__(self, clock):
        self.clock, self.seen = clock, []

    def __call__(self, x):
        self.clock[0] += 2e-3
        self.seen.append(tuple(x))
        return float(x @ x)

    def batch(self, points):
        self.clock[0] += 1e-4 * len(points)
        return (points**2).sum(axis=1)

    def residuals(self, x):
        self.clock[0] += 3e-3
        return x

    def jacobian(self, x):
        self.clock[0] += 3.8e-3
        return np.eye(3)

    def gradient(self, x):
        self.clock[0] += 2.5e-3
        return 2 * x

    def value_and_gradient(self, x):
        self.clock[0] += 4e-3
        return float(x @ x), 2 * x


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(costs, "perf_counter", lambda: now[0])
    return now


def test_a_call_costs_what_it_takes(clock):
    found = costs.costs_of(Timed(clock))
    assert found == pytest.approx(
        {
            "value_s": 2e-3,
            "batch_s": 1e-4,
            "residuals_s": 3e-3,
            "jacobian_s": 3.8e-3,
            "gradient_s": 2.5e-3,
            "joint_s": 4e-3,
        }
    )
    assert clock[0] < 0.2


def test_no_point_is_asked_for_twice_in_a_row(clock):
    problem = Timed(clock)
    costs.costs_of(problem)
    assert len(problem.seen) > 4
    assert all(a != b for a, b in zip(problem.seen, problem.seen[1:], strict=False))


def test_what_a_problem_has_not_or_cannot_costs_nothing_known(clock):
    class Breaks(Timed):
        batch = None

        def jacobian(self, x):
            raise RuntimeError("never")

    assert [kind for kind, s in costs.costs_of(Breaks(clock)).items() if s is None] == ["batch_s", "jacobian_s"]


def test_a_slow_call_is_measured_once(clock):
    class Slow(Timed):
        def __call__(self, x):
            self.clock[0] += 2.0
            return super().__call__(x)

    problem = Slow(clock)
    assert costs.costs_of(problem)["value_s"] == pytest.approx(2.002)
    assert len(problem.seen) == 2  # the first, which may compile, and the one that counts


@pytest.mark.parametrize(
    ("name", "batch", "residuals"), [("lm", False, True), ("de", True, False), ("nlopt_LN_BOBYQA", False, False)]
)
@pytest.mark.parametrize("limit", [None, 60.0])
def test_evaluations_are_counted_by_kind(name, batch, residuals, limit):
    row = bench.execute(problems.make("sensor_zero"), optimizers.make(name), budget=200, time_limit=limit).row
    assert row["batch_evaluations"] == (row["evaluations"] if batch else 0)
    assert row["residual_evaluations"] == (row["evaluations"] if residuals else 0)


def test_a_batch_of_a_problem_without_one_is_single_values():
    class Single:
        lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)

        def __call__(self, x):
            return float(x @ x)

    gate = Evaluator(Single(), 100)
    gate.batch(np.zeros((7, 2)))
    assert (gate.evaluations, gate.batch_evaluations) == (7, 0)


def test_a_run_that_is_killed_keeps_its_counts_by_kind():
    gate = Evaluator(problems.make("sensor_zero"), 100)
    mirror = Mirror()
    mirror.show(gate)
    gate.refuse_after(np.inf, mirror.publish, memoryview(mirror.head))
    gate.batch(np.ones((5, 3)))
    gate.residuals(np.ones(3))
    gate(np.ones(3))
    told = mirror.read()
    assert (told["batch_evaluations"], told["residual_evaluations"]) == (5, 1)


def test_a_run_is_priced_by_its_counts():
    rows = {
        "problem": "p", "problem_options": "{}", "data_id": "", "evaluations": [110, 10, 5, 7],
        "batch_evaluations": [100, 0, 0, None], "residual_evaluations": [0, 10, 0, None],
        "jacobian_evaluations": [0, 4, 1, 0],
    }  # fmt: skip
    runs = pd.DataFrame(rows)
    record = {"problem": "p", "problem_options": "{}", "data_id": "", "value_s": 1.0, "batch_s": 0.1}
    record |= {"residuals_s": 2.0, "jacobian_s": 1.5}
    assert priced(runs, [record]).tolist()[:3] == pytest.approx([20.0, 26.0, 6.5])
    assert np.isnan(priced(runs, [record])[3])  # from before the kinds were counted
    without = priced(runs, [record | {"jacobian_s": None}])
    assert without.isna().tolist() == [False, True, True, True]
    assert priced(runs, []).isna().all()


def test_a_gradient_is_priced_as_it_was_asked_for():
    rows = {
        "problem": "p", "problem_options": "{}", "data_id": "", "evaluations": [7, 7, 7], "batch_evaluations": 0,
        "residual_evaluations": 0, "jacobian_evaluations": [5, 5, 5], "gradient_evaluations": [5, 5, None],
        "joint_evaluations": [0, 4, None],
    }  # fmt: skip
    record = {"problem": "p", "problem_options": "{}", "data_id": "", "value_s": 1.0, "jacobian_s": 0.1}
    record |= {"gradient_s": 2.0, "joint_s": 2.5}
    assert priced(pd.DataFrame(rows), [record]).tolist() == pytest.approx([17.0, 15.0, 7.5])


def test_a_problem_that_ends_its_process_loses_only_its_own_costs(tmp_path, monkeypatch):
    (tmp_path / "deadly_costs.py").write_text(
        "import os\nimport numpy as np\nclass Bowl:\n    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)\n"
        "    def __call__(self, x): return float(x @ x)\n    def residuals(self, x): return x\n"
        "class Deadly(Bowl):\n    def residuals(self, x): os._exit(3)\n"
        "class Unborn(Bowl):\n    def __init__(self): raise RuntimeError('no')\n"
        "class Forks(Bowl):\n    def residuals(self, x):\n        os.fork()\n        return x\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    specs = [Spec(f"deadly_costs:{name}", {}, "de", {}, 10, 0) for name in ("Deadly", "Unborn", "Forks", "Bowl")]
    records = list(costs.measured([*specs, specs[-1]]))
    assert [record["problem"] for record in records] == [f"deadly_costs:{name}" for name in ("Deadly", "Forks", "Bowl")]
    found = {record["problem"].partition(":")[2]: record for record in records}
    assert found["Deadly"]["value_s"] > 0
    assert found["Deadly"]["residuals_s"] is None
    assert found["Bowl"]["residuals_s"] > 0
    assert not list(costs.measured(specs[2:], records))


def test_a_problem_whose_values_differ_at_one_point_is_told_before_its_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "unlike_costs.py").write_text(
        "import numpy as np\nclass Same:\n    lower, upper, start = -np.ones(2), np.ones(2), np.ones(2) / 2\n"
        "    def __call__(self, x): return float(x @ x)\n"
        "class Noisy(Same):\n    def __call__(self, x): return super().__call__(x) + np.random.rand()\n"
        "class Says(Same):\n    stochastic = True\n"
        "    def __call__(self, x): return super().__call__(x) + self.rng.random()\n"
        "class Vector(Same):\n    def __call__(self, x): return x\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    named = ",".join(f"unlike_costs:{name}" for name in ("Same", "Noisy", "Says", "Vector"))
    with pytest.raises(SystemExit):
        main(["run", "-m", f"problem={named}", "optimizer=de", "budget=30", "seeds=1", f"results={tmp_path}"])
    told = [line for line in capsys.readouterr().err.splitlines() if "stochastic" in line]
    assert len(told) == 1
    assert "unlike_costs:Noisy: the same point gave" in told[0]


def test_a_value_that_is_not_the_sum_of_the_squared_residuals_is_told_before_the_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "two_goals.py").write_text(
        "import numpy as np\nclass One:\n    lower, upper, start = -np.ones(2), np.ones(2), np.ones(2) / 2\n"
        "    def residuals(self, x): return x - 0.1\n"
        "    def __call__(self, x): return float(np.sum(np.float32(self.residuals(x)) ** 2))\n"
        "class Half(One):\n    def __call__(self, x): return super().__call__(x) / 2\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(SystemExit):
        main(["run", "-m", "problem=two_goals:One,two_goals:Half", "optimizer=lm", "budget=9", f"results={tmp_path}"])
    (told,) = [line for line in capsys.readouterr().err.splitlines() if "squared residuals" in line]
    assert "two_goals:Half: at its start the value is 0.16 and the sum of its squared residuals 0.32" in told


def test_only_what_its_methods_call_is_measured_of_a_problem_of_ours_and_more_once_another_asks():
    de, lm = (Spec("sensor_zero", {}, name, {}, 10, 0) for name in ("de", "lm"))
    (values,) = costs.measured([de, de])
    assert [kind for kind in KINDS if kind in values] == ["value_s", "batch_s"]
    assert not list(costs.measured([de], [values]))
    (more,) = costs.measured([de, lm], [values])
    assert more["residuals_s"] > 0
    assert more["jacobian_s"] > 0
    assert not list(costs.measured([de, lm], [values, more]))


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "named"), [("", 0), ("-", 1)])
@pytest.mark.parametrize("kind", ["gradient", "jacobian"])
def test_a_derivative_that_is_none_is_told_before_the_first_run(kind, sign, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    file = tmp_path / f"slope_{kind}_{named}.py"
    slope = "2 * x" if kind == "gradient" else "np.eye(3)"
    file.write_text(f"""
import numpy as np
class Bowl:
    lower, upper, start = np.full(3, -1.0), np.full(3, 2.0), np.full(3, 0.5)
    def __call__(self, x):
        if not np.all((self.lower <= x) & (x <= self.upper)):
            raise ValueError("the box is all that the simulator knows")
        return float(x @ x)
    def residuals(self, x):
        return x + 0.0 * self(x)
    def {kind}(self, x):
        return ({slope}) * np.array([1.0, {sign}1.0, 1.0])
""")
    with pytest.raises(SystemExit):
        main(["run", f"problem=./{file.name}:Bowl", "optimizer=de", "budget=9", f"results={tmp_path}"])
    assert capsys.readouterr().err.count(f"its {kind} is wrong: along a line through the box") == named


def test_a_sweep_measures_each_problem_once_and_tells_the_second_currency(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    for seeds in (1, 2):
        with pytest.raises(SystemExit) as ended:
            main(f"run -m problem=sensor_zero optimizer=lm,de budget=100 seeds={seeds} results={tmp_path}".split())
        assert ended.value.code == 0
    store = ResultStore(tmp_path / "adhoc")
    (record,) = json.loads((store.folder / "manifest.json").read_text())["costs"]
    assert all(record[kind] > 0 for kind in KINDS[:4])  # it has no gradient of its own
    runs = store.runs()
    write_report(store)
    for name in ("summary", "overview"):
        table = pd.read_csv(store.folder / f"{name}.csv").set_index("optimizer")
        de = runs[runs["optimizer"] == "de"]
        assert table.at["de", "objective_s_median"] == pytest.approx(record["batch_s"] * de["evaluations"].median())
        lm = runs[runs["optimizer"] == "lm"].iloc[0]
        paid = lm["evaluations"] * record["residuals_s"] + lm["jacobian_evaluations"] * record["jacobian_s"]
        assert table.at["lm", "objective_s_median"] == pytest.approx(paid)
    page = (store.folder / "report.html").read_text()
    assert "one call takes: a value" in page
    assert "of these the objective" in page
    assert "objective_s_median" not in summary.summary(runs)
