"""The fit: slopes at adjusted readings, and parameters with honest standard deviations."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, Model, machines
from calibench.discrepancy.diagnostics.score import columns, projected_scores
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import Fit, _step, fit, linearise, readings_of
from calibench.discrepancy.noise.whiten import Noise
from tests.discrepancy.empty_runs import empty_run

_FAINT = 3e-3  # visible fraction below which calibration all but absorbs a direction


def _faint_scores(at: Fit) -> list[float]:
    """Return the scores, of unit variance where nothing is missing, of all directions that are hardly visible."""
    on, found = projected_scores(at), []
    for effect in catalogue(at.model.formulation).candidates:
        if effect.family != "angle_error":
            continue
        D = columns(at, effect)
        D = D / np.linalg.norm(D, axis=0)
        for _ in range(2):
            D = D - on.Q @ (on.Q.T @ D)
        U, s, _ = np.linalg.svd(D, full_matrices=False)
        found += [float(u @ at.r) for u, visible in zip(U.T, s) if visible < _FAINT]
    return found


def test_a_nearly_invisible_direction_stays_within_its_noise_where_nothing_is_missing() -> None:
    rng = np.random.default_rng(4)
    adjusted, naive = [], []
    for _ in range(5):
        model = Model(machines.make("gpm2002").formulate(empty_run(rng, poses=180, repeats=8, radius=95.0)))
        best = fit(model, Noise())
        adjusted += _faint_scores(best)
        readings = readings_of(model)
        at = linearise(model, Noise(), best.x, readings, readings)
        naive += _faint_scores(Fit(model, best.x, Noise(), at, at.whiten(at.misclosure), at.whiten(at.columns), True))
    assert len(adjusted) > 30
    assert np.sqrt(np.mean(np.square(adjusted))) < 1.35  # measured over 25 machines: 0.97 - 1.14
    assert np.sqrt(np.mean(np.square(naive))) > 2.0  # slopes at the readings themselves: up to 4.5


def test_parameters_miss_the_truth_by_their_standard_deviations() -> None:
    rng = np.random.default_rng(5)
    z = []
    for _ in range(12):
        data = empty_run(rng, poses=50)
        model = Model(machines.make("gpm2002").formulate(data))
        best = fit(model, Noise())
        assert best.converged
        truth = np.array([data.metadata["nominal"][p.name] for p in model.formulation.parameters])
        z += list((best.x - truth) / np.sqrt(np.diag(best.covariance())))
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.25


def test_a_fit_begun_where_another_ended_ends_there_too() -> None:
    """What the model lacks is large, so slopes at readings and at adjusted readings lead to different places."""
    blind = case(6, kind="one", family="compliance", xy=True, lam=1.5, noise="gauss")
    data = MeasuredData(blind.columns, "gpm2002", blind.metadata)
    model = Model(machines.make("gpm2002").formulate(data))
    first = fit(model, Noise())
    for nearby in (first.x, fit(model, Noise(), first.x * (1 + 1e-6)).x):
        assert fit(model, Noise(), nearby).cost == pytest.approx(first.cost, rel=1e-8)


def test_weights_of_heavy_tails_settle_without_new_slopes(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model(machines.make("gpm2002").formulate(empty_run(np.random.default_rng(6), poses=50)))
    start, looks = fit(model, Noise()).x * (1 + 1e-6), []

    def counted(*asked: object) -> object:
        looks.append(1)
        return linearise(*asked)  # type: ignore[arg-type]

    monkeypatch.setattr("calibench.discrepancy.fitting.fit.linearise", counted)
    assert fit(model, Noise(t_degrees=3.0), start).converged
    heavy = len(looks)
    looks.clear()
    assert fit(model, Noise(), start).converged
    assert heavy <= len(looks) + 1


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("rows", [4, 60])
def test_a_step_shares_what_columns_that_depend_on_each_other_explain(rows: int, damping: float) -> None:
    rng = np.random.default_rng(7)
    J, r = rng.standard_normal((rows, 6)) * [1e-3, 1, 1, 1, 1e4, 1], rng.standard_normal(rows)
    J[:, 5] = 2 * J[:, 1]
    size = np.linalg.norm(J, axis=0)
    A = np.vstack([J / size, np.sqrt(damping) * np.eye(6)])
    best = np.linalg.lstsq(A, np.concatenate([-r, np.zeros(6)]), rcond=1e-10)[0]
    np.testing.assert_allclose(size * _step(r, J, Noise(), damping), best, rtol=1e-7, atol=1e-9)
