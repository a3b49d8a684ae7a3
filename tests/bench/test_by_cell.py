"""Numbers of all cells at once are those of each cell alone; what a page costs grows with no slice of each cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.report.study import figures, page
from calibench.bench.report.study.page import StudyPage
from calibench.bench.statistics import tables
from calibench.bench.statistics.cells import CELL, by_number
from calibench.bench.store.arrays import TRACES_SCHEMA

pytestmark = pytest.mark.usefixtures("one_process")


def _values(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return cell numbers and values of many magnitudes, some of them ties, infinite or missing."""
    rng = np.random.default_rng(seed)
    cell = np.concatenate([np.arange(40), rng.integers(0, 40, 160)])
    values = rng.choice([1.0, 1e-30, 3e7, np.nan, np.inf, -2.5], 200) * rng.choice([1.0, rng.random(), 1 / 3], 200)
    return cell, values


@pytest.mark.parametrize("seed", range(5))
def test_statistics_of_all_cells_are_those_of_each_alone_to_the_last_bit(seed: int) -> None:
    cell, values = _values(seed)
    cells = by_number(cell)
    medians, least = cells.medians(values), cells.over(np.fmin, values)
    for i in range(40):
        mine = pd.Series(values[cell == i])
        np.testing.assert_array_equal(medians[i], mine.median())
        np.testing.assert_array_equal(least[i], mine.min())
        assert cells.rows(i).tolist() == np.flatnonzero(cell == i).tolist()


def test_first_and_last_rows_of_a_cell_are_as_they_stood() -> None:
    cells = by_number(np.array([1, 0, 1, 0, 2]))
    assert cells.first.tolist() == [1, 0, 4]
    assert cells.last.tolist() == [3, 2, 4]
    assert cells.number.tolist() == [1, 0, 1, 0, 2]


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    return pd.DataFrame(
        [
            bench.execute(problems.make("link_length", error=error), optimizers.make(method), budget=60, seed=seed).row
            for error in ("J1", "J2")
            for method in ("lm", "de", "pso")
            for seed in range(2)
        ]
    )


def test_no_problem_is_built_for_the_table_of_calibrated_values(
    runs: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(problems, "make", None)
    assert len(tables.calibrated(runs)[CELL].drop_duplicates()) == 6


def test_more_cells_than_a_drawing_has_room_for_are_left_to_the_table(
    runs: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "_FIELD", 1)
    traces = TRACES_SCHEMA.empty_table().to_pandas()
    assert "overview" in [name for name, _ in figures.drawable(runs, traces, ())]
    one = runs[runs["problem_options"] == runs["problem_options"].iloc[0]]
    assert "overview" not in [name for name, _ in figures.drawable(one, traces, ())]  # one column is a table
    monkeypatch.setattr(figures, "_SEEN", 5)
    assert "overview" not in [name for name, _ in figures.drawable(runs, traces, ())]


def test_a_page_that_grows_too_large_links_drawings_in_place_of_holding_them(
    runs: pd.DataFrame, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawing = tmp_path / "figures" / "convergence_link_length.svg"
    drawing.parent.mkdir()
    drawing.write_text('<svg xmlns="http://www.w3.org/2000/svg" width="90pt" height="9pt"></svg>' + " " * 40_000)
    made = StudyPage(folder=tmp_path, runs=runs, drawings=lambda: {"convergence_link_length": [drawing]})
    address = "figures/convergence_link_length.svg"
    whole = made.html()
    assert address not in whole
    monkeypatch.setattr(page, "_ROOM", 60_000)
    monkeypatch.setattr(page, "_LARGEST", len(whole) - 35_000)
    small = made.html()
    assert address in small
    assert len(small) <= len(whole) - 35_000
