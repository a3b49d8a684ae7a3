"""A convergence chart whose values come near the ends of what a double holds shows them up to 1e150, with labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from calibench import bench
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.study.figures import convergence
from tests.few import few


class Falling:
    """A problem whose k-th value is the k-th of a list."""

    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)

    def __init__(self, values: Sequence[float]) -> None:
        self.values, self.asked = tuple(values), 0
        self.options = {"values": list(values)}

    def __call__(self, x: np.ndarray) -> float:
        self.asked += 1
        return self.values[min(self.asked, len(self.values)) - 1]


class Asks:
    def minimize(self, objective, rng):
        while True:
            objective(objective.start)


@pytest.mark.parametrize(
    "values",
    few(3, [
        [1e299, 1e100, 1.0, 1e-9], [1e299, 1.0, 0.0], [1.7e308, 1e-320], [1e299, 1e298], [1e299, 3.0, -5.0],
        [1e299, -1e299], [1.0, 1e-290],
    ]),
)  # fmt: skip
def test_a_chart_of_very_wide_values_shows_them_up_to_a_limit_with_labels(tmp_path, values):
    run = bench.execute(Falling(values), Asks(), budget=len(values))
    figure, numbers = convergence(pd.DataFrame([dict(run.row)]), run.trace.assign(run_id=run.run_id))
    save("wide", (figure, numbers), tmp_path)
    axes = figure.axes[0]
    low, high = axes.get_ylim()
    drawn = numbers["median"][numbers["median"] != 0].clip(-1e150, 1e150)
    assert low <= max(drawn.min(), 1e-150)
    assert high >= drawn.max()
    inside = [label for label in axes.get_yticklabels() if label.get_text() and low <= label.get_position()[1] <= high]
    assert len(inside) >= 2
