"""Where a model and measured data disagree, which effect is missing, and what is left when it is added.

An effect is a value: the identity at zero coefficients. "Add it to the model" is `model.with_effects(effect)`, a longer
parameter vector over the same data, and the gap is measured by the same residual. Of the rooms `explain` is the table
of contents; `Constraints`, `Sensor`, `EffectFamily` and `LinearEffect` are what a user's own machine and effect are
written with (`Cause` and `Linear` are the names they had first).
"""

from __future__ import annotations

from discrepancy import machines as machines
from discrepancy.explain import explain
from discrepancy.model.constraints import Constraints
from discrepancy.model.data import DataError, MeasuredData
from discrepancy.model.description import Description
from discrepancy.model.effect import Effect
from discrepancy.model.family import Cause, EffectFamily, needs, number
from discrepancy.model.linear import Linear, LinearEffect
from discrepancy.model.machine import Formulation, Machine
from discrepancy.model.model import Model
from discrepancy.model.sensor import Sensor
from discrepancy.registries import describe
from discrepancy.report import Report
from discrepancy.thresholds import THRESHOLDS, Thresholds

__all__ = [
    "THRESHOLDS", "Cause", "Constraints", "DataError", "Description", "Effect", "EffectFamily", "Formulation",
    "Linear", "LinearEffect", "Machine", "MeasuredData", "Model", "Report", "Sensor", "Thresholds", "describe",
    "explain", "needs", "number",
]  # fmt: skip
