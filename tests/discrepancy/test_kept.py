"""Fits that a search asks for again: known by their start, and made anew where another noise would not end there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench.discrepancy import Model, machines
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting import fit as kept
from calibench.discrepancy.fitting.fit import Fit, at_any_scale, fit, fit_once, keeping_fits
from calibench.discrepancy.model.effect import ChangePoint
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.search.select import _finer
from calibench.discrepancy.thresholds import THRESHOLDS, using
from tests.discrepancy.empty_runs import empty_run


@pytest.fixture(scope="module")
def model() -> Model:
    return Model(machines.make("gpm2002").formulate(empty_run(np.random.default_rng(3), poses=40)))


@pytest.fixture
def walked(monkeypatch: pytest.MonkeyPatch) -> list[Fit]:
    """Return the fits that were truly made."""
    made: list[Fit] = []

    def counted(*args: object, **options: object) -> Fit:
        made.append(fit(*args, **options))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(kept, "fit", counted)
    return made


def _same(one: Fit, other: Fit) -> bool:
    return np.array_equal(one.x, other.x) and np.array_equal(one.r, other.r) and np.array_equal(one.J, other.J)


@pytest.mark.parametrize("scale", [1.0, 0.5, 2.0])
def test_a_fit_from_the_same_start_is_that_of_before_to_the_last_bit(
    model: Model, walked: list[Fit], scale: float
) -> None:
    start = fit(model, Noise()).x
    with keeping_fits():
        fit_once(model, Noise(), start)
        again = fit_once(model, Noise(scale), start)
    assert len(walked) == 1
    assert again.noise.scale == scale
    assert _same(again, fit(model, Noise(scale), start))


def test_another_start_or_another_noise_is_another_fit(model: Model, walked: list[Fit]) -> None:
    start = fit(model, Noise()).x
    others = [
        (Noise(), start + 1e-9, {}), (Noise(), start, {"near": False}), (Noise(autocorrelation=0.3), start, {}),
        (Noise(extra={model.formulation.readings[0]: 1e-3}), start, {}),
        (Noise(), start, {"about": fit(model, Noise(2.0))}),
    ]  # fmt: skip
    with keeping_fits():
        fit_once(model, Noise(), start)
        for noise, at, options in others:
            fit_once(model, noise, at, **options)
    assert len(walked) == 1 + len(others)


def test_what_another_scale_would_not_end_with_is_walked_again(
    model: Model, walked: list[Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    start = fit(model, Noise()).x
    with keeping_fits():
        fit_once(model, Noise(), start)
        monkeypatch.setattr(kept, "rests", lambda found: False)
        fit_once(model, Noise(0.5), start)
        fit_once(model, Noise(0.5), start)
    assert len(walked) == 2


def test_one_that_came_to_no_rest_serves_the_same_noise_alone(
    model: Model, walked: list[Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = kept.fit
    monkeypatch.setattr(kept, "fit", lambda *args, **options: replace(counted(*args, **options), converged=False))
    start = fit(model, Noise()).x
    with keeping_fits():
        fit_once(model, Noise(), start)
        assert not fit_once(model, Noise(), start).converged
        assert len(walked) == 1
        fit_once(model, Noise(2.0), start)
    assert len(walked) == 2


def test_nothing_is_kept_outside_of_a_search(model: Model, walked: list[Fit]) -> None:
    start = fit(model, Noise()).x
    for _ in range(2):
        fit_once(model, Noise(), start)
    assert len(walked) == 2


def test_a_fit_that_came_to_no_rest_is_not_walked_again_under_a_narrower_noise(
    model: Model, walked: list[Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    start = fit(model, Noise()).x + 1e-4
    with using(replace(THRESHOLDS, step_still=0.0)), keeping_fits():
        assert not fit_once(model, Noise(), start).converged
        again = fit_once(model, Noise(0.5), start)
        assert len(walked) == 1
        fit_once(model, Noise(2.0), start)
        assert len(walked) == 2
        assert _same(again, fit(model, Noise(0.5), start))


def test_where_only_names_are_asked_for_no_fit_is_made_again_at_another_scale(
    model: Model, walked: list[Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    start = fit(model, Noise()).x + 1e-4
    with using(replace(THRESHOLDS, step_still=0.0)), keeping_fits():
        first = fit_once(model, Noise(), start, near=False)
        assert not first.converged
        with at_any_scale():
            others = [fit_once(model, Noise(scale), start, near=False) for scale in (0.5, 2.0)]
    assert len(walked) == 1
    assert all(_same(first, other) and other.noise.scale != 1 for other in others)


def test_small_fits_are_kept_with_their_arrays(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    start = fit(model, Noise()).x
    with keeping_fits():
        first = fit_once(model, Noise(), start)
        assert fit_once(model, Noise(2.0), start).J is first.J
        monkeypatch.setattr(kept, "_KEPT", 0)
        large = fit_once(model, Noise(), start + 1e-9)
        assert fit_once(model, Noise(), start + 1e-9).J is not large.J


def test_the_finer_places_of_a_step_are_the_same_effects_whenever_a_search_asks(model: Model) -> None:
    data = model.formulation.data
    step = next(e for e in catalogue(model.formulation).candidates if isinstance(e, ChangePoint))
    with keeping_fits():
        first, again = _finer(step, data), _finer(step, data)
    assert len(first) > 1
    assert all(one is other for one, other in zip(first, again, strict=True))
