"""Scale of an encoder, or a gear ratio that is not the stated one: the joint turns by (1 + k) times what is read.

The size is limited to what an encoder on its own shaft can have, because calibration absorbs most of a larger one.
"""

from __future__ import annotations

from dataclasses import replace

from calibench.discrepancy.effects.general import joints
from calibench.discrepancy.effects.general.recipe import Built, Recipe
from calibench.discrepancy.machines.gpm2002.roles import JOINTS
from calibench.discrepancy.model.family import EffectFamily
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.thresholds import thresholds


def _limited(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    built = joints.scale.make(family, formulation, target)
    assert isinstance(built, tuple)
    return tuple(replace(effect, largest=thresholds().largest_ratio) for effect in built)  # type: ignore[type-var]


gear = Recipe(joints.scale.words, _limited).enter(
    "gpm2002", JOINTS, cause="A gear ratio, or the scale of an encoder, is not the stated one",
    formula="enc_i += k enc_i", columns=("enc_{i}",), label="gear-ratio error",
)  # fmt: skip
