"""Rows that were missing, and could come out the other way: each is given numbers that turn its verdict."""

import numpy as np
import pandas as pd
import pytest

from calibench.bench.papers.cong2008 import actual
from calibench.bench.papers.cong2008.machine import counted_closure
from calibench.bench.papers.ledger import Evidence, Printed, Tolerance, judge_either
from calibench.bench.papers.pashkevich2008 import claims, claims as equations

CONG, PASHKEVICH = Printed("cong2008"), Printed("pashkevich2008")


def by_key(rows):
    return {row.key.removeprefix("claim."): row for row in rows}


@pytest.mark.parametrize(("name", "each"), [("e1", (6, 5)), ("e2", (3, 2))])
def test_the_closure_equations_are_counted_as_printed(name, each):
    assert counted_closure(name) == (each, 12)


def test_j3_of_the_nominal_machine_is_right_with_its_offsets_calibrated_first():
    row = actual._nominal(CONG)
    assert row.verdict == "reproduced in kind"
    assert row.ours_median == pytest.approx(2.05e5, rel=5e-3)
    assert "a radius of 81.8 mm" in row.reason
    real = actual._calibrated(CONG)
    assert actual.nominal_j3(real, 80.0, offsets_first=False) > 10 * row.printed
    assert actual.nominal_j3(real, 82.0) > row.printed > actual.nominal_j3(real, 81.0)


def test_j3_of_another_machine_is_not_that_which_is_printed(monkeypatch):
    real = actual._calibrated(CONG)
    real[6:9] += 3.0
    monkeypatch.setattr(actual, "_calibrated", lambda printed: real)
    assert actual._nominal(CONG).verdict == "not reproduced"


def runs_that_settle(at, budget=1_500_000):
    options = '{"plan": "circle", "radius": 80.0}'
    runs = pd.DataFrame(
        {"run_id": ["a"], "study": "cong2008_circle", "problem": "full12", "optimizer": "de", "repetition": 0,
         "problem_options": options, "optimizer_options": "{}", "charged": budget, "best_value": 380.0}
    )  # fmt: skip
    traces = pd.DataFrame({"run_id": "a", "charged": [1.0, at, budget], "best_value": [1e4, 380.001, 380.0]})
    return Evidence(runs, traces)


@pytest.mark.parametrize(
    ("at", "budget", "verdict"),
    [
        (7e5, 1_500_000, "reproduced"),
        (2e5, 1_500_000, "reproduced in kind"),
        (3e4, 1_500_000, "not reproduced"),
        (7e2, 800, "open at this budget"),
    ],
)
def test_when_de_improves_no_more_on_a_noisy_circle_is_read_off_its_trace(at, budget, verdict):
    row = actual._evaluations(CONG, runs_that_settle(at, budget))
    assert row.verdict == verdict
    assert row.ours_median == at


def test_the_printed_equations_hold():
    rows = by_key(equations.equation_rows(PASHKEVICH))
    assert {rows[f"equation{n}"].verdict for n in (5, 6, 7, 8, 9)} == {"reproduced"}
    assert rows["equation11_rest"].verdict == "reproduced"
    assert rows["linearisation_rho"].verdict == "reproduced"
    assert rows["linearisation_full"].verdict == "not reproduced"


@pytest.mark.parametrize("name", ["equation_5", "equation_6", "equation_7", "equation_8", "equation_9"])
def test_an_equation_with_a_wrong_sign_is_not_reproduced(name, monkeypatch):
    honest = getattr(equations, name)

    def wrong(*given):
        matrix = honest(*given).copy()
        matrix[1, 4] = -matrix[1, 4]
        return matrix

    monkeypatch.setattr(equations, name, wrong)
    key = name.replace("_", "")
    row = next(
        row for row in equations.equation_rows(PASHKEVICH) if row.key.endswith(key)
    )  # those after it take seconds
    assert row.verdict == "not reproduced"


@pytest.mark.slow
def test_the_range_of_the_linearisation_is_where_it_leaves_the_noise():
    reach = equations.linear_range(0.01)
    assert equations.linear_error(np.full(6, 0.5 * reach)) <= 0.01
    assert reach == pytest.approx(0.99, abs=0.01)


def test_noise_is_judged_alike_before_and_after_the_tuning(monkeypatch):
    rows = by_key(claims.assumption_rows(PASHKEVICH))
    assert rows["sigma_unrealistic"].verdict == "reproduced"
    assert rows["assumptions_valid"].verdict == "not reproduced"
    monkeypatch.setattr(claims, "noise_of", lambda data: (0.011, 0.008))  # as the gauges are
    rows = by_key(claims.assumption_rows(PASHKEVICH))
    assert rows["sigma_unrealistic"].verdict == "not reproduced"
    assert rows["assumptions_valid"].verdict == "reproduced"


def test_the_orientation_of_the_axes_is_asked_of_the_data():
    found = claims.orientation("exp2")
    assert (round(found.F, 2), round(found.p, 2)) == (0.10, 0.96)


def test_a_number_of_two_tables_is_reproduced_where_both_have_it():
    half = Tolerance(0.5, "half a digit")
    assert judge_either(3.0, [2.9, 2.1], half).verdict == "reproduced in kind"
    assert judge_either(3.0, [], half).verdict == "not checkable"
