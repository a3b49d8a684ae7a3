"""Time of an evaluation, and of the gate around it: `make bench`."""

import numpy as np
import pytest

import optimizers
import problems
from bench.evaluator import Evaluator

_ENDLESS = 10**12


@pytest.fixture(params=["J1", "J2", "J3"])
def problem(request):
    p = problems.make("full12", error=request.param)
    p.compile()
    return p


@pytest.mark.benchmark(group="one candidate, n=50")
@pytest.mark.parametrize("through", ["bare", "gate"])
def bench_scalar(benchmark, problem, through):
    benchmark(problem if through == "bare" else Evaluator(problem, _ENDLESS), problem.start)


@pytest.mark.benchmark(group="150 candidates, n=50")
@pytest.mark.parametrize("through", ["bare", "gate"])
def bench_batch(benchmark, problem, through):
    points = problem.lower + np.random.default_rng(0).random((150, 12)) * (problem.upper - problem.lower)
    benchmark(problem.batch if through == "bare" else Evaluator(problem, _ENDLESS).batch, points)


@pytest.mark.benchmark(group="residuals and Jacobian, n=50")
@pytest.mark.parametrize("what", ["residuals", "jacobian"])
def bench_derivatives(benchmark, problem, what):
    benchmark(getattr(problem, what), problem.start)


@pytest.mark.benchmark(group="20 000 evaluations of full12 J3")
@pytest.mark.parametrize("name", ["de", "pygmo_de", "pygmo_cmaes", "nlopt_LN_BOBYQA"])
def bench_optimiser(benchmark, name):
    import bench

    p, optimizer = problems.make("full12", error="J3"), optimizers.make(name)
    benchmark.pedantic(bench.execute, args=(p, optimizer, 20_000), rounds=5, warmup_rounds=1)
