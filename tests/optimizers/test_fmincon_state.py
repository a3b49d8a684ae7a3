"""The state of a search of `fmincon` is a value: a transition returns the next one and leaves its own as it was."""

from __future__ import annotations

import numpy as np

from calibench.optimizers.fmincon.constraints import Frame, Iterate, Scales, region
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.search import PATIENCE, Seen, State, met_at

NONE, NO_ROWS = np.zeros(0), np.zeros((0, 2))


def iterate(x: list[float], value: float, violation: float = 0.0, first_order: float = 1.0) -> Iterate:
    zero = np.zeros(2)
    return Iterate(np.array(x), value, zero, NO_ROWS, NO_ROWS, violation, first_order, NONE, NONE, zero, zero)


def begun() -> State:
    start = np.array([0.0, 0.0])
    frame = Frame.of(region(2), start, True)
    state = State(frame, Scales(1.0, NONE, NONE), Seen(start, 5.0, True))
    return state.arrived(iterate([0.0, 0.0], 5.0), 1e-6)


def test_a_step_length_is_the_part_of_the_first_point_tried() -> None:
    half = np.array([3.0, 4.0])
    state = begun().tried(np.array([6.0, 8.0])).tried(half).stepped(half)
    assert (state.step, state.step_length) == (5.0, 0.5)


def test_the_last_iterate_is_no_trial() -> None:
    state = begun()
    assert state.tried(np.zeros(2)) is state


def test_ten_iterates_without_progress_in_any_measure_are_stuck() -> None:
    for better in ({"value": 4.0}, {"value": 6.0, "first_order": 0.5}):
        state = begun()
        for _ in range(9):
            state = state.arrived(iterate([1.0, 0.0], 5.0), 1e-6)
        assert state.idle == PATIENCE - 1
        assert state.arrived(iterate([1.0, 0.0], 5.0), 1e-6).idle == PATIENCE
        assert state.arrived(iterate([1.0, 0.0], **better), 1e-6).idle == 0


def test_the_best_is_feasible_where_any_is() -> None:
    state = begun().arrived(iterate([1.0, 0.0], -9.0, violation=1.0), 1e-6)
    assert state.best(1e-6) is state.path[0]
    assert state.answer is state.path[1]


def test_optimality_is_tested_before_the_number_of_iterates() -> None:
    options = Options(MaxIterations=0, OptimalityTolerance=1e-6).filled(2)
    flags = []
    for first_order in (1e-7, 1.0):
        end = met_at(iterate([0.0, 0.0], 5.0, first_order=first_order), None, None, 0, False, options)
        assert end is not None
        flags.append(end.flag)
    assert flags == [1, 0]
