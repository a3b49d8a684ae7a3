"""Why runs end is said by the words of one list, and the page of the columns knows all of them."""

import re
from pathlib import Path

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.gate.endings import BY_GATE, STOP_REASONS

PAGE = Path(__file__).parents[2] / "docs" / "results.md"


class Fails:
    lower, upper, start = np.zeros(2), np.ones(2), np.full(2, 0.5)

    def __call__(self, x):
        raise OSError("the disk is full")


def ended(problem=None, name="nlopt_LN_BOBYQA", **limits):
    problem = problem or problems.make("sensor_zero", n=3)
    return bench.execute(problem, optimizers.make(name), seed=0, **limits).stop_reason


@pytest.mark.parametrize(
    ("reason", "run"),
    [
        ("converged", lambda: ended(budget=5000)),
        ("budget", lambda: ended(name="de", budget=100)),
        ("target", lambda: ended(name="de", budget=5000, target=1e9)),
        ("failed", lambda: ended(Fails(), budget=100)),
    ],
)
def test_what_ends_a_run_is_in_the_list(reason, run):
    assert run() == reason
    assert reason in STOP_REASONS


def test_what_the_gate_ends_is_a_part_of_the_list():
    assert set(BY_GATE) < set(STOP_REASONS)


def test_the_page_of_the_columns_tells_every_reason():
    [listed] = re.findall(r"`stop_reason` \(([^)]*)\)", PAGE.read_text())
    assert tuple(listed.replace("\n", " ").split(", ")) == STOP_REASONS
