"""The note on rows that are held out says what was done: by cross-validation, or not at all."""

from dataclasses import dataclass

import numpy as np
import pytest

from calibench import discrepancy
from calibench.discrepancy import MeasuredData, Predicted
from calibench.discrepancy.checks.validate import CROSSED, NOT_CROSSED
from calibench.problems.base import Parameter


@dataclass(frozen=True)
class Curve:
    """A curve of four numbers, of a machine that nobody has described."""

    name: str = "curve_of_four"

    def formulate(self, data):
        numbers = tuple(Parameter(f"b{k}", "mm", 0.0, -9.0, 9.0) for k in range(4))
        return Predicted(data, lambda q: sum(q[f"b{k}"] * q["u"] ** k for k in range(4)), numbers, {"y": 0.01}, ("u",))


@pytest.mark.parametrize(("rows", "note", "other"), [(6, NOT_CROSSED, CROSSED), (60, CROSSED, NOT_CROSSED)])
def test_what_was_done_without_held_out_rows_is_told(rows: int, note: str, other: str) -> None:
    """With few rows it said "by cross-validation" beside "on the fitted readings (none were held out)"."""
    u = np.linspace(-1, 1, rows)
    y = u + 0.01 * np.random.default_rng(3).standard_normal(rows)
    report = discrepancy.explain(Curve(), MeasuredData({"u": u, "y": y}, "curve_of_four", {}, "made"))
    assert report.gap.cross_validated == (note is CROSSED)
    assert note in report.notes
    assert other not in report.notes
