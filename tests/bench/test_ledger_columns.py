"""Calibrated columns of the first paper: one run each, in bands that could fail."""

import numpy as np
import pytest

from calibench import bench
from calibench.bench.papers import Tolerance, judge
from calibench.bench.papers.cong2008.section3.columns import COLUMNS, PRESET, answer, row
from calibench.bench.papers.evidence import problem
from calibench.bench.papers.published import Printed
from calibench.bench.sweep.request import build_member
from tests.few import few

PRINTED = Printed("cong2008")
CELLS = [
    (key, name)
    for key in COLUMNS
    if key != "table4.j3_12"
    for name in PRINTED.column(key)
    if name not in ("kmrmse", "iterations")
]


def verdict_of(cell, ours):
    """Return the verdict that a row's own columns give to another number in place of ours."""
    band = Tolerance(
        cell.tolerance, "", cell.tolerance_in_kind, cell.tolerance_in_decades, cell.tolerance_origin
    )  # fmt: skip
    return judge(cell.printed, cell.read, ours, band)


def test_there_are_fifty_calibrated_values():
    assert len(CELLS) == 50


@pytest.mark.parametrize("key", few(4, COLUMNS))
def test_all_cells_of_a_column_are_of_one_run(key):
    run, names = answer(key), list(PRINTED.column(key))
    if key == "table4.j3_12":  # along the gauge, a search ends anywhere: only its cost is the run's
        names = ["iterations"]
    for name in names:
        cell = row(PRINTED, key, name)
        assert cell.n == 1
        assert PRESET in cell.method
        assert cell.ours_median == run.values.get(name, getattr(run, name, None))


@pytest.mark.parametrize("key", ["table2.j1_n3", "table3.j3", "table4.j3_11"])
def test_the_run_of_a_column_is_that_of_the_registered_optimiser(key):
    name, options = COLUMNS[key]
    built = problem(name, **options)
    run = bench.execute(built, build_member("optimizer", [f"optimizer={PRESET}"]), budget=20_000)
    assert run.evaluations == answer(key).evaluations
    assert run.best_value <= answer(key).J  # the gate keeps the points of differences too; fmincon answers an iterate


@pytest.mark.parametrize(("key", "name"), CELLS)
def test_a_calibrated_value_can_fail(key, name):
    cell = row(PRINTED, key, name)
    actual = PRINTED.column(f"{key.partition('.')[0]}.actual")[name]
    step = 1.0 if cell.unit == "mm" else 0.01
    assert verdict_of(cell, cell.read) != "not reproduced"
    assert verdict_of(cell, cell.read + 3 * step) == "not reproduced"
    digit = PRINTED.digit(f"{key}.{name}")
    if abs(cell.read - actual) > 1.01 * digit and cell.printed == cell.read:
        # the truth is not what a search that stopped early printed: it does not pass for it
        assert verdict_of(cell, actual) == "not reproduced"
        assert verdict_of(cell, actual + 20 * (cell.read - actual)) == "not reproduced"
        assert verdict_of(cell, actual - (cell.read - actual)) == "reproduced in kind"


def test_a_misprinted_cell_asks_which_reading_it_is():
    cell = row(PRINTED, "table3.j2", "la3")
    assert verdict_of(cell, 243.51) == "misprint, corrected"
    assert verdict_of(cell, 244.49) == "reproduced"
    assert verdict_of(cell, 244.0) == "not reproduced"


def test_a_kmrmse_is_judged_from_both_sides():
    cell = row(PRINTED, "table3.j1", "kmrmse")
    assert [verdict_of(cell, factor * cell.printed) for factor in (0.05, 0.2, 5.0, 20.0)] == [
        "not reproduced", "reproduced in kind", "reproduced in kind", "not reproduced"
    ]  # fmt: skip


def test_other_plans_are_told_beside_the_run():
    told = row(PRINTED, "table3.j1", "kmrmse").reason
    others = [answer("table3.j1", plan).kmrmse for plan in range(4)]
    assert f"{min(others):.3g} to {max(others):.3g}" in told
    assert np.ptp(others) > 0
