"""Forms of the simulated Orthoglide that are off: by the share that is asked for, of the effect that was asked for."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.orthoglide import OFF, TARGETS, Fault, Wave, case, quiet


def _plan(family: str) -> str:
    return "loaded" if family == "gravity" else "cross"


_SLOW = pytest.mark.slow  # its machine remembers: simulated step by step


@pytest.mark.slow
@pytest.mark.parametrize("family", [pytest.param(f, marks=_SLOW if f == "backlash" else ()) for f in TARGETS])
def test_a_bent_form_is_seen_as_large_as_a_straight_one_and_is_another(family: str) -> None:
    straight, bent = (case(3, family, lam=2.0, plan=_plan(family), bent=b) for b in (False, True))
    assert bent.truth["lambda"] == pytest.approx(straight.truth["lambda"], rel=0.02)
    assert OFF[0] <= bent.truth["off"] <= OFF[1]
    assert bent.truth["target"] == straight.truth["target"]
    assert np.abs(bent.columns["deviation"] - straight.columns["deviation"]).max() > 1e-4


def test_a_form_is_off_by_its_share() -> None:
    turn = np.linspace(-np.pi, np.pi, 1000, endpoint=False)
    for waves in (1, 2, 3):
        off = Wave(0.1, waves, 0.7)(turn) - 1
        assert np.sqrt(np.mean(off**2)) == pytest.approx(0.1, rel=1e-6)


def test_a_form_that_is_not_off_changes_nothing() -> None:
    skew = np.zeros((3, 3))
    skew[0, 1] = 0.5
    plain, same = (quiet(2, Fault(skew=skew, form=form)).columns["deviation"] for form in (Wave(), Wave(0.0, 3, 1.0)))
    assert np.array_equal(plain, same)
