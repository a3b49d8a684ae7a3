"""The nine-point procedure: its pattern, its end, its walls, and Table 1's three experiments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.optimizers.own.nine_point import NinePoint
from calibench.problems import constants


class Bowl:
    """A quadratic that keeps every point it is asked for."""

    def __init__(self, centre: list[float], half: float = 15.0, start: list[float] | None = None) -> None:
        self.centre = np.array(centre)
        self.lower, self.upper = np.full(len(centre), -half), np.full(len(centre), half)
        self.start = np.zeros(len(centre)) if start is None else np.array(start)
        self.asked: list[np.ndarray[Any, Any]] = []

    def __call__(self, x: np.ndarray[Any, Any]) -> float:
        self.asked.append(np.array(x))
        return float(((x - self.centre) ** 2).sum())


def run(problem: Any, budget: int = 20_000, seed: int = 0, **options: Any) -> bench.Run:
    return bench.execute(problem, optimizers.make("nine_point", **options), budget=budget, seed=seed)


def test_first_round_is_the_three_by_three_grid_and_the_centre_is_not_asked_again() -> None:
    bowl = Bowl([0.0, 0.0], start=[1.0, -2.0])
    run(bowl, budget=9, step=4.0)
    grid = {(1.0 + i, -2.0 + j) for i in (-4, 0, 4) for j in (-4, 0, 4)}
    assert len(bowl.asked) == constants.column("cong2008", "section24")["estimates"]
    assert tuple(bowl.asked[0]) == (1.0, -2.0)
    assert {tuple(x) for x in bowl.asked} == grid


def test_defaults_are_those_of_the_paper() -> None:
    method = NinePoint()
    assert method.lower_limit == constants.column("cong2008", "section25")["d_lower_limit"]
    # from the centre of a bowl nothing is better, so d = 8 is halved to the first value below the limit, then it ends
    bowl = Bowl([0.0, 0.0])
    result = run(bowl)
    divisor = constants.column("cong2008", "section24")["d_divisor"]
    reach = [float(np.abs(np.array(bowl.asked[k : k + 8])).max()) for k in range(1, len(bowl.asked), 8)]
    assert reach == [method.step / divisor**k for k in range(8)]
    assert reach[-2] == method.lower_limit  # not below it, so once more (step 7)
    assert result.stop_reason == "converged"


@pytest.mark.parametrize("experiment", [1, 2, 3])
@pytest.mark.parametrize("radius", [20.0, 80.0, 120.0])
def test_table_1_starts_end_below_3e_4_rad(experiment: int, radius: float) -> None:
    result = run(problems.make("tracking_zero", experiment=experiment, radius=radius, n=20))
    assert result.stop_reason == "converged"
    assert result.row["parameter_error_rad"] < 3e-4
    assert result.evaluations < 150


@pytest.mark.parametrize("step", [2.0, 5.0, 12.0])
def test_the_step_lost_in_print_does_not_matter(step: float) -> None:
    for experiment in (1, 2, 3):
        result = run(problems.make("tracking_zero", experiment=experiment, n=20), step=step)
        assert result.row["parameter_error_rad"] < 3e-4


@pytest.mark.parametrize(
    ("pattern", "dimension"),
    [("grid", 1), ("grid", 2), ("grid", 3), ("star", 1), ("star", 2), ("star", 12), (None, 3), (None, 4), (None, 12)],
)
def test_bowls_are_found_to_half_the_last_step(pattern: str | None, dimension: int) -> None:
    centre = np.random.default_rng(dimension).uniform(-14, 14, dimension)
    result = run(Bowl(centre.tolist()), pattern=pattern)
    assert result.stop_reason == "converged"
    assert result.best_x is not None
    assert np.abs(result.best_x - centre).max() <= 0.0625 / 2 + 1e-12


def test_grid_in_many_dimensions_is_refused_with_the_way_out() -> None:
    result = run(Bowl([0.0] * 4), pattern="grid")
    assert result.status == "failed"
    assert "4 unknowns would make 80 neighbours" in result.row["error"]
    assert "take pattern=star" in result.row["error"]


@pytest.mark.parametrize("centre", [[20.0, 3.0], [-20.0, 20.0]])
def test_no_point_outside_the_box_is_visited_and_the_edge_is_reached(centre: list[float]) -> None:
    bowl = Bowl(centre, start=[1.3, -2.1])
    result = run(bowl)
    asked = np.array(bowl.asked)
    assert ((bowl.lower <= asked) & (asked <= bowl.upper)).all()
    assert result.best_x is not None
    assert np.abs(result.best_x - np.clip(centre, bowl.lower, bowl.upper)).max() < 0.125


def test_a_box_narrower_than_the_step_costs_nothing_until_the_grid_fits() -> None:
    bowl = Bowl([0.1, -0.05], half=0.2)
    result = run(bowl, lower_limit=1e-3)
    assert np.abs(bowl.asked[1]).max() == 0.125
    assert result.best_x is not None
    assert np.abs(result.best_x - bowl.centre).max() < 1e-3


def test_a_held_coordinate_stays_where_it_is() -> None:
    bowl = Bowl([3.0, 3.0])
    bowl.lower[1] = bowl.upper[1] = 0.0
    result = run(bowl)
    assert result.best_x is not None
    assert result.best_x[1] == 0.0
    assert abs(result.best_x[0] - 3.0) < 0.0625


def test_widths_of_the_box_suit_angles() -> None:
    problem = problems.make("sensor_zero")
    found = run(problem, x_scale="box", step=0.25, lower_limit=1e-4)
    assert found.stop_reason == "converged"
    assert found.row["parameter_error_rad"] < 1e-4 * 0.4
    assert run(problem).row["parameter_error_rad"] > 1e-2  # d in rad


def test_an_open_box_has_no_width() -> None:
    bowl = Bowl([3.0, -2.0], half=np.inf)
    assert run(bowl).best_value < 0.0625**2
    with pytest.raises(ValueError, match="nine_point needs finite bounds"):
        run(bowl, x_scale="box")


def test_values_that_are_not_finite_are_never_moved_to() -> None:
    bowl = Bowl([5.0, 5.0])
    value = bowl.__call__
    holed = type(
        "Holed",
        (),
        {
            "lower": bowl.lower, "upper": bowl.upper, "start": bowl.start,
            "__call__": lambda self, x: value(x) if x[0] < 3 else float("nan"),
        },
    )()  # fmt: skip
    result = run(holed)
    assert result.status == "ok"
    assert result.row["non_finite"] > 0
    assert result.best_x is not None
    assert result.best_x[0] < 3


@pytest.mark.parametrize("option", ["step", "lower_limit"])
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_lengths_must_be_above_zero(option: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"nine_point.{option}={value:g}"):
        optimizers.make("nine_point", **{option: value})
