"""One rounding, compiled and interpreted alike."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibench.core.compilation.compiled import exact, njit
from calibench.core.compilation.lanes import fma

SIZED = st.floats(-1e60, 1e60).filter(lambda v: v == 0 or abs(v) > 1e-60)


@njit()
def fused_in_a_kernel(a, b, c):
    return fma(a, b, c)


@njit()
def first_of(x, fixed):
    return x[0] + fixed[0, 0]


@settings(deadline=None, max_examples=200)
@given(SIZED, SIZED, SIZED)
def test_a_product_and_a_sum_are_rounded_once(a, b, c):
    expected = float(Fraction(a) * Fraction(b) + Fraction(c))
    assert fma(a, b, c) == fused_in_a_kernel(a, b, c) == expected


def test_two_roundings_would_be_seen():
    a = 1.0 + 2.0**-30
    assert a * a - (1.0 + 2.0**-29) == 0.0
    assert fma(a, a, -(1.0 + 2.0**-29)) == fused_in_a_kernel(a, a, -(1.0 + 2.0**-29)) == 2.0**-60


def test_infinite_and_undefined_results_raise_nothing():
    assert fma(1e300, 1e300, 0.0) == np.inf
    assert np.isnan(fma(np.inf, 0.0, 1.0))
    assert np.isnan(fma(1.0, 1.0, np.nan))


def test_an_exact_kernel_takes_its_arrays_and_compiles_for_nothing_else():
    kernel = exact(first_of, 1, 2)
    assert not getattr(kernel, "signatures", [])  # it waits for the first call
    fixed = np.ones((1, 1))
    fixed.flags.writeable = False
    locked = np.arange(3.0)
    locked.flags.writeable = False
    assert kernel(np.arange(3.0), fixed) == kernel(locked, fixed) == 1.0
    for other in (np.arange(3), np.arange(3, dtype=np.float32), np.ones((1, 3)), [1.0], 1.0, None):
        with pytest.raises(TypeError):
            kernel(other, fixed)
    assert len(getattr(kernel, "signatures", [0])) == 1


def test_a_kernel_is_compiled_once_for_a_constant_and_for_a_number(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # of one that is kept nothing is compiled

    @njit()
    def added(x, count):
        return x + count

    @njit()
    def added_both(x, count):
        return added(x, 1) + added(x, count)

    assert added_both(0.5, 2) == 4.0
    assert len(getattr(added, "signatures", [0])) == 1
