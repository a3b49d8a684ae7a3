"""A play or a compliance that comes out negative: a note says that its column, or its name, is not right."""

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData, explain
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


@pytest.mark.parametrize(
    ("family", "column", "what"), [("backlash", "dir_{}", "play"), ("compliance", "tau_{}", "compliance")]
)
@pytest.mark.parametrize("turned", few(1, [True, False]))
def test_a_column_of_the_other_sign_is_told(family: str, column: str, what: str, turned: bool) -> None:
    blind = case(730000, kind="one", family=family, lam=2.0)
    columns = dict(blind.columns)
    if turned:
        columns |= {name: -np.asarray(columns[name]) for name in (column.format(i) for i in (1, 2, 3))}
    report = explain("gpm2002", MeasuredData(columns, "gpm2002", blind.metadata, "case"))
    [finding] = report.findings
    assert finding.family == family
    told = [note for note in report.notes if note.code is Code.NEGATIVE_SIZE]
    assert len(told) == turned
    if turned:
        assert f"is negative, and a {what} never is: either" in told[0].text
        assert told[0].values["effect"] == finding.effect
