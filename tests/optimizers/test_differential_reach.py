"""Own DE with the paper's settings reaches the rounding floor, where the paper reports a stall."""

import pytest

from calibench import bench, optimizers, problems


@pytest.mark.slow
@pytest.mark.parametrize("error", ["J2", "J3"])
@pytest.mark.parametrize("seed", range(5))
def test_de_reaches_1e18_within_2500000_evaluations(error, seed):
    run = bench.execute(
        problems.make("full12", error=error), optimizers.make("de"), budget=2_500_000, seed=seed, target=1e-18
    )
    assert run.stop_reason == "target", run.best_value
