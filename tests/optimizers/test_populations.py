"""Laws that our own population methods share: the wall, the box, the seed, one source compiled or not."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from replay import compiled_before_and_after, stories_without_compilation, story

from calibench import bench, optimizers, problems

OWN = ("de", "pso", "ga")
# every option away from its default at least once, and renewals within a short run
VARIANTS = (
    ("de", {"population": 20}),
    ("de", {"population": 21, "F": 0.7, "CR": 0.3, "early_abandon": True}),
    ("pso", {"population": 20, "NR": 2}),
    (
        "pso",
        {
            "population": 21, "NR": 1, "random_per": "particle", "velocity_limit": 0.3, "initial_velocity": "zero",
            "border": "zero", "renewal": "worst", "renewal_forgets": False, "w_iterations": 9, "improvement": "any",
            "early_abandon": True,
        },
    ),
    ("ga", {"population": 20, "NR": 2}),
    (
        "ga",
        {
            "population": 21, "NR": 1, "mutation_per": "bit", "crossover": "parameter", "coding": "gray",
            "renewal": "worst", "rivals": "distinct", "improvement": "mean",
        },
    ),
    ("ga", {"population": 20, "NR": 2, "mutation_per": "parameter"}),
)  # fmt: skip


class Box:
    """A slope towards a corner of a box, which checks that nobody looks outside."""

    def __init__(self, lower, upper):
        self.lower, self.upper = np.array(lower, float), np.array(upper, float)
        self.start = self.lower.copy()
        self.asked = 0

    def __call__(self, x):
        return float(self.batch(x[None])[0])

    def batch(self, points):
        assert (points >= self.lower).all()
        assert (points <= self.upper).all()
        self.asked += len(points)
        return points.sum(axis=1)


@pytest.mark.slow
def test_compiled_or_not_the_same_bits():
    cases = [(name, options, 430) for name, options in VARIANTS]
    for case, plain in zip(cases, stories_without_compilation(cases), strict=True):
        assert story(*case) == plain, case


@settings(deadline=None, max_examples=25)
@given(
    lower=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4),
    width=st.sampled_from([0.0, 1e-9, 1e-4, 0.3, 7.0, 1e5]),
    variant=st.sampled_from(VARIANTS),
)
def test_box_is_never_left(lower, width, variant):
    name, options = variant
    problem = Box(lower, np.array(lower) + width)
    run = bench.execute(problem, optimizers.make(name, **options), budget=400, seed=1)
    assert run.row["status"] == "ok", run.row["error"]
    assert run.row["inside_box"]


@pytest.mark.parametrize(("name", "options"), VARIANTS)
def test_a_seed_repeats_itself_and_another_differs(name, options):
    problem = Box([-1, -1], [1, 1])
    traces = [bench.execute(problem, optimizers.make(name, **options), budget=300, seed=s).points for s in (0, 0, 1)]
    assert traces[0] == traces[1] != traces[2]


@pytest.mark.parametrize("name", OWN)
def test_minimum_budget_is_the_population(name):
    traits = optimizers.Traits(
        stochastic=True, minimum_budget=12, uses_start=False, needs_finite_bounds=True, batches=True
    )
    assert optimizers.make(name, population=12).traits == traits


@pytest.mark.parametrize(("name", "options"), VARIANTS)
def test_values_that_are_not_finite_do_not_stop_a_run(name, options):
    class Hollow(Box):
        def batch(self, points):
            return np.where(super().batch(points) > 0, np.nan, points[:, 0])

    run = bench.execute(Hollow([-1, -1], [1, 1]), optimizers.make(name, **options), budget=300, seed=0)
    assert (run.row["status"], run.row["evaluations"]) == ("ok", 300)
    assert run.row["non_finite"] > 0


def test_a_second_run_of_a_users_class_is_not_compiled_for_again(monkeypatch):
    method, begun = optimizers.make("de", F=0.123), []
    monkeypatch.setattr(type(method), "minimize", lambda *_: begun.append(1))
    method.compile(), optimizers.make("de", F=0.123).compile()
    assert begun == [1]


@pytest.mark.slow
@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
@pytest.mark.parametrize("name", OWN)
def test_nothing_is_left_to_compile_when_the_clock_starts(name):
    options = {"population": 20} if name == "de" else {"population": 20, "NR": 8}
    before, after = compiled_before_and_after((name, options, 9000))  # long enough to come to a renewal
    assert before
    assert after == before


@pytest.mark.slow
@pytest.mark.parametrize("error", ["J1", "J2", "J3"])
def test_ranking_of_section_44_holds_in_kind(error):
    problem = problems.make("full12", error=error)
    medians = {}
    for name in OWN:
        runs = [bench.execute(problem, optimizers.make(name), budget=1_000_000, seed=seed) for seed in range(5)]
        medians[name] = np.median([run.best_value for run in runs])
    assert medians["de"] < medians["pso"] < medians["ga"]
