"""Which numbers of an arm are calibrated: those that the readings tell well, from the first round on."""

import numpy as np
import pytest

from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.fit import determined, order_of
from calibench.bench.calibration.model import model_of
from calibench.bench.calibration.readings import read_readings
from calibench.bench.calibration.start import started
from calibench.problems.arm.chains.urdf import read_urdf
from calibench.problems.arm.gauge import told_apart, unexplained
from tests.bench.arm_by_hand import measured, table, urdf


def _kept_plainly(columns, distinct, worst, noise):
    """Return what `told_apart` should, each time with a QR decomposition of its own."""
    kept = []
    for k, column in enumerate(columns.T):
        left = column - columns[:, kept] @ np.linalg.lstsq(columns[:, kept], column, rcond=None)[0] if kept else column
        if np.linalg.norm(left) > distinct * np.linalg.norm(column):
            R = np.linalg.qr(columns[:, [*kept, k]], mode="r")
            errors = noise * np.linalg.norm(np.linalg.inv(R), axis=1)
            kept += [k] if (errors <= worst[[*kept, k]]).all() else []
    return kept


@pytest.mark.parametrize("seed", range(20))
def test_a_number_is_kept_if_it_and_those_before_it_are_told_well(seed):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((60, 12)) * 10.0 ** rng.uniform(-2, 2, 12)
    columns[:, 7] = columns[:, 3] + 1e-3 * columns[:, 7]
    worst = 10.0 ** rng.uniform(-3, 2, 12)
    found = told_apart(columns, 5e-3, worst, 0.1)
    assert found == _kept_plainly(columns, 5e-3, worst, 0.1)
    assert 0 < len(found) < len(told_apart(columns, 5e-3))


def test_what_columns_leave_is_as_large_as_the_noise():
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((400, 100))
    left = unexplained(columns, columns @ rng.standard_normal(100) * 1e3 + 2.0 * rng.standard_normal(400))
    assert np.std(left) == pytest.approx(2.0, rel=0.1)


def test_the_first_round_frees_what_its_readings_tell(tmp_path):
    """The residuals there are those of an arm that errs by mm; the noise is what all numbers together leave of them."""

    def kept(noise):
        q, seen, _ = measured(30, noise=noise)
        (tmp_path / "p.csv").write_text(table(q, seen))
        units = dict.fromkeys("xyz", "mm")
        start = started(read_readings(read_table(str(tmp_path / "p.csv"), units), chain), chain)
        model = model_of(chain, start.readings, start.base, start.tool, 50.0)
        order, weights = order_of(model.names, "geometry"), np.ones(len(model.joints))
        return {model.names[k] for k in determined(model, model.start, order, weights, first=True)}

    (tmp_path / "my.urdf").write_text(urdf())
    chain = read_urdf(tmp_path / "my.urdf").chain(tip="ball")
    assert kept(0.03) > kept(2.0)
