"""Standard errors, intervals, F tests and leave-one-out, against textbook formulas and simulation."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

from calibench import problems
from calibench.problems import Parameter
from calibench.problems.fitting import fit
from calibench.problems.identifiability import estimate, f_test, f_test_of_sums, leave_one_out


@dataclass
class Line:
    """A straight-line fit: residuals a + b t - y."""

    y: np.ndarray
    free: int = 2
    name: str = "line"

    def __post_init__(self):
        t = np.linspace(0, 1, len(self.y))
        self.matrix = np.column_stack([np.ones_like(t), t, t**2])[:, : self.free]
        self.coordinates = tuple(Parameter(n, "mm", 0.0, -9.0, 9.0) for n in ("a", "b", "c")[: self.free])
        self.start = np.zeros(self.free)

    def residuals(self, x):
        return self.matrix @ x - self.y

    def jacobian(self, x):
        return self.matrix


Y = np.array([1.0, 1.7, 1.9, 3.2, 3.4, 4.4, 4.3])


def test_a_straight_line_has_the_textbook_s_standard_errors():
    found, t = estimate(Line(Y)), np.linspace(0, 1, 7)
    book = stats.linregress(t, Y)
    np.testing.assert_allclose(found.x, [book.intercept, book.slope])
    np.testing.assert_allclose(found.standard_errors, [book.intercept_stderr, book.stderr])
    half = stats.t.ppf(0.975, 5) * book.stderr
    np.testing.assert_allclose(found.intervals()[1], [book.slope - half, book.slope + half])
    assert found.degrees_of_freedom == 5
    assert not found.sigma_known
    np.testing.assert_allclose(np.diag(found.correlations), 1)


def test_a_known_sigma_gives_normal_intervals():
    found = estimate(Line(Y), sigma=0.1)
    half = stats.norm.ppf(0.95) * found.standard_errors
    np.testing.assert_allclose(found.intervals(0.9), np.column_stack([found.x - half, found.x + half]))
    np.testing.assert_allclose(found.covariance, 0.01 * np.linalg.inv(Line(Y).matrix.T @ Line(Y).matrix))


@pytest.mark.slow
@pytest.mark.parametrize("weighted", [False, True])
def test_with_correlated_residuals_the_errors_are_those_of_many_fits(weighted):
    rng, m = np.random.default_rng(0), 7
    half = np.tril(rng.normal(size=(m, m))) + 2 * np.eye(m)
    spread = half @ half.T
    true = np.array([1.0, 3.0])
    cases = [Line(Line(Y).matrix @ true + 0.1 * half @ rng.normal(size=m)) for _ in range(2000)]
    found = [estimate(c, covariance=spread, weighted=weighted) for c in cases]
    expected = estimate(cases[0], covariance=spread, weighted=weighted, sigma=0.1).standard_errors
    np.testing.assert_allclose(np.std([f.x for f in found], axis=0), expected, rtol=0.08)
    assert np.mean([f.sigma**2 for f in found]) == pytest.approx(0.01, rel=0.1)
    best = estimate(cases[0], covariance=spread, weighted=True, sigma=0.1).standard_errors
    assert (best <= expected * (1 + 1e-12)).all()


def test_a_combination_has_the_error_that_correlations_leave():
    found = estimate(Line(Y))
    value, error = found.of({"a": 1, "b": 0.5})
    assert value == pytest.approx(Y.mean())
    assert error == pytest.approx(found.sigma / np.sqrt(7))
    with pytest.raises(ValueError, match=r"d: .* a, b"):
        found.of({"d": 1})


def test_the_estimate_is_exported_with_its_errors():
    found = estimate(problems.make("orthoglide6", free="rho"), sigma=0.01)
    rows = found.rows()
    assert [r["parameter"] for r in rows] == ["drho_x", "drho_y", "drho_z"]
    assert [r["value"] for r in rows] == found.x.tolist()
    assert [r["standard_error"] for r in rows] == found.standard_errors.tolist()
    assert rows[0]["unit"] == "mm"
    told = json.loads(json.dumps(found.to_dict(0.9)))
    assert told["parameters"][0]["upper"] > told["parameters"][0]["value"]


def test_it_works_for_planar_problems_too():
    problem = problems.make("full11", noise=1e-4, data_seed=1)
    found = estimate(problem, fit(problem, problem.truth))
    assert found.names == tuple(c.name for c in problem.coordinates)
    assert (np.abs(found.x - problem.truth) < 5 * found.standard_errors).all()


def test_what_cannot_be_seen_has_no_standard_error():
    problem = problems.make("full12")
    with pytest.raises(ValueError, match="11 of 12 parameters"):
        estimate(problem, problem.truth)


def test_fit_finds_the_least_squares_answer_weighted_or_not():
    line, spread = Line(Y), np.diag(np.arange(1.0, 8.0))
    np.testing.assert_allclose(fit(line), np.linalg.pinv(line.matrix) @ Y)
    weights = np.linalg.inv(spread)
    expected = np.linalg.solve(line.matrix.T @ weights @ line.matrix, line.matrix.T @ weights @ Y)
    np.testing.assert_allclose(fit(line, covariance=spread), expected)
    exact = problems.make("orthoglide6", data="synthetic")
    np.testing.assert_allclose(fit(exact), exact.truth, atol=1e-10)


def test_the_f_test_of_a_slope_is_the_square_of_its_t_test():
    test, found = f_test(Line(Y, 1), Line(Y, 2)), estimate(Line(Y))
    assert test.statistic == pytest.approx((found.x[1] / found.standard_errors[1]) ** 2)
    assert test.p_value == pytest.approx(stats.linregress(np.linspace(0, 1, 7), Y).pvalue)
    assert "1 more parameters are supported by the data" in test.sentence()


def test_the_f_test_keeps_its_level_when_nothing_is_there():
    rng = np.random.default_rng(1)
    spread = np.eye(7) + 0.6 * (np.ones((7, 7)) - np.eye(7))
    half = np.linalg.cholesky(spread)
    draws = [1 + half @ rng.normal(size=7) for _ in range(400)]
    rate = np.mean([f_test(Line(y, 1), Line(y, 3), covariance=spread).p_value < 0.1 for y in draws])
    assert rate == pytest.approx(0.1, abs=0.05)


def test_an_f_test_needs_nested_sets_and_the_same_data():
    rho, L, full = (problems.make("orthoglide6", free=f) for f in ("rho", "L", "full"))
    for small, large, message in (
        (rho, L, "orthoglide6 is not nested in orthoglide6: drho_x"),
        (full, full, "the same parameters"),
        (rho, problems.make("orthoglide6", data="exp3_t2"), "different data"),
    ):
        with pytest.raises(ValueError, match=message):
            f_test(small, large)
    with pytest.raises(ValueError, match="there is nothing to test"):
        f_test_of_sums(1.0, 3, 0.5, 6, 6)


def test_leave_one_out_is_the_textbook_s_for_a_line():
    line = Line(Y)
    found = leave_one_out(line)
    hat = line.matrix @ np.linalg.pinv(line.matrix)
    expected = line.residuals(fit(line)) / (1 - np.diag(hat))
    np.testing.assert_allclose(found.prediction_errors, expected)
    assert found.rms == pytest.approx(np.sqrt(np.mean(expected**2)))
    for k in range(7):
        kept = np.arange(7) != k
        np.testing.assert_allclose(found.without[k], np.linalg.lstsq(line.matrix[kept], Y[kept])[0])
    np.testing.assert_allclose(found.shifts, found.without - found.x)


def test_without_one_reading_the_full_set_of_the_orthoglide_moves_by_millimetres():
    full, rho = (leave_one_out(problems.make("orthoglide6", free=f)) for f in ("full", "rho"))
    assert np.abs(full.shifts).max() > 2.0
    assert np.abs(rho.shifts).max() < 0.5
    assert rho.rms < full.rms


def test_leave_one_out_says_which_residual_cannot_be_spared():
    with pytest.raises(ValueError, match="1 of 2 parameters"):
        leave_one_out(Line(np.array([1.0, 2.0])))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sigma": 0.0}, "sigma=0: a standard deviation above 0"),
        ({"covariance": np.eye(3)}, r"covariance has shape \(3, 3\): a symmetric \(7, 7\) is needed"),
        ({"covariance": np.ones((7, 7))}, "not positive definite"),
    ],
)
def test_wrong_arguments_are_one_line(arguments, message):
    with pytest.raises(ValueError, match=message):
        estimate(Line(Y), **arguments)
    with pytest.raises(ValueError, match="leave nothing to tell sigma by"):
        estimate(Line(np.array([1.0, 2.0])))
    with pytest.raises(ValueError, match=r"level=1\.5"):
        estimate(Line(Y)).intervals(1.5)
