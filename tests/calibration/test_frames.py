"""Frames of an arm from handfuls of readings: the shortest solution of each, however little it tells."""

import numpy as np
import pytest

from calibench.calibration.frames import _solved


def handfuls(seed, k=40):
    """Return coefficients (k, 24, 15) and what they want (k, 24, 1), most with a column that nearly is a mean."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(0, 1, (k, 24, 15))
    for first, apart in ((0, 1e-11), (1, 1e-7)):
        some = rows[first::3]
        some[:, :, 14] = some[:, :, :14].mean(axis=2) + rng.normal(0, apart, some.shape[:2])
    return rows, rng.normal(0, 1000, (k, 24, 1))


@pytest.mark.parametrize("seed", range(3))
def test_each_handful_is_solved_as_its_singular_values_solve_it(seed):
    rows, wanted = handfuls(seed)
    for one, of in zip(rows, wanted, strict=True):
        told = _solved(one[None], of[None])[0]
        shortest = np.linalg.lstsq(one, of, rcond=1e-9)[0]
        np.testing.assert_allclose(told, shortest, rtol=0, atol=1e-6 * np.abs(shortest).max())


def test_a_handful_that_tells_nothing_of_a_number_leaves_it_zero():
    rows, wanted = handfuls(3, 4)
    rows[2, :, 5] = 0.0
    found = _solved(rows, wanted)
    assert abs(found[2, 5, 0]) < 1e-9
    np.testing.assert_allclose(found[2], np.linalg.lstsq(rows[2], wanted[2], rcond=1e-9)[0], rtol=1e-9, atol=1e-9)
