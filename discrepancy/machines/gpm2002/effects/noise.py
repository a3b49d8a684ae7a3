"""Noise other than stated, as the catalogue lists it. It changes no mean, so `discrepancy.noise.laws` tests for it."""

from __future__ import annotations

from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.family import EffectFamily
from calibench.discrepancy.model.machine import Formulation

_JOINTS = ("joint 1", "joint 2", "joint 3")


def _none(formulation: Formulation, target: str) -> tuple[Effect, ...]:
    return ()


quantisation = EffectFamily(
    "quantisation", "gpm2002", "An encoder is read in steps coarser than stated", "enc_i = step * whole number",
    "noise", ("enc_{i}",), "rad", _JOINTS, _none,
).enter()  # fmt: skip
outlier = EffectFamily(
    "outlier", "gpm2002", "Some readings of one encoder are far off", "enc_i += spread * N(0, 1) on few readings",
    "noise", ("enc_{i}",), "rad", _JOINTS, _none,
).enter()  # fmt: skip
heavy_tails = EffectFamily(
    "heavy_tails", "gpm2002", "The noise of all readings has heavier tails than a Gaussian",
    "excess kurtosis of the whitened residuals", "noise", (), "1", ("all",), _none,
).enter()  # fmt: skip
