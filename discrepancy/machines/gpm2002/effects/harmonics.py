"""Angle errors of an encoder that repeat with its turn: an eccentric disc, an oval one, teeth; and their common class.

The physics is that of any rotary joint; the tooth numbers are read from what is stated of the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibench.discrepancy.effects.general import harmonics
from calibench.discrepancy.effects.general.recipe import Built, Recipe
from calibench.discrepancy.machines.gpm2002.roles import JOINTS, teeth_of
from calibench.discrepancy.model.effect import NotTestable
from calibench.discrepancy.model.family import EffectFamily, needs, number
from calibench.discrepancy.model.machine import Formulation


def _cyclic(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    needs(formulation.data, f"enc_{number(target)}")
    if not teeth_of(formulation.data.metadata, number(target)):
        raise NotTestable("needs metadata tooth_numbers", ("metadata tooth_numbers",), missing=True)
    return harmonics.cyclic.make(family, formulation, target)


def _tooth(metadata: Mapping[str, Any], target: str) -> float:
    """Return the angle of one tooth [rad]; 0 where the tooth number is not stated."""
    teeth = teeth_of(metadata, number(target))
    return float(2 * np.pi / teeth) if teeth else 0.0


eccentricity = harmonics.eccentricity.enter(
    "gpm2002", JOINTS, cause="The disc of an encoder sits off its axis",
    formula="enc_i += arcsin(a cos enc_i + b sin enc_i)", columns=("enc_{i}",), unit="rad",
)  # fmt: skip
second_harmonic = harmonics.second_harmonic.enter(
    "gpm2002", JOINTS, cause="The disc of an encoder is oval, or tilted",
    formula="enc_i += atan2(u, 1 - v), u = a cos 2 enc_i + b sin 2 enc_i, v = b cos 2 enc_i - a sin 2 enc_i",
    columns=("enc_{i}",), unit="rad",
)  # fmt: skip
angle_error = harmonics.angle_error.enter(
    "gpm2002", JOINTS, formula="enc_i += sum over k = 1, 2, 3 of a_k cos k enc_i + b_k sin k enc_i",
    columns=("enc_{i}",), unit="rad",
)  # fmt: skip
cyclic = Recipe(harmonics.cyclic.words, _cyclic).enter(
    "gpm2002", JOINTS, formula="enc_i += sum over k = N, or N and 2 N, of a_k cos k enc_i + b_k sin k enc_i",
    columns=("enc_{i}", "metadata.tooth_numbers"), unit="rad", period=_tooth,
)  # fmt: skip
