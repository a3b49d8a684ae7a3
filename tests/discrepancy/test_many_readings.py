"""Very many readings are explained by shorter ways; they lead to what the long ones find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.fitting.fit import triangle
from calibench.discrepancy.thresholds import THRESHOLDS

pytestmark = pytest.mark.usefixtures("at_one_noise")


def test_blocks_fold_into_the_triangle_of_all_rows() -> None:
    A = np.random.default_rng(0).normal(size=(5000, 4)) * [1.0, 1e3, 1e-3, 1.0]
    R = triangle(A)
    assert np.allclose(R.T @ R, A.T @ A, rtol=1e-12, atol=1e-12)


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
