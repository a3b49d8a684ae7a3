"""Score tests: exact F however few the rows, and a smallest p that is calibrated in its own design."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.diagnostics.score import (
    ProjectedScores,
    columns,
    f_test,
    family_wise,
    p_by_own_scatter,
    projected_scores,
    score_all,
    smallest_p_law,
    subspaces,
)
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.repeats import excess_p
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.search.select import fit_with, run_tests
from calibench.discrepancy.thresholds import THRESHOLDS, using


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
        [(_, U)] = subspaces(on, D[:1])
        z = U.T @ on.y
        hits += on.test(float(z @ z), len(z)) < 0.05
    assert 0.038 < hits / 3000 < 0.062


def test_the_smallest_p_of_many_alike_tests_is_charged_less_than_their_count() -> None:
    rng = np.random.default_rng(2)
    Q, D = _design(rng, 200, 5)
    alike = np.concatenate([D[:1] + 0.1 * D[1:11], D[11:16]])
    on = ProjectedScores(np.zeros(200), Q)
    bases = [U for _, U in subspaces(on, alike)]
    law = smallest_p_law(on, bases, rng)
    p = 0.005
    assert p < family_wise(p, law, len(bases)) < 0.8 * p * len(bases)


def test_the_smallest_p_of_a_draw_is_that_of_all_its_tests() -> None:
    rng = np.random.default_rng(4)
    Q, _ = np.linalg.qr(rng.standard_normal((60, 37)))
    seen = [np.linalg.qr(D - Q @ (Q.T @ D))[0] for D in (rng.standard_normal((60, m)) for m in (2, 1, 1, 3, 23))]
    on = ProjectedScores(np.zeros(60), Q)
    found = smallest_p_law(on, seen, np.random.default_rng(5))
    again = np.random.default_rng(5)
    noise = again.standard_normal((len(found), 60), dtype=np.float32).astype(float)
    left = noise - noise @ Q @ Q.T
    smallest = [
        min(f_test(float(((U.T @ e) ** 2).sum()), U.shape[1], float(e @ e), on.degrees) for U in seen) for e in left
    ]
    assert np.median(found) < 0.4  # of one test alone it would be 1/2
    np.testing.assert_allclose(found, np.sort(smallest), rtol=1e-3)


def test_the_energies_are_those_of_what_calibration_leaves() -> None:
    data = case(3, kind="none", xy=True)
    formulation = machines.make("gpm2002").formulate(MeasuredData(data.columns, "gpm2002", data.metadata, "case"))
    at = fit(Model(formulation), Noise())
    on = projected_scores(at)
    ranks = set()
    for scored, _ in score_all(at, on, catalogue(formulation).candidates[::9]):
        if scored.m == len(scored.energies):
            D = columns(at, scored.effect)
            left = D - on.Q @ (on.Q.T @ D)
            np.testing.assert_allclose(scored.energies, (left**2).sum(axis=0), rtol=1e-6)
            ranks.add(scored.m)
    assert len(ranks) > 1


@pytest.mark.parametrize("autocorrelation", [0.0, 0.4])
def test_from_as_many_rows_as_nobody_draws_sums_score_every_candidate_as_its_columns_do(autocorrelation: float) -> None:
    data = case(3, kind="none", xy=True)
    formulation = machines.make("gpm2002").formulate(MeasuredData(data.columns, "gpm2002", data.metadata, "case"))
    at = fit(Model(formulation), Noise(autocorrelation=autocorrelation))
    on, tried = projected_scores(at), catalogue(formulation).candidates
    slow = score_all(at, on, tried, bases=True)
    with using(replace(THRESHOLDS, drawn_rows=len(on.y))):
        quick = score_all(at, on, tried)
    assert any(len(U) for _, U in slow)
    for (one, U), (other, _) in zip(quick, slow, strict=True):
        assert not len(U)
        assert (one.effect, one.m) == (other.effect, other.m)
        assert pytest.approx(other.T, rel=1e-6, abs=1e-9) == one.T
        assert one.seen.visible == pytest.approx(other.seen.visible, rel=1e-6, abs=1e-7)


def test_the_smallest_p_holds_its_level() -> None:
    rng = np.random.default_rng(3)
    Q, D = _design(rng, 60, 5)
    on = ProjectedScores(np.zeros(60), Q)
    bases = [U for _, U in subspaces(on, D)]
    law = smallest_p_law(on, bases, rng)
    hits = 0
    for _ in range(1000):
        y = rng.standard_normal(60)
        y = y - Q @ (Q.T @ y)
        smallest = min(f_test(float(np.sum((U.T @ y) ** 2)), U.shape[1], float(y @ y), 55) for U in bases)
        hits += family_wise(smallest, law, len(bases)) < 0.05
    assert 0.025 < hits / 1000 < 0.085


def test_the_linear_size_of_an_effect_has_the_sign_of_its_fit() -> None:
    blind = case(5, xy=True, family="gear", lam=2.5, noise="gauss")
    formulation = machines.make("gpm2002").formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))
    [gear] = [e for e in catalogue(formulation).candidates if name_of(e) == "gear joint 3"]
    base = fit(Model(formulation), Noise())
    [(scored, _)] = score_all(base, projected_scores(base), [gear])
    fitted = fit_with(base, [gear]).x[-1]
    assert abs(fitted) > 1e-4
    assert scored.coefficients == pytest.approx([fitted], rel=0.1)


def test_the_law_of_the_smallest_p_is_drawn_for_every_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of steps every fourth was drawn: of 240 sound arms 64 had a p below .2, and with all of them 59 have."""
    blind = case(901, kind="none")
    formulation = machines.make("gpm2002").formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))
    at = fit(Model(formulation), Noise())
    candidates = catalogue(formulation).candidates
    assert sum(effect.positions > 1 for effect in candidates) > 8
    drawn: list[int] = []

    def law(_on: ProjectedScores, bases: list[np.ndarray], _rng: np.random.Generator) -> np.ndarray:
        drawn.append(len(bases))
        return np.empty(0)

    monkeypatch.setattr(importlib.import_module("calibench.discrepancy.diagnostics.score"), "smallest_p_law", law)
    with using(replace(THRESHOLDS, p_sure=0.0, p_calm=2.0)):
        tests = run_tests(at, candidates, (), np.random.default_rng(0))
    assert drawn[0] == sum(scored.m > 0 for scored in tests.names)


def _local(rng: np.random.Generator, rows: int) -> list[np.ndarray]:
    """Return bases (rows, 1) of which each depends on a tenth of the rows, most at one end of a covariate."""
    place = np.argsort(rng.random(rows))
    ramp = np.where(place < rows // 10, place + 1.0, 0.0)
    return [np.roll(ramp, k)[:, None] for k in range(0, rows, 9)]


def _alarms(draw, cut: float) -> float:
    """Return how often the smallest p of local bases is below .02 family-wise, of 400 draws of noise."""
    rng = np.random.default_rng(11)
    Q, _ = np.linalg.qr(rng.standard_normal((240, 12)))
    bases = [np.linalg.qr(D - Q @ (Q.T @ D))[0] for D in _local(rng, 240)]
    hits = 0
    with using(replace(THRESHOLDS, tails_heavy=cut)):
        law = smallest_p_law(ProjectedScores(np.zeros(240), Q), bases, rng)
        for _ in range(400):
            y = draw(rng, 240)
            on = ProjectedScores(y - Q @ (Q.T @ y), Q, spared=True)
            smallest = min(on.test(float(np.sum((U.T @ on.tested) ** 2)), 1) for U in bases)
            hits += family_wise(smallest, law, len(bases)) < 0.02
    return hits / 400


def test_heavy_tails_make_no_more_alarms_than_gaussian_noise() -> None:
    def tails(rng: np.random.Generator, rows: int) -> np.ndarray:
        return rng.standard_t(3, rows)

    assert _alarms(tails, np.inf) > 0.06
    assert _alarms(tails, THRESHOLDS.tails_heavy) < 0.04
    assert _alarms(lambda rng, rows: rng.standard_normal(rows), THRESHOLDS.tails_heavy) < 0.04


def test_a_large_signal_is_found_as_surely_among_clipped_scores() -> None:
    rng = np.random.default_rng(12)
    Q, _ = np.linalg.qr(rng.standard_normal((300, 10)))
    signal = np.sin(np.linspace(0, 9, 300))
    signal -= Q @ (Q.T @ signal)
    y = 0.7 * signal + rng.standard_t(2, 300)
    on = ProjectedScores(y - Q @ (Q.T @ y), Q, spared=True)
    U = signal / np.linalg.norm(signal)
    assert on.excess_kurtosis > 20
    assert on.test(float(U @ on.tested) ** 2, 1) < 0.02 < f_test(float(U @ on.y) ** 2, 1, on.total, on.degrees)
    assert np.abs(Q.T @ on.tested).max() < 1e-9


def test_lack_of_fit_holds_its_level_under_heavy_tails() -> None:
    rng = np.random.default_rng(13)
    hits = {"told": 0, "untold": 0}
    for _ in range(1000):
        on = ProjectedScores(rng.standard_t(5, 300) / np.sqrt(5 / 3), np.empty((300, 0)), spared=True)
        mean = on.total / 300
        hits["told"] += excess_p(mean, 300, np.inf, on.excess_kurtosis) < 0.02
        hits["untold"] += excess_p(mean, 300, np.inf) < 0.02
    assert hits["told"] / 1000 < 0.03
    assert hits["untold"] / 1000 > 0.06


def test_a_p_by_own_scatter_holds_where_noise_is_larger_in_a_part_of_the_run() -> None:
    n, rng = 400, np.random.default_rng(5)
    size = np.where(np.arange(n) < 80, 2.0, 1.0)
    U = np.where(np.arange(n) < 80, rng.standard_normal(n), 0.0)[:, None]
    U = U / np.linalg.norm(U)
    below = []
    for _ in range(600):
        on = ProjectedScores(size * rng.standard_normal(n), np.zeros((n, 0)))
        below.append((p_by_own_scatter(on, U) < 0.05, on.test(float(np.sum((U.T @ on.y) ** 2)), 1) < 0.05))
    own, equal = np.mean(below, axis=0)
    assert own < 0.1 < equal
