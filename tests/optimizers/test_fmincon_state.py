"""A search of `fmincon` on its way: what it notes of its steps, and which test ends it first."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pytest

from calibench.optimizers.fmincon.constraints import Frame, Iterate, Scales, region
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.search import PATIENCE, STUCK, Finished, Seen, Walk, met_at

NONE, NO_ROWS = np.zeros(0), np.zeros((0, 2))


def iterate(x: list[float], value: float, violation: float = 0.0, first_order: float = 1.0) -> Iterate:
    zero = np.zeros(2)
    return Iterate(np.array(x), value, zero, NO_ROWS, NO_ROWS, violation, first_order, NONE, NONE, zero, zero)


class Told:
    """A function with a slope of 1 everywhere, whose values are 5 but for those that were said."""

    count = 0

    def __init__(self, **values: float) -> None:
        self.values = values

    def value(self, x: Any) -> float:
        return self.values.get(f"at_{x[0]:g}", 5.0)

    def gradient(self, x: Any, steps: Any = None) -> Any:
        return np.ones(2)


def begun(**values: float) -> Walk:
    start, open_plane = np.zeros(2), region(2)
    frame, options = Frame.of(open_plane, start, True), Options(StepTolerance=0.0).filled(2)
    asked: Any = Told(**values)
    walk = Walk(asked, open_plane, options, frame, Scales(1.0, NONE, NONE), Seen(start, 5.0, True))
    walk.arrive(start)
    return walk


def test_a_step_length_is_the_part_of_the_first_point_tried() -> None:
    walk, half = begun(), np.array([3.0, 4.0])
    for x in (np.zeros(2), np.array([6.0, 8.0]), half):  # the last iterate is no trial
        walk.value(x)
    walk.arrive(half)
    assert (walk.step, walk.step_length) == (5.0, 0.5)


@pytest.mark.parametrize(("values", "more"), [({}, 0), ({"at_4": 4.0}, 4), ({"at_4": 6.0}, 0)])
def test_ten_iterates_without_progress_are_stuck(values: dict[str, float], more: int) -> None:
    walk = begun(**values)
    with pytest.raises(Finished) as end:
        deque(map(walk.arrive, np.array([(k, 0.0) for k in range(1, 100)])))
    assert (end.value.flag, end.value.message) == (2, STUCK)
    assert len(walk.path) == 1 + PATIENCE + more


def test_the_best_is_feasible_where_any_is() -> None:
    walk = begun()
    walk.path.append(iterate([1.0, 0.0], -9.0, violation=1.0))
    assert walk.best() is walk.path[0]
    assert walk.answer is walk.path[1]


def test_optimality_is_tested_before_the_number_of_iterates() -> None:
    options = Options(MaxIterations=0, OptimalityTolerance=1e-6).filled(2)
    flags = []
    for first_order in (1e-7, 1.0):
        end = met_at(iterate([0.0, 0.0], 5.0, first_order=first_order), None, None, 0, False, options)
        assert end is not None
        flags.append(end.flag)
    assert flags == [1, 0]
