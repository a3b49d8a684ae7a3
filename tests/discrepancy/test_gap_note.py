"""The note on rows that are held out says what was done: by cross-validation, or not at all."""

from dataclasses import dataclass

import numpy as np
import pytest

from calibench import discrepancy
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData, Predicted
from calibench.problems.base import Parameter


@dataclass(frozen=True)
class Curve:
    """A curve of four numbers, of a machine that nobody has described."""

    name: str = "curve_of_four"

    def formulate(self, data):
        numbers = tuple(Parameter(f"b{k}", "mm", 0.0, -9.0, 9.0) for k in range(4))
        return Predicted(data, lambda q: sum(q[f"b{k}"] * q["u"] ** k for k in range(4)), numbers, {"y": 0.01}, ("u",))


@pytest.mark.parametrize(("rows", "crossed"), [(6, False), (60, True)])
def test_what_was_done_without_held_out_rows_is_told(rows: int, crossed: bool) -> None:
    """With few rows it said "by cross-validation" beside "on the fitted readings (none were held out)"."""
    u = np.linspace(-1, 1, rows)
    y = u + 0.01 * np.random.default_rng(3).standard_normal(rows)
    report = discrepancy.explain(Curve(), MeasuredData({"u": u, "y": y}, "curve_of_four", {}, "made"))
    codes = {note.code for note in report.notes}
    assert report.gap.cross_validated == crossed
    assert (Code.NOT_HELD_OUT in codes, Code.GAP_OF_FITTED in codes) == (crossed, not crossed)
