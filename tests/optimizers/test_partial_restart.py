"""The partial restart's order is that of NumPy's stable sort."""

import numpy as np
import pytest

from calibench.optimizers.own._random_kernels import from_the_worst


@pytest.mark.parametrize("size", [0, 1, 2, 3, 7, 8, 31, 200])
def test_the_worst_come_first_equal_ones_in_their_order_and_no_number_last(size):
    rng = np.random.default_rng(size)
    for few in (2, 5, 1000):  # many ties, some, hardly any
        values = rng.integers(few, size=size).astype(float)
        values[rng.random(size) < 0.1] = np.inf
        values[rng.random(size) < 0.1] = np.nan
        assert from_the_worst(values).tolist() == np.argsort(-values, kind="stable").tolist()
