"""What the user's code raises, and slopes that are no numbers: the row says so, whatever the method makes of it.

An exception of the objective, the residuals, a Jacobian or a batch ends the run at that call. `KeyboardInterrupt` is
raised to the caller, as Ctrl-C is.
"""

import itertools

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.cli import main
from calibench.bench.gate.endings import ToldError
from tests.few import one_of_each

BUDGET = 3000
SLOPES_ASKED = (
    "lm", "trf", "dogbox", "fmincon", "nlopt_LD_SLSQP", "nlopt_LD_LBFGS", "nlopt_LD_VAR2", "nlopt_LD_TNEWTON",
    "nlopt_LD_MMA", "nlopt_LD_CCSAQ", "nlopt_LD_AUGLAG", "nlopt_GD_STOGO", "nlopt_GD_MLSL", "pygmo_ipopt",
)  # fmt: skip


class Mine(BaseException):
    """Neither an error nor an end of the program."""


class Valley:
    """Rosenbrock's valley, whose `call` th evaluation raises `error`."""

    lower, upper, start = np.full(2, -2.0), np.full(2, 2.0), np.array([-1.2, 1.0])

    def __init__(self, error=None, call=0):
        self.calls, self.error, self.call = 0, error, call

    def residuals(self, x):
        self.calls += 1
        if self.calls == self.call:
            raise self.error(f"broke at call {self.call}")
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    def __call__(self, x):
        r = self.residuals(x)
        return float(r @ r)


class Slopes(Valley):
    """The same with a Jacobian, as a function of x gives it."""

    def __init__(self, slopes):
        super().__init__()
        self.jacobian = slopes


def check_end(name, error, call):
    """Check that the run of a method ends at that call, and says why."""
    method, problem = optimizers.make(name), Valley(error, call)
    told = f"broke at call {call}"
    if error is KeyboardInterrupt:
        with pytest.raises(KeyboardInterrupt, match=told):
            bench.execute(problem, method, BUDGET)
    else:
        run = bench.execute(problem, method, BUDGET)
        assert (run.status, run.stop_reason, run.error_type) == ("failed", "failed", error.__name__)
        assert (run.error, run.evaluations) == (told, call)
        assert "in residuals" in run.row["traceback"]
    assert method.traits.may_hang or problem.calls == call  # in a process of its own


QUICK = ((ValueError, 1), (SystemExit, 2), (KeyboardInterrupt, 7), (Mine, 30))


@pytest.mark.parametrize("name", [name for name in one_of_each(optimizers.names()) if isinstance(name, str)])
def test_what_the_objective_raises_ends_the_run_at_that_call(name):
    for error, call in QUICK:
        check_end(name, error, call)


@pytest.mark.slow
@pytest.mark.parametrize("name", optimizers.names())
def test_it_does_so_at_each_of_the_first_thirty_calls(name):
    for error, call in itertools.product((ValueError, KeyboardInterrupt, SystemExit, Mine), range(1, 31)):
        check_end(name, error, call)


@pytest.mark.parametrize("name", SLOPES_ASKED)
@pytest.mark.parametrize("error", [ValueError, Mine])
def test_what_a_jacobian_raises_ends_the_run(name, error):
    def slopes(x):
        raise error("no derivative")

    run = bench.execute(Slopes(slopes), optimizers.make(name), BUDGET)
    assert (run.status, run.error_type, run.error) == ("failed", error.__name__, "no derivative")
    assert run.row["jacobian_evaluations"] == 1


@pytest.mark.parametrize("name", [n for n in optimizers.names() if optimizers.make(n).traits.batches])
@pytest.mark.parametrize("error", [ValueError, Mine])
def test_what_a_batch_raises_ends_the_run_with_all_its_points_counted(name, error):
    class Batched(Valley):
        sizes = ()

        def batch(self, points):
            self.sizes = (*self.sizes, len(points))
            if len(self.sizes) == 2:
                raise error("no batch")
            return np.array([self(x) for x in points])

    problem = Batched()
    run = bench.execute(problem, optimizers.make(name), BUDGET)
    assert (run.status, run.error_type, run.error) == ("failed", error.__name__, "no batch")
    assert (len(problem.sizes), run.row["batch_evaluations"]) == (2, sum(problem.sizes))


@pytest.mark.parametrize("how", [{"inner": 2}, {"time_limit": 60.0}])
def test_what_is_raised_in_another_process_ends_the_run_as_it_does_here(how):
    class Picky(Valley):
        def __call__(self, x):
            if x[0] < -1.5:
                raise self.error("too far left")
            return super().__call__(x)

    for error in (ValueError, SystemExit, Mine):
        here, there = (bench.execute(Picky(error), optimizers.make("de"), BUDGET, **more) for more in ({}, how))
        assert (there.status, there.error_type, there.error) == ("failed", error.__name__, "too far left")
        assert there.evaluations == here.evaluations < BUDGET
    with pytest.raises(KeyboardInterrupt, match="too far left"):
        bench.execute(Picky(KeyboardInterrupt), optimizers.make("de"), BUDGET, **how)


def test_an_optimiser_that_swallows_an_exception_gets_no_further_value():
    class Stubborn:
        def minimize(self, objective, rng):
            for x in rng.random((20, 2)):
                try:
                    objective(x)
                except Exception:
                    continue
            return "converged"

    problem = Valley(ZeroDivisionError, 3)
    run = bench.execute(problem, Stubborn(), BUDGET)
    assert (run.status, run.error_type, run.evaluations, problem.calls) == ("failed", "ZeroDivisionError", 3, 3)


def test_an_exception_of_a_class_that_cannot_be_sent_keeps_its_name():
    assert type(ToldError.of(type("Odd", (BaseException,), {})("x")).rebuilt()).__name__ == "Odd"


@pytest.mark.parametrize("execution", ["serial", "processes"])
def test_a_keyboard_interrupt_of_the_objective_ends_a_sweep(execution, tmp_path, monkeypatch, capsys):
    (tmp_path / f"stops_{execution}.py").write_text(
        "class Stops:\n"
        "    lower, upper, start = [-1.0], [1.0], [0.5]\n"
        "    def __call__(self, x):\n"
        "        raise KeyboardInterrupt\n"
    )
    monkeypatch.chdir(tmp_path)
    words = f"run problem=stops_{execution}.py:Stops optimizer=pygmo_ipopt budget=50 seeds=1 execution={execution}"
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 130
    assert "bench: stopped; finished runs are kept" in capsys.readouterr().err


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", SLOPES_ASKED)
def test_a_run_that_ends_by_slopes_that_are_no_numbers_has_failed(name, value):
    run = bench.execute(Slopes(lambda x: np.full((2, 2), value)), optimizers.make(name), 400)
    assert run.row["non_finite_slopes"] == 4 * run.row["jacobian_evaluations"] > 0
    assert run.stop_reason != "converged"
    if run.charged < 390:
        assert (run.status, run.error_type) == ("failed", "NonFiniteSlopes")
        assert (
            run.error
            == "it stopped by itself where its last Jacobian had 4 slopes not finite, read as 0: that is no minimum"
        )


def test_a_run_that_ends_where_its_slopes_are_numbers_is_ok_and_counts_the_others(tmp_path, monkeypatch, capsys):
    (tmp_path / "partly.py").write_text(
        "import numpy as np\n"
        "class Partly:\n"
        "    lower, upper, start = np.full(2, -2.0), np.full(2, 2.0), np.array([-1.2, 1.0])\n"
        "    def residuals(self, x):\n"
        "        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])\n"
        "    def jacobian(self, x):\n"
        "        first = np.inf if x[0] == -1.2 else -1.0\n"
        "        return np.array([[-20 * x[0], 10.0], [first, 0.0]])\n"
        "    def __call__(self, x):\n"
        "        r = self.residuals(x)\n"
        "        return float(r @ r)\n"
    )
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["run", "problem=partly.py:Partly", "optimizer=lm", "budget=400", "seeds=1"])
    assert ended.value.code == 0
    said = "1 entries of gradients and Jacobians were not finite (NaN or infinite), and read as 0: 1 of lm on "
    assert said in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["status", "results/adhoc"])
    assert said in capsys.readouterr().out
    run_id = bench.ResultStore(tmp_path / "results" / "adhoc").runs()["run_id"].iloc[0]
    with pytest.raises(SystemExit):
        main(["show", run_id])
    assert "not finite 1 entries of gradients and Jacobians, read as 0" in capsys.readouterr().out


@pytest.mark.parametrize("shape", [(3, 2), (2, 3), (4,), (2, 2, 1)])
@pytest.mark.parametrize("name", ["lm", "fmincon", "nlopt_LD_SLSQP", "pygmo_ipopt"])  # one of each library
def test_a_jacobian_of_another_shape_than_residuals_and_parameters_is_one_sentence(name, shape):
    run = bench.execute(Slopes(lambda x: np.zeros(shape)), optimizers.make(name), 400)
    assert (run.status, run.error_type, run.row["jacobian_evaluations"]) == ("failed", "ValueError", 1)
    assert run.error == f"jacobian(x) has shape {shape}; (2, 2) is needed: a row a residual, a column a parameter"
