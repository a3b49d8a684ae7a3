"""Score tests: exact F however few the rows, and a smallest p that is calibrated in its own design."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.diagnostics.score import ProjectedScores, f_test, family_wise, smallest_p_law, subspaces


def _design(rng: np.random.Generator, rows: int, taken: int) -> tuple[np.ndarray, np.ndarray]:
    Q, _ = np.linalg.qr(rng.standard_normal((rows, taken)))
    D = rng.standard_normal((30, rows, 1))
    return Q, D


def test_twelve_rows_are_enough_for_an_exact_level_without_knowing_the_noise() -> None:
    rng = np.random.default_rng(1)
    Q, D = _design(rng, 12, 6)
    hits = 0
    for _ in range(3000):
        y = 7.3 * rng.standard_normal(12)  # its scale is nobody's business
        on = ProjectedScores(y - Q @ (Q.T @ y), Q)
        [seen] = subspaces(on, D[:1])
        z = seen.U.T @ on.y
        hits += on.test(float(z @ z), len(z)) < 0.05
    assert 0.038 < hits / 3000 < 0.062


def test_the_smallest_p_of_many_alike_tests_is_charged_less_than_their_count() -> None:
    rng = np.random.default_rng(2)
    Q, D = _design(rng, 200, 5)
    alike = np.concatenate([D[:1] + 0.1 * D[1:11], D[11:16]])
    on = ProjectedScores(np.zeros(200), Q)
    bases = [seen.U for seen in subspaces(on, alike)]
    law = smallest_p_law(on, bases, rng)
    p = 0.005
    assert p < family_wise(p, law, len(bases)) < 0.8 * p * len(bases)


def test_the_smallest_p_holds_its_level() -> None:
    rng = np.random.default_rng(3)
    Q, D = _design(rng, 60, 5)
    on = ProjectedScores(np.zeros(60), Q)
    bases = [seen.U for seen in subspaces(on, D)]
    law = smallest_p_law(on, bases, rng)
    hits = 0
    for _ in range(1000):
        y = rng.standard_normal(60)
        y = y - Q @ (Q.T @ y)
        smallest = min(f_test(float(np.sum((U.T @ y) ** 2)), U.shape[1], float(y @ y), 55) for U in bases)
        hits += family_wise(smallest, law, len(bases)) < 0.05
    assert 0.025 < hits / 1000 < 0.085
