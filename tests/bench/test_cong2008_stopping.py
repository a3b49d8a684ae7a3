"""Section 3.3 over the variants of fmincon: the interval of a median, and what follows from states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calibench.bench.papers.cong2008.stopping import MATLAB, VARIANTS, Judged, Variant, options_of, plan, verdict_of
from calibench.bench.papers.ledger import Verdict, problem as make_problem
from calibench.optimizers.fmincon import fmincon

BELOW, KIND, BOTH, ABOVE = [0.1] * 15, [0.6] * 15, [0.1] * 8 + [2.0] * 7, [2.0] * 15


class Times:
    """A problem with its J multiplied."""

    def __init__(self, problem: Any, factor: float) -> None:
        self.problem, self.factor = problem, factor

    def __call__(self, x: Any) -> float:
        return self.factor * float(self.problem(x))


def kmrmse(problem: Any, fun: Any, variant: Variant) -> tuple[float, int]:
    found = fmincon(fun, problem.start, lb=problem.lower, ub=problem.upper, options=options_of(variant))
    return problem.merit(found.x)["kmrmse"], found.output.iterations


def judged(releases: list[list[float]], relative: tuple[list[float], list[float]]) -> list[Judged]:
    """Return a claim's judgements: ratios of the four releases in order, and of the two with a relative stop."""
    states, found = {v: r for v, r in zip([v for v in VARIANTS if v.release], releases, strict=True)}, []
    for variant in VARIANTS:
        ratios = relative[variant.step == "gradient"] if variant.stop == "relative" else states.get(variant, ABOVE)
        found.append(Judged(variant, tuple(ratios), (0.5, 0.75)))
    return found


@pytest.mark.parametrize(
    ("releases", "relative", "verdict"),
    [
        ([BELOW] * 4, (BELOW, BELOW), "reproduced"),  # what no release was (ABOVE) does not count
        ([BELOW] * 3 + [KIND], (BELOW, BELOW), "reproduced in kind"),
        ([BELOW] * 3 + [BOTH], (BELOW, BOTH), "reproduced in kind"),
        ([BELOW] * 4, (ABOVE, BELOW), "artefact of the stopping tolerance"),
        ([BOTH] * 3 + [BELOW], (ABOVE, ABOVE), "artefact of the stopping tolerance"),
        ([BELOW] * 2 + [ABOVE] * 2, (BELOW, BELOW), "depends on plan or release"),
        ([BELOW] * 3 + [ABOVE], (ABOVE, ABOVE), "depends on plan or release"),
        ([ABOVE] * 4, (BELOW, BELOW), "not reproduced"),
        ([ABOVE] * 3 + [BOTH], (ABOVE, ABOVE), "not checkable"),
        ([BOTH] * 4, (BOTH, BOTH), "not checkable"),
    ],
)
def test_a_verdict_follows_from_the_releases_and_the_controls(
    releases: list[list[float]], relative: tuple[list[float], list[float]], verdict: Verdict
) -> None:
    assert verdict_of(judged(releases, relative)) == verdict


def test_four_variants_are_releases() -> None:
    assert sorted(v.release for v in VARIANTS if v.release) == ["1998", "2003-2008", "2009", "about 2002"]
    assert MATLAB.release == "about 2002"


@pytest.mark.parametrize(("n", "interval"), [(15, (4, 12)), (21, (6, 16)), (6, (1, 6)), (5, (1, 5))])
def test_the_interval_of_a_median_is_that_of_the_sign_test(n: int, interval: tuple[int, int]) -> None:
    ratios = tuple(float(i) for i in np.random.default_rng(0).permutation(np.arange(1, n + 1)))
    assert Judged(MATLAB, ratios, (0.5, 0.75)).interval == interval


def test_j2_wins_by_the_unit_of_j1_alone() -> None:
    """J1 is J2 / (4 l_b^2) near zero: multiplied by that it ends where J2 does, and as it is farther away."""
    as_it_is, multiplied = [], []
    for number in range(-1, 4):
        options = {"n": 9} | plan("sensor_zero", number)
        one, two = (make_problem("sensor_zero", error=error, **options) for error in ("J1", "J2"))
        j2, _ = kmrmse(two, two, MATLAB)
        as_it_is.append(j2 / kmrmse(one, one, MATLAB)[0])
        multiplied.append(j2 / kmrmse(one, Times(one, 4.0 * 244.0**2), MATLAB)[0])
    assert np.median(as_it_is) < 0.2
    assert 0.5 < np.median(multiplied) < 2.0
