"""Names from few equations, with a noise that nobody stated, carry a note that stands before the verdict."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import FIRST
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.machines.arm import Arm
from tests.bench.arm_by_hand import NAMES, measured, placed, urdf
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


def played(count, **metadata):
    """Return readings of an arm whose joint 2 has play, far above the noise."""
    q, seen, _ = measured(count)
    came = np.sign(np.diff(q, axis=0, prepend=q[:1]))
    stood = q - 2e-3 * came * [0, 1, 0, 0, 0, 0]
    seen = seen + placed(stood)[0] - placed(q)[0]
    columns = dict(zip(NAMES, q.T, strict=True)) | dict(zip("xyz", seen.T, strict=True))
    return MeasuredData(columns, "arm", metadata)


@pytest.mark.parametrize(
    ("count", "stated", "told"), few(1, [(32, {}, True), (60, {}, False), (32, {"sigma_mm": 0.03}, False)])
)
def test_a_note_stands_before_names_from_few_equations(count, stated, told, tmp_path):
    file = tmp_path / "my.urdf"
    file.write_text(urdf())
    report = discrepancy.explain(Arm(str(file)), played(count, **stated))
    assert report.findings
    notes = [note for note in report.notes if note.code is Code.FEW_EQUATIONS]
    assert len(notes) == told
    assert Code.FEW_EQUATIONS in FIRST
    if told:
        assert notes[0].values["equations"] == 3 * 31  # the first row, of unknown direction, is left out
