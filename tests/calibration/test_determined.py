"""Which numbers of an arm are calibrated: those that the readings tell well, from the first round on."""

import numpy as np
import pytest

from calibench.calibration.determined import independent_columns, unexplained, well_determined


def _errors(columns):
    return np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))


@pytest.mark.parametrize("seed", range(20))
def test_numbers_that_are_told_badly_go_the_worst_first(seed):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((60, 12)) * 10.0 ** rng.uniform(-1, 1, 12)
    columns[:, 7] = columns[:, 3] + 0.01 * np.linalg.norm(columns[:, 3]) * rng.standard_normal(60)
    worst = 10.0 ** rng.uniform(-2, 2, 12)
    worst[0] = np.inf
    kept = list(range(12))
    while (over := 0.5 * _errors(columns[:, kept]) / worst[kept]).max() > 1:
        kept.pop(int(np.argmax(over)))
    assert well_determined(columns, 1e-3, worst, 0.5) == kept
    assert 0 in kept


def test_of_two_numbers_that_look_alike_the_better_known_stays() -> None:
    """In their order of preference the first stayed, known to 3 mm, and the second was left out, known to .01 mrad."""
    rng = np.random.default_rng(0)
    other, own = rng.standard_normal((2, 50))
    columns = np.column_stack([0.01 * own + 0.003 * other, other])
    assert independent_columns(columns, 5e-3) == [0, 1]
    assert well_determined(columns, 5e-3, np.array([2.0, 2.0])) == [1]


def test_what_columns_leave_is_as_large_as_the_noise():
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((400, 100))
    left = unexplained(columns, columns @ rng.standard_normal(100) * 1e3 + 2.0 * rng.standard_normal(400))
    assert np.std(left) == pytest.approx(2.0, rel=0.1)
