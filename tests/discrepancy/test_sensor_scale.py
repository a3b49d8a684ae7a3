"""A statement that is wrong for one kind of sensor: the scatter of the repeats is used, and nothing is made up."""

from __future__ import annotations

import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


@pytest.mark.parametrize(("key", "factor"), few(1, [("sigma_enc", 0.01), ("sigma_xy", 0.05), ("sigma_enc", 10.0)]))
def test_noise_misstated_for_one_kind_of_sensor_names_nothing_and_is_told(key: str, factor: float) -> None:
    blind = case(50_101, kind="none", xy=True, noise="gauss")
    stated = {**blind.metadata, key: factor * blind.metadata[key]}
    report = explain("gpm2002", MeasuredData(blind.columns, "gpm2002", stated, "case"))
    assert report.verdict == "none"
    assert any("scatter otherwise than the stated noise" in note.text for note in report.notes)


def test_noise_as_stated_is_left_alone() -> None:
    blind = case(50_101, kind="none", xy=True, noise="gauss")
    report = explain("gpm2002", MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))
    assert not any("scatter" in note.text for note in report.notes)
