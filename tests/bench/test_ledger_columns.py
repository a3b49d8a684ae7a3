"""Calibrated columns of the first paper: over plans and releases of fmincon, in bands that could fail."""

import numpy as np
import pytest

from calibench.bench.papers.cong2008.actual import quantity, row, searches, tolerance_of
from calibench.bench.papers.cong2008.stopping import COLUMNS, RELEASES
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Tolerance, judge, judge_share
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
def test_a_cell_is_judged_over_every_plan_and_release_alike(key):
    names = list(PRINTED.column(key))
    if key == "table4.j3_12":  # along the gauge, a search ends anywhere: only its cost is the searches'
        names = ["iterations"]
    pairs = [(release, end) for release, ends in searches(key).items() for end in ends]
    assert {release for release, _ in pairs} == {variant.release for variant in RELEASES}
    for name in names:
        cell = row(PRINTED, key, name)
        verdicts = [verdict_of(cell, quantity(end, name)) for _, end in pairs]
        within = [verdict != "not reproduced" for verdict in verdicts]
        assert cell.n == len(pairs)
        assert cell.share == pytest.approx(np.mean(within))
        assert f"{cell.share:.0%} of plans and releases" in cell.reason
        assert (cell.verdict in ("not reproduced", "depends on plan or release")) == (2 * sum(within) < len(within))
        if cell.verdict == "reproduced":
            assert 2 * verdicts.count("reproduced") >= len(verdicts)


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


@pytest.mark.parametrize(
    ("near", "verdict"),
    [(0, "not reproduced"), (1, "not reproduced"), (2, "depends on plan or release"), (9, "depends on plan or release"),
     (10, "reproduced")],
)  # fmt: skip
def test_a_print_that_some_plans_give_is_neither_reproduced_nor_refuted(near, verdict):
    band = Tolerance(0.5, "half a digit")
    ruling = judge_share(3.0, 3.0, [3.1] * near + [9.0] * (20 - near), band)
    assert (ruling.verdict, ruling.share) == (verdict, near / 20)


def test_one_plan_does_not_decide():
    """Each plan alone gives the cell another verdict; the cell has one, of all plans."""
    cell = row(PRINTED, "table3.j3", "kmrmse")
    alone = {
        judge_share(cell.printed, cell.read, [ends[number].kmrmse for ends in searches("table3.j3").values()],
                    tolerance_of(PRINTED, "table3.j3", "kmrmse")).verdict
        for number in range(15)
    }  # fmt: skip
    assert len(alone) > 1
    assert cell.verdict == "depends on plan or release"
