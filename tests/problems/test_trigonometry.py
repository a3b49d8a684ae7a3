"""Our cosine and sine against exact arithmetic: within one and a half units in the last place."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from calibench.core.compilation.lanes import FAR, cos_sin, near_cos_sin

ANGLES = np.concatenate(
    [np.random.default_rng(0).uniform(-w, w, 200) for w in (1e-8, 0.1, math.pi, 100.0, FAR)]
    + [np.arange(-8, 9) * math.pi / 4]
)


def exactly(z):
    """Return cos z and sin z by their series in 60 digits, z taken off whole turns first."""
    with localcontext() as context:
        context.prec = 60
        two_pi = 2 * Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")
        z = Decimal(float(z))
        z -= two_pi * (z / two_pi).to_integral_value()
        cosine, sine, term = Decimal(0), Decimal(0), Decimal(1)
        for k in range(60):
            sign = -1 if k % 4 >= 2 else 1
            if k % 2:
                sine += sign * term
            else:
                cosine += sign * term
            term = term * z / (k + 1)
        return cosine, sine


def test_cosine_and_sine_are_within_one_and_a_half_units_in_the_last_place():
    for z in ANGLES:
        for ours, true in zip(near_cos_sin(z), exactly(z), strict=True):
            assert abs(Decimal(float(ours)) - true) <= Decimal(1.5 * float(np.spacing(abs(float(true))))), z


def test_zero_is_exact():
    assert near_cos_sin(0.0) == (1.0, 0.0)


@pytest.mark.parametrize("z", [2 * FAR, -1e12, 1e300])
def test_far_away_the_library_answers(z):
    assert cos_sin(z) == (math.cos(z), math.sin(z))


@pytest.mark.parametrize("z", [math.nan, math.inf, -math.inf])
def test_what_is_no_angle_has_no_cosine(z):
    assert all(np.isnan(value) for value in cos_sin(z))
