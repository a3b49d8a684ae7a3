"""Gauss-Newton on functions on which full steps climb, from More, Garbow and Hillstrom (1981), with their minima."""

import numpy as np
import pytest

from calibench.problems.fitting import gauss_newton

MEYER = np.array(
    [34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744, 8261, 7030, 6005, 5147, 4427, 3820, 3307, 2872.0]
)


def meyer(x):
    return x[0] * np.exp(x[1] / (45 + 5 * np.arange(1, 17) + x[2])) - MEYER


def brown_and_dennis(x):
    t = np.arange(1, 21) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2


def freudenstein_and_roth(x):
    return np.array([-13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((x[1] + 1) * x[1] - 14) * x[1]])


def slopes(residuals):
    def jacobian(x):
        h = 1e-6 * (1 + np.abs(x))
        return np.stack([(residuals(x + h * e) - residuals(x - h * e)) / (2 * h @ e) for e in np.eye(len(x))], axis=1)

    return jacobian


@pytest.mark.parametrize(
    ("residuals", "start", "least"),
    [
        (meyer, [0.02, 4000.0, 250.0], 87.9458),
        (brown_and_dennis, [25.0, 5.0, -5.0, -1.0], 85822.2),
        (freudenstein_and_roth, [0.5, -2.0], 48.9842),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_it_ends_in_the_minimum_where_full_steps_climb(residuals, start, least):
    x = gauss_newton(residuals, slopes(residuals), np.array(start))
    assert np.sum(residuals(x) ** 2) == pytest.approx(least, rel=1e-5)


def test_a_place_without_a_value_is_far_too_high():
    def residuals(x):
        return np.array([np.log(x[0]) - 1, 0.1 * (x[0] - np.e)]) if x[0] > 0 else np.full(2, np.nan)

    x = gauss_newton(residuals, slopes(residuals), np.array([40.0]))
    assert x[0] == pytest.approx(np.e)


def test_a_rough_answer_ends_where_falls_are_small():
    calls = []

    def residuals(x):
        calls.append(0)
        return brown_and_dennis(x)

    start = np.array([25.0, 5.0, -5.0, -1.0])
    x = gauss_newton(residuals, slopes(brown_and_dennis), start, least_fall=1e-3)
    assert np.sum(brown_and_dennis(x) ** 2) < 0.1 * np.sum(brown_and_dennis(start) ** 2)
    assert len(calls) < 100  # to the rounding of the machine it takes four hundred
