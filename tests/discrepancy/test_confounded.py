"""Parameters known only together are told as such, with what is known of them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.orthoglide import case, unequal
from calibench.discrepancy import MeasuredData, machines
from calibench.discrepancy.fitting.rank import confounded
from calibench.discrepancy.machines.orthoglide.formulation import planned
from calibench.discrepancy.validation import folds
from tests.discrepancy.orthoglide_score import explained
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


def test_two_columns_alike_are_known_by_their_difference_only() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 200))
    (pair,) = confounded(("one", "two", "three"), np.column_stack([a, -a + 1e-3 * b, b]), 0.01)
    assert (pair.first, pair.second, pair.factor) == ("one", "two", 1.0)
    J = np.column_stack([a, -a + 1e-3 * b, b])
    C = np.linalg.inv(J.T @ J) * 1e-4
    assert pair.sd == pytest.approx(np.sqrt(np.diag(C))[:2])
    assert pair.known == pytest.approx(np.sqrt(np.array([1, -1, 0]) @ C @ [1, -1, 0]))
    assert "one - two ±" in str(pair)


def test_a_factor_and_a_sum_are_written_out() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.standard_normal((2, 200))
    (pair,) = confounded(("one", "two"), np.column_stack([2 * a, a + 1e-4 * b]), 0.01)
    assert pair.factor == pytest.approx(-0.5, abs=1e-3)
    assert "one + 0.5 two" in str(pair)
    assert confounded(("one", "two"), np.column_stack([a, b]), 0.01) == ()


@pytest.mark.parametrize("free", few(1, ["full", "rho", pytest.param("L", marks=pytest.mark.slow)]))
def test_the_report_says_that_the_papers_plan_cannot_part_lengths_and_offsets(free: str) -> None:
    report = explained(unequal(2, free))
    (note,) = [note for note in report.notes if "not identifiable" in note.text]
    assert all(f"drho_{axis} - dL_{axis} ± 0.011" in note.text and f"dL_{axis} ± 0.42" in note.text for axis in "xyz")
    assert ("held" in note.text) == (free != "full")


def test_the_chapters_twelve_readings_give_its_standard_errors() -> None:
    data = machines.make("orthoglide").formulate(planned("paper")).data
    (note,) = [note for note in data.notes if "not identifiable" in note.text]
    assert "drho_x ± 0.73" in note.text
    assert "drho_x - dL_x ± 0.019" in note.text


def test_moves_across_the_legs_part_them() -> None:
    hidden = case(0, plan="cross")
    data = machines.make("orthoglide").formulate(MeasuredData(hidden.columns, "orthoglide", hidden.metadata, "c")).data
    assert not any("not identifiable" in note.text for note in data.notes)


def test_readings_that_share_a_zero_are_not_parted_by_cross_validation() -> None:
    hidden = case(0, plan="paper")
    data = machines.make("orthoglide").formulate(MeasuredData(hidden.columns, "orthoglide", hidden.metadata, "p")).data
    fold = folds(data, 5)
    for gauge in np.unique(data["shared_id"]):
        assert len(np.unique(fold[data["shared_id"] == gauge])) == 1
    assert len(np.unique(data["shared_id"])) == 6
    assert len(np.unique(fold)) == 5
