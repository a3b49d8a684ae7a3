"""One run, whatever happens, is one row; the same names give the same row, to the last bit."""

import random

import numpy as np
import pytest

from calibench import bench, optimizers, problems

NOT_REPEATABLE = {"wall_s", "cpu_s", "git_commit", "git_dirty", "versions", "platform", "started_at"}


class Bowl:
    """The least a problem needs."""

    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

    def __call__(self, x):
        return float(((x - 0.1) ** 2).sum())


class Wanderer:
    """The least an optimiser needs."""

    def minimize(self, objective, rng):
        while True:
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))


def repeatable(run):
    return {key: value for key, value in run.row.items() if key not in NOT_REPEATABLE}


def test_any_object_with_a_box_a_start_and_a_call_runs():
    run = bench.execute(Bowl(), optimizers.make("de"), budget=3_000)
    assert (run.status, run.stop_reason, run.evaluations, run.charged) == ("ok", "budget", 3_000, 3_000)
    assert run.best_value < 1e-3
    assert list(run.trace.columns) == ["evaluations", "charged", "best_value", "restart"]
    assert run.trace["best_value"].iloc[-1] == run.best_value


def test_any_object_that_minimizes_is_an_optimiser():
    run = bench.execute(Bowl(), Wanderer(), budget=40)
    assert (run.status, run.evaluations, run.row["optimizer"].endswith(":Wanderer")) == ("ok", 40, True)


@pytest.mark.parametrize("name", ["de", "lm", "trf", "nlopt_LN_BOBYQA", "nlopt_LD_SLSQP", "pygmo_de", "pygmo_cmaes"])
def test_the_same_names_give_the_same_row(name):
    def once():
        return bench.execute(problems.make("link_length"), optimizers.make(name), budget=700, seed=3, start="random")

    a, b = once(), once()
    assert repeatable(a) == repeatable(b)
    assert a.points == b.points


class Careless:
    """Draws from the generators that all of a process share, and not from the one that it is given."""

    def minimize(self, objective, rng):
        while True:
            share = np.random.rand(objective.dimension) * random.random()  # noqa: NPY002
            objective(objective.lower + share * (objective.upper - objective.lower))


@pytest.mark.parametrize("time_limit", [None, 60.0])
def test_an_optimiser_that_draws_from_the_shared_generators_repeats_itself_and_leaves_them_as_they_were(time_limit):
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    before = random.getstate(), np.random.get_state()[1].tolist()  # noqa: NPY002

    def once(seed):
        return bench.execute(Bowl(), Careless(), budget=50, seed=seed, time_limit=time_limit)

    a, b, other = once(0), once(0), once(1)
    assert a.points == b.points
    assert a.points != other.points
    assert (random.getstate(), np.random.get_state()[1].tolist()) == before  # noqa: NPY002


def test_another_repetition_or_name_gives_another_seed():
    p = problems.make("full12")
    values = {
        bench.execute(p, optimizers.make(name, **options), budget=300, seed=seed).best_value
        for name, options in (("de", {}), ("de", {"F": 0.6}), ("pygmo_de", {}))
        for seed in (0, 1)
    }
    assert len(values) == 6


def test_a_default_written_out_is_the_same_run():
    a = bench.execute(problems.make("full12"), optimizers.make("de"), budget=200)
    b = bench.execute(problems.make("full12", error="J2", n=50), optimizers.make("de", population=150), budget=200)
    assert a.run_id == b.run_id
    assert a.best_value == b.best_value


def test_the_random_start_is_shared_by_all_optimisers():
    p = problems.make("full12")
    first = {
        bench.execute(p, optimizers.make(name), budget=1, seed=4, start="random").best_value
        for name in ("lm", "trf", "dogbox")
    }
    assert len(first) == 1
    other = bench.execute(p, optimizers.make("lm"), budget=1, seed=5, start="random").best_value
    assert other not in first


def test_an_exception_is_a_failed_row_with_its_text():
    class Broken(Bowl):
        def __call__(self, x):
            raise RuntimeError("the encoder fell off")

    for name in ("de", "nlopt_LN_BOBYQA", "nlopt_LD_SLSQP", "pygmo_cmaes"):
        run = bench.execute(Broken(), optimizers.make(name), budget=50)
        assert (run.status, run.stop_reason, run.row["error_type"]) == ("failed", "failed", "RuntimeError")
        assert run.row["error"] == "the encoder fell off"


def test_a_problem_without_a_finite_value_is_a_failure():
    class Nowhere(Bowl):
        def __call__(self, x):
            return float("nan")

    run = bench.execute(Nowhere(), optimizers.make("de"), budget=400)
    assert (run.status, run.best_x, run.row["non_finite"], run.evaluations) == ("failed", None, 400, 400)
    assert (run.stop_reason, run.row["error_type"]) == ("failed", "NoFiniteValue")
    assert run.row["error"] == "none of 400 values was finite"


def test_an_optimiser_that_asks_for_nothing_is_a_failure():
    class Idle:
        def minimize(self, objective, rng):
            return "converged"

    run = bench.execute(Bowl(), Idle(), budget=40)
    assert (run.status, run.stop_reason, run.evaluations) == ("failed", "failed", 0)
    assert (run.row["error_type"], run.row["error"]) == ("NoEvaluation", "the optimizer made no evaluation")


def test_an_answer_outside_the_box_is_called_so():
    p = problems.make("full12")
    run = bench.execute(p, optimizers.make("lm"), budget=5000, seed=0, start="random")
    assert run.best_value < 1e-18
    inside = bool(((p.lower <= run.best_x) & (run.best_x <= p.upper)).all())
    assert run.row["inside_box"] is inside is False


def test_rows_carry_physical_parameters_for_j3():
    p = problems.make("full12", error="J3")
    run = bench.execute(p, optimizers.make("trf"), budget=5000, start="random")
    assert run.row["parameter_names"] == [q.name for q in p.parameters]
    assert run.row["parameter_values"] == pytest.approx(p.physical(run.best_x).tolist())
    assert run.row["kmrmse_aligned"] < 1e-9 < run.row["kmrmse"]


def test_restarts_spend_the_budget_and_are_counted():
    run = bench.execute(problems.make("sensor_zero"), optimizers.make("trf", restarts=True), budget=1000)
    assert run.charged > 1000 - 4
    assert run.row["restarts"] > 3
    assert run.trace["restart"].max() == run.row["restarts"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"budget": 0}, "budget=0"),
        ({"budget": -3}, "budget=-3"),
        ({"budget": 1.5}, "budget=1.5"),
        ({"budget": True}, "budget=True"),
        ({"seed": -1}, "seed=-1"),
        ({"target": float("nan")}, "target=nan"),
        ({"start": "elsewhere"}, "start=elsewhere"),
        ({"start": np.full(2, 3.0)}, "outside its box"),
        ({"start": np.zeros(3)}, "start has shape"),
        ({"optimizer": "de"}, "no minimize"),
        ({"optimizer": optimizers.make("lm")}, "needs residuals"),
        ({"problem": object()}, "has no lower, upper, start"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_a_line(change, message):
    request = {"problem": Bowl(), "optimizer": optimizers.make("de"), "budget": 10} | change
    with pytest.raises(ValueError, match=message) as caught:
        bench.execute(**request)
    assert "\n" not in str(caught.value)


def test_a_problem_whose_start_lies_outside_is_refused():
    class Outside(Bowl):
        start = np.array([0.0, 2.0])

    with pytest.raises(ValueError, match=r"start\[1\]=2"):
        bench.execute(Outside(), optimizers.make("de"), budget=10)
