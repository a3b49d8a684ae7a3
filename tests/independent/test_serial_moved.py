"""An arm whose base was moved and turned: one finding; a pose kept back at that very time is on neither side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.machines.arm import Arm
from tests.independent.serial import MAKES
from tests.independent.test_serial import seen

pytestmark = pytest.mark.usefixtures("at_one_noise")

TURN, WAY = np.array([5e-4, 3e-4, 4e-4]), np.array([0.4, -0.3, 0.2])  # rad, mm


# row 64 is kept back: fitted rows do not tell which of the two it was
@pytest.mark.parametrize("moved_at", [64, pytest.param(65, marks=pytest.mark.slow)])
def test_a_base_that_was_moved_and_turned_is_one_finding(tmp_path: Path, moved_at: int) -> None:
    columns, _, _ = seen(120)
    (tmp_path / "arm.urdf").write_text(MAKES["six"].urdf())
    places = np.stack([columns[name] for name in "xyz"], axis=-1)
    middle = places.mean(axis=0)
    moved = np.arange(120) >= moved_at
    places = places + moved[:, None] * (WAY + np.cross(TURN, places - middle))
    columns |= {name: places[:, k] for k, name in enumerate("xyz")}
    columns |= {"split": np.where(np.arange(120) % 5 == 4, "hold", "train"), "t_s": 10.0 * np.arange(120)}
    report = explain(Arm(str(tmp_path / "arm.urdf")), MeasuredData(columns, "arm", {"sigma_mm": 0.02}))
    assert [finding.effect for finding in report.findings] == ["base_shift base"]
    assert report.verdict == "named"
    *sizes, begins = report.findings[0].coefficients
    assert len(sizes) == 6
    assert (begins.name, begins.unit) == ("from", "s")
    assert 630 < begins.value <= 650  # the times of the fitted rows on both sides
