"""Noise other than stated: steps are read off the values, outliers off repeats and residuals; plain noise has none."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.discrepancy import machines
from calibench.discrepancy.design.detectability import WhitenedDesign
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.model.measured import MeasuredData, blamable
from calibench.discrepancy.noise.laws import (
    NoiseFinding,
    heavy_tails_in,
    lattice,
    mixture,
    outliers_of,
    quantisation_of,
)
from calibench.problems.base import Array

SIGMA = 5e-5


def read(data: MeasuredData, error: Array) -> MeasuredData:
    """Return the data with reading errors `error`, (n, 3), rad."""
    return data.with_columns({f"enc_{i}": data[f"enc_{i}"] + error[:, i - 1] for i in (1, 2, 3)})


def laws(data: MeasuredData) -> tuple[NoiseFinding, ...]:
    """Return the laws found in the residuals of one step from the truth, which is the start; the largest gain first."""
    view = WhitenedDesign(machines.make("gpm2002").formulate(data))
    closure = view.formulation
    r = view.white(closure.constraints(view.q))
    r = r - view.absorbed @ (view.absorbed.T @ r)
    n, c = closure.constraints(view.q).shape
    signatures = {
        name: view.white(view.slopes[name] * closure.sigma[name]).reshape(n, c)
        for name in ("enc_1", "enc_2", "enc_3")
    }  # fmt: skip
    r = r.reshape(n, c)
    found = [heavy_tails_in(closure, r)]
    for sensor in blamable(closure.sensors):
        found.append(outliers_of(closure, sensor, r, signatures[sensor.column]))
        found.append(quantisation_of(closure, sensor, r, signatures[sensor.column]))
    return tuple(sorted((f for f in found if f.gain > 0), key=lambda f: -f.gain))


@pytest.mark.parametrize("step", [1e-4, 3.7e-4])
@pytest.mark.parametrize("n", [60, 2000])
def test_a_lattice_is_read_off_the_values(n: int, step: float) -> None:
    rng = np.random.default_rng(n)
    values = np.round(rng.uniform(-0.5, 0.5, n) / step) * step + 0.1234
    assert lattice(values, SIGMA) == pytest.approx(step, rel=1e-6)
    assert lattice(np.round(values, 8), SIGMA) == pytest.approx(step, rel=1e-4)  # printed with eight digits


def test_a_lattice_is_found_under_the_finer_one_of_the_recording() -> None:
    rng = np.random.default_rng(6)
    step, resolution = 5.75e-4, 1.2e-5
    values = np.round(rng.uniform(-0.4, 0.4, 90) / step) * step
    recorded = np.round(np.concatenate([values, values + step]) / resolution) * resolution
    assert lattice(recorded, SIGMA) == pytest.approx(step, rel=1e-3)


def test_values_on_no_lattice_have_no_step() -> None:
    rng = np.random.default_rng(0)
    for n in (8, 60, 2000):
        assert lattice(rng.uniform(-0.5, 0.5, n), SIGMA) == 0.0
    assert lattice(np.round(rng.uniform(-0.5, 0.5, 400), 6), SIGMA) == 0.0  # finer than the noise: of no account
    assert lattice(np.repeat(1.0, 50), SIGMA) == 0.0


@pytest.mark.parametrize("tracked", [False, True])
def test_plain_noise_breaks_no_law(tracked: bool) -> None:
    for seed in range(4):
        data = planned(n=60, tracked=tracked)
        errors = SIGMA * np.random.default_rng(seed).normal(size=(len(data), 3))
        noisy = read(data, errors)
        if tracked:
            rng = np.random.default_rng(100 + seed)
            noisy = noisy.with_columns({c: data[c] + 0.02 * rng.normal(size=len(data)) for c in "xy"})
        for found in laws(noisy):
            assert found.gain < 2 * np.log(len(data)), found.family  # less than two numbers cost


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_coarse_steps_of_one_encoder_are_found(joint: int) -> None:
    data = planned(n=60)
    noisy = read(data, SIGMA * np.random.default_rng(joint).normal(size=(len(data), 3)))
    step = 12 * SIGMA
    coarse = noisy.with_columns({f"enc_{joint}": np.round(noisy[f"enc_{joint}"] / step) * step})
    steps = [f for f in laws(coarse) if f.family == "quantisation"]
    assert [f.target for f in steps] == [f"joint {joint}"]
    assert steps[0].amplitude == pytest.approx(step, rel=1e-6)
    assert steps[0].gain > 20
    assert steps[0].extra[f"enc_{joint}"][0] == pytest.approx(step**2 / 12)


def test_steps_that_are_stated_are_no_finding() -> None:
    data = planned(n=60)
    data = read(data, SIGMA * np.random.default_rng(2).normal(size=(len(data), 3)))
    step = 8 * SIGMA
    coarse = data.with_columns({"enc_1": np.round(data["enc_1"] / step) * step})
    stated = MeasuredData(coarse.columns, data.machine, {**data.metadata, "encoder_lsb": step}, data.name)
    assert "quantisation" in {f.family for f in laws(coarse)}
    assert "quantisation" not in {f.family for f in laws(stated)}


@pytest.mark.parametrize("tracked", [False, True])
@pytest.mark.parametrize("joint", [1, 2, 3])
def test_outlying_readings_are_blamed_on_their_encoder(joint: int, tracked: bool) -> None:
    data, rng = planned(n=60, tracked=tracked), np.random.default_rng(joint)
    errors = SIGMA * rng.normal(size=(len(data), 3))
    hit = rng.choice(len(data), 8, replace=False)
    errors[hit, joint - 1] += 25 * SIGMA * rng.choice([-1, 1], 8)
    found = [f for f in laws(read(data, errors)) if f.family == "outlier"]
    assert found[0].target == f"joint {joint}"
    assert found[0].gain > 100
    assert set(np.argsort(found[0].weights)[-6:]) <= set(hit.tolist())
    assert all(f.gain < found[0].gain - 6 for f in found[1:])


def test_heavy_tails_of_all_encoders_are_found() -> None:
    data, rng = planned(n=90), np.random.default_rng(8)
    errors = SIGMA * rng.standard_t(2.2, size=(len(data), 3))
    found = laws(read(data, errors))
    tails = next(f for f in found if f.family == "heavy_tails")
    assert tails.gain > 20
    assert tails.amplitude > 3


def test_a_mixture_finds_its_part_and_its_spread() -> None:
    rng = np.random.default_rng(5)
    r = rng.normal(size=4000) * np.where(rng.random(4000) < 0.05, np.sqrt(1 + 10**2), 1.0)
    found = mixture(r**2, np.ones(4000))
    assert found.epsilon == pytest.approx(0.05, abs=0.02)
    assert found.tau == pytest.approx(10, rel=0.4)


def test_the_size_of_each_law_is_told_with_an_interval_that_holds_it() -> None:
    """95 % intervals: of twelve each, all but one or two must hold the truth."""
    held = {"outlier": 0, "quantisation": 0, "heavy_tails": 0}
    for seed in range(12):
        rng, data = np.random.default_rng(seed), planned(n=90)
        noise = SIGMA * rng.normal(size=(len(data), 3))
        struck = np.zeros_like(noise)
        struck[:, 1] = (rng.random(len(data)) < 0.08) * rng.normal(size=len(data))
        spread, step = 20 * SIGMA, 12 * SIGMA
        coarse = read(data, noise)
        coarse = coarse.with_columns({"enc_1": np.round(coarse["enc_1"] / step) * step})
        blamed = {f.family: f for f in laws(read(data, noise + spread * struck)) if f.target in ("joint 2", "all")}
        steps = next(f for f in laws(coarse) if f.family == "quantisation")
        held["outlier"] += blamed["outlier"].ci95[0] <= spread <= blamed["outlier"].ci95[1]
        held["quantisation"] += steps.ci95[0] - 1e-12 <= step <= steps.ci95[1] + 1e-12
        tails = blamed["heavy_tails"]
        held["heavy_tails"] += tails.ci95[0] <= tails.amplitude <= tails.ci95[1]
        assert 0 <= steps.ci95[1] - steps.ci95[0] < 1e-3 * step
    assert min(held.values()) >= 10, held
