"""A generation asked for at once is the generation asked for one by one."""

from dataclasses import replace

import pytest

from calibench import bench, optimizers, problems


@pytest.mark.parametrize("name", ["pygmo_pso_gen", "pygmo_cmaes", "pygmo_gaco"])
def test_a_generation_at_once_changes_no_bit_of_the_run(name):
    pytest.importorskip("pygmo")
    problem, method = problems.make("sensor_zero"), optimizers.make(name)
    assert method.batches
    at_once, singly = (
        bench.execute(problem, m, budget=1230, seed=3, optimizer_name=name)
        for m in (method, replace(method, batches=False))
    )
    assert at_once.points == singly.points
    assert at_once.best_x.tolist() == singly.best_x.tolist()
    assert at_once.evaluations == singly.evaluations == 1230
    assert at_once.stop_reason == "budget"
