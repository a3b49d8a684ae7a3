"""Formulas that are off: what a form may explain is integrated out, and names survive it."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.claims import in_sets, true_names
from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.fitting import fit as fitting
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.search.off_form import _least


def _told(seed: int) -> tuple[bool, str]:
    sealed = case(seed, kind="one", bent=True)
    report = explain("gpm2002", MeasuredData(sealed.columns, "gpm2002", sealed.metadata, "case"))
    return in_sets(true_names(sealed.truth)[0], report.to_dict(), lenient=False), report.verdict


def test_a_curve_that_wins_by_the_error_of_a_form_is_no_unknown() -> None:
    there, verdict = _told(602103)
    assert there
    assert verdict != "unknown"


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2])
def test_the_form_is_integrated_out(k: int) -> None:
    rng = np.random.default_rng(k)
    D, T, c = rng.standard_normal((30, k)), 0.3 * rng.standard_normal((30, 2, k)), rng.uniform(1, 2, k)
    y = D @ c + T @ c @ rng.standard_normal(2) + rng.standard_normal(30)

    def dense(at: np.ndarray) -> float:
        covariance, left = np.eye(30) + (T @ at) @ (T @ at).T, y - D @ at
        return float(left @ np.linalg.solve(covariance, left) + np.linalg.slogdet(covariance)[1])

    found = _least(y, D, T, c)
    about = [c + step for step in rng.uniform(-0.5, 0.5, (300, k))]
    assert found <= min(map(dense, about)) + 1e-3
    assert found >= min(map(dense, [c + step for step in rng.uniform(-1, 1, (30_000, k))])) - 0.05


def _model(seed: int) -> Model:
    sealed = case(seed, kind="none")
    machine = machines.make("gpm2002")
    return Model(machine.formulate(MeasuredData(sealed.columns, "gpm2002", sealed.metadata, "case")))


def test_a_descent_ends_at_the_bottom(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[int] = []
    linearise = fitting.linearise

    def counted(*asked: object) -> object:
        looked.append(1)
        return linearise(*asked)  # type: ignore[arg-type]

    monkeypatch.setattr(fitting, "linearise", counted)
    assert fit(_model(601013), Noise()).converged
    assert len(looked) < 30


def test_a_fit_about_another_is_the_same_fit() -> None:
    model = _model(601013)
    cold = fit(model, Noise())
    warm = fit(model, Noise(), cold.x + 1e-3, about=cold)
    sd = np.sqrt(np.diag(cold.covariance()))
    assert np.abs(warm.x - cold.x).max() < 1e-3 * sd.max()
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
