"""Parameters known only together are told as such, with what is known of them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.orthoglide import case, unequal
from calibench.discrepancy import MeasuredData, machines
from calibench.discrepancy.machines.orthoglide.formulation import planned
from calibench.discrepancy.validation import folds
from tests.discrepancy.orthoglide_score import explained
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


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
