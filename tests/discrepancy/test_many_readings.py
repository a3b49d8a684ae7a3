"""Very many readings are explained by shorter ways; they lead to what the long ones find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit, step_by_sums, triangle
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.search.select import Option, _in_order
from calibench.discrepancy.thresholds import THRESHOLDS

pytestmark = pytest.mark.usefixtures("at_one_noise")


def test_blocks_fold_into_the_triangle_of_all_rows() -> None:
    A = np.random.default_rng(0).normal(size=(5000, 4)) * [1.0, 1e3, 1e-3, 1.0]
    R = triangle(A)
    assert np.allclose(R.T @ R, A.T @ A, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("t_degrees", [4.0, np.inf])
def test_a_step_by_sums_is_the_step_by_rows(damping: float, t_degrees: float) -> None:
    rng, noise = np.random.default_rng(2), Noise(scale=1.7, t_degrees=t_degrees)
    J, r = (
        rng.normal(size=(900, 5)) @ np.triu(rng.normal(size=(5, 5)) + 3 * np.eye(5)) * 10.0 ** np.arange(5),
        rng.normal(size=900),
    )
    root = np.sqrt(noise.weights(r))
    A, b = J * root[:, None], -root * r
    size = np.linalg.norm(A, axis=0)
    rows = np.vstack([A / size, np.sqrt(damping) * np.eye(5)])
    expected = np.linalg.lstsq(rows, np.concatenate([b, np.zeros(5)]), rcond=None)[0] / size
    by_sums = step_by_sums(r, J, root, damping)
    assert by_sums is not None
    assert np.allclose(by_sums, expected, rtol=1e-9, atol=0)


def test_columns_that_are_nearly_alike_take_no_step_by_sums() -> None:
    rng = np.random.default_rng(3)
    first = rng.normal(size=900)
    J = np.column_stack([first, first + 1e-6 * rng.normal(size=900)])
    assert step_by_sums(rng.normal(size=900), J, np.ones(900), 0.0) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("xy", "noise"),
    [
        pytest.param(True, "gauss", marks=pytest.mark.slow),
        (False, "t3"),
        pytest.param(True, "ar1", marks=pytest.mark.slow),
    ],
)
def test_shorter_ways_find_the_same(xy: bool, noise: str) -> None:
    blind = case(6, kind="one", family="compliance", xy=xy, lam=1.5, noise=noise, poses=700)  # type: ignore[arg-type]
    data = MeasuredData(blind.columns, "gpm2002", blind.metadata, "many")
    long = explain("gpm2002", data)
    short = explain("gpm2002", data, thresholds=replace(THRESHOLDS, many_readings=2000, part_readings=1000))
    assert short.verdict == long.verdict
    assert [[rival.effect for rival in f.set] for f in short.findings] == [
        [rival.effect for rival in f.set] for f in long.findings
    ]
    assert [f.gain for f in short.findings] == pytest.approx([f.gain for f in long.findings], rel=1e-6)
    assert short.gap.train_after == pytest.approx(long.gap.train_after, rel=1e-6)


def test_rounding_does_not_choose_which_of_two_twins_leads_a_set() -> None:
    blind = case(3, kind="one", family="compliance", xy=True, lam=2.0, noise="gauss", poses=40)
    at = fit(Model(machines.make("gpm2002").formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata))), Noise())
    names = {name_of(e): e for e in catalogue(at.model.formulation).candidates}
    twins = [names["compliance joint 3"], names["proximal_bending leg 3"]]
    leads = {
        _in_order([Option(e, at, 500.0 + wrong * sign, 1) for e, sign in zip(twins, signs)])[0].name
        for wrong in (0.0, 1e-10)
        for signs in ((1, -1), (-1, 1))
    }
    assert leads == {"compliance joint 3"}
