"""NIST's certified regressions: data, values and derivatives are what NIST prints, and our least squares find them."""

from decimal import Decimal, getcontext, localcontext
from typing import get_args

import numpy as np
import pytest

from calibench import bench, optimizers, problems, testing
from calibench.bench.cli import main
from calibench.problems import estimate
from calibench.problems.suites.nist import models, regression
from calibench.problems.suites.nist.regression import table

NAMES = get_args(regression.Name)
DIFFICULTY = {
    "lower": "Misra1a Chwirut2 Chwirut1 Lanczos3 Gauss1 Gauss2 DanWood Misra1b",
    "average": "Kirby2 Hahn1 Nelson MGH17 Lanczos1 Lanczos2 Gauss3 Misra1c Misra1d Roszman1 ENSO",
    "higher": "MGH09 Thurber BoxBOD Rat42 MGH10 Eckerle4 Rat43 Bennett5",
}
SIZES = {  # observations, parameters
    "Misra1a": (14, 2), "Chwirut2": (54, 3), "Chwirut1": (214, 3), "Lanczos3": (24, 6), "Gauss1": (250, 8),
    "Gauss2": (250, 8), "DanWood": (6, 2), "Misra1b": (14, 2), "Kirby2": (151, 5), "Hahn1": (236, 7),
    "Nelson": (128, 3), "MGH17": (33, 5), "Lanczos1": (24, 6), "Lanczos2": (24, 6), "Gauss3": (250, 8),
    "Misra1c": (14, 2), "Misra1d": (14, 2), "Roszman1": (25, 4), "ENSO": (168, 9), "MGH09": (11, 4),
    "Thurber": (37, 7), "BoxBOD": (6, 2), "Rat42": (9, 3), "MGH10": (16, 3), "Eckerle4": (35, 3), "Rat43": (15, 4),
    "Bennett5": (154, 3),
}  # fmt: skip
_HALF_A_DIGIT = 0.5e-10  # of a number printed with eleven digits, in its leading power of ten

every = pytest.mark.parametrize("name", NAMES)
over_starts = pytest.mark.parametrize("from_start", [1, 2])


def made(name, **options):
    return problems.make("nist", name=name, **options)


def half_units(printed):
    """Return half a unit of the last of eleven printed digits."""
    return _HALF_A_DIGIT * 10.0 ** np.floor(np.log10(np.abs(printed)))


@every
def test_the_certified_sum_of_squares_follows_from_certified_values_and_data(name):
    """To the printed digits, but for what their rounding and that of the parameters' digits can change."""
    problem = made(name)
    slopes, rounding = np.abs(problem.jacobian(problem.truth)), half_units(problem.truth)
    by_the_parameters = float(np.sum((slopes @ rounding) ** 2))  # at the minimum there is no first order
    allowed = half_units(problem.minimum) + by_the_parameters + problem._rounding
    assert abs(problem(problem.truth) - problem.minimum) <= allowed
    assert allowed <= 1e-9 * problem.minimum or name in ("Lanczos1", "Lanczos2")


@every
def test_the_certified_standard_deviations_follow_too(name):
    if name == "Lanczos1":
        pytest.skip("its residuals are 1e-14 of the readings: beyond double precision, see the test in 50 digits")
    problem = made(name)
    m, dim = SIZES[name]
    found = estimate(problem, problem.truth).standard_errors
    assert (m, dim) == (len(problem.residuals(problem.truth)), len(found))
    np.testing.assert_allclose(found, table(name).deviations, rtol=1e-6 if "Lanczos" not in name else 1e-4)
    assert problem.typical_noise == pytest.approx(np.sqrt(problem.minimum / (m - dim)), rel=1e-9)


@pytest.mark.parametrize("name", ["Lanczos1", "Lanczos2", "Lanczos3"])
def test_in_fifty_digits_the_least_sum_of_three_decays_is_the_certified_one(name):
    printed = table(name)
    with localcontext() as context:
        context.prec = 50
        x = [Decimal(repr(float(v))) for v in printed.x[0]]
        y = [Decimal(repr(float(v))) for v in printed.y]
        b = [Decimal(repr(float(v))) for v in printed.certified]
        for _ in range(4):  # Gauss-Newton from the printed digits
            rows, r = zip(*(_decays(b, at, reading) for at, reading in zip(x, y, strict=True)), strict=True)
            step = _solved(rows, r)
            b = [value - change for value, change in zip(b, step, strict=True)]
        least = sum((_decays(b, at, reading)[1] ** 2 for at, reading in zip(x, y, strict=True)), Decimal(0))
    assert f"{float(least):.10E}" == f"{printed.sum_of_squares:.10E}"
    assert [f"{float(value):.10E}" for value in b] == [f"{value:.10E}" for value in printed.certified]


@every
def test_slopes_are_those_of_differences_in_more_digits(name):
    model, printed = models.MODELS[name], table(name)
    x = printed.x.astype(np.longdouble)
    for b in (printed.certified, *printed.starts):
        slopes = model.slopes(b, printed.x)
        for k, size in enumerate(b.astype(np.longdouble)):
            step = np.zeros_like(b, dtype=np.longdouble)
            step[k] = size * np.longdouble(1e-6)
            expected = (model.value(b + step, x) - model.value(b - step, x)) / (2 * step[k])
            rounding = 1e-12 * np.abs(model.value(b, printed.x)).max() / abs(size)  # of the difference
            atol = float(1e-8 * np.abs(expected).max() + rounding)
            np.testing.assert_allclose(slopes[:, k], expected.astype(float), rtol=1e-7, atol=atol)


@pytest.mark.parametrize("law", testing.PROBLEM_LAWS, ids=lambda law: law.__name__)
def test_a_regression_keeps_the_laws_of_a_problem(law):
    for name in NAMES:
        if law.__name__ != "jacobian_agrees_with_differences" or name in ("Rat43", "Misra1a", "ENSO"):
            law(made(name, from_start=1))  # where a slope is 1e-9 of the readings differences see only their rounding


@every
def test_the_box_holds_what_nist_prints_and_its_middle_is_not_the_answer(name):
    problem, printed = made(name), table(name)
    for point in (*printed.starts, printed.certified):
        assert ((problem.lower < point) & (point < problem.upper)).all()
    place = (problem.truth - problem.lower) / (problem.upper - problem.lower)
    assert (np.abs(place - 0.5) > 0.07).all()


@every
@over_starts
def test_a_start_is_nist_s_and_a_value_can_be_had_there(name, from_start):
    problem = made(name, from_start=from_start)
    assert problem.start.tolist() == table(name).starts[from_start - 1].tolist()
    assert np.isfinite(problem(problem.start))
    assert problem(problem.start) > problem.targets[-1] > problem.minimum


def test_groups_are_nist_s_levels_of_difficulty():
    found = {level: [name for name in NAMES if made(name).group == level] for level in DIFFICULTY}
    assert found == {level: names.split() for level, names in DIFFICULTY.items()}
    assert tuple(models.MODELS) == NAMES


def test_both_starts_share_data_box_and_targets():
    one, two = made("MGH09", from_start=1), made("MGH09", from_start=2)
    assert one.data_id == two.data_id != made("MGH10").data_id
    assert one.targets == two.targets
    assert one.lower.tolist() == two.lower.tolist()
    assert one.upper.tolist() == two.upper.tolist()


def test_the_score_counts_digits_of_the_worst_parameter():
    problem = made("BoxBOD")
    assert problem.merit(problem.truth)["certified_digits"] == 11
    assert problem.merit(problem.truth * [1 + 1e-3, 1 + 1e-7])["certified_digits"] == pytest.approx(3)
    assert problem.merit(problem.truth * [1, 1 - 1e-14])["certified_digits"] == 11
    assert problem.merit(-problem.truth)["certified_digits"] == 0
    assert problem.merit(np.full(2, np.nan))["certified_digits"] == 0


def test_where_a_model_overflows_the_value_is_not_finite_and_nothing_warns():
    problem = made("MGH10")
    assert not np.isfinite(problem([1.0, 1e5, -50.0]))
    assert not np.isfinite(made("Bennett5")([-2000.0, -50.0, 0.8]))


def test_a_residual_without_a_finite_square_is_infinite():
    problem = made("MGH10")
    x = np.array([1.0, 4e4, -0.5])  # exp(800) and less
    assert np.isinf(problem(x))
    assert np.isinf(problem.residuals(x)).any()
    assert not (np.abs(problem.residuals(x)[np.isfinite(problem.residuals(x))]) > 1e150).any()


def test_with_differences_no_jacobian_is_shown_and_evaluations_pay():
    run = bench.execute(made("Rat42", jacobian="differences"), optimizers.make("lm"), budget=5000)
    assert run.row["jacobian_evaluations"] == 0
    assert run.charged == run.evaluations
    assert bench.execute(made("Rat42"), optimizers.make("lm"), budget=5000).row["jacobian_evaluations"] > 0


@pytest.mark.parametrize(("optimizer", "least"), [("lm", 24), ("trf", 25)])
def test_least_squares_find_six_certified_digits_from_the_near_start(optimizer, least):
    runs = [bench.execute(made(name, from_start=2), optimizers.make(optimizer), budget=5000) for name in NAMES]
    assert all(run.charged <= 5000 for run in runs)
    digits = [made(name).merit(run.best_x)["certified_digits"] for name, run in zip(NAMES, runs, strict=True)]
    assert sum(score >= 6 for score in digits) >= least


def test_a_data_set_is_swept_by_its_name_on_the_command_line(tmp_path):
    words = ["run", "-m", "problem=nist", "problem.name=MGH09,BoxBOD", "problem.from_start=1,2", "optimizer=lm"]
    with pytest.raises(SystemExit) as ended:
        main([*words, "budget=2000", "seeds=1", f"results={tmp_path}"])
    assert ended.value.code == 0
    runs = bench.ResultStore(tmp_path / "adhoc").runs()
    assert sorted(runs["problem"].unique()) == ["nist"]
    assert len(runs) == 4
    assert (runs["merit.certified_digits"] >= 6).all()


def _decays(b, x, y):
    """Return the slopes of a residual of three decays, and the residual."""
    decays = [(-b[k + 1] * x).exp() for k in (0, 2, 4)]
    r = sum((b[2 * k] * decay for k, decay in enumerate(decays)), -y)
    return [term for k, decay in enumerate(decays) for term in (decay, -b[2 * k] * x * decay)], r


def _solved(rows, r):
    """Return the least squares solution of rows @ step = r by the normal equations, which 50 digits can bear."""
    assert getcontext().prec == 50
    n = len(rows[0])
    system = [
        [sum(row[i] * row[j] for row in rows) for j in range(n)] + [sum(row[i] * v for row, v in zip(rows, r))]
        for i in range(n)
    ]
    for i in range(n):
        for k in range(n):
            if k != i:
                share = system[k][i] / system[i][i]
                system[k] = [a - share * c for a, c in zip(system[k], system[i])]
    return [system[i][n] / system[i][i] for i in range(n)]
