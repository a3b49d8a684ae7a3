"""Find where a model and measured data disagree, name the missing effect, add it, and measure what is left.

An effect is a value: the identity at zero coefficients. "Add it to the model" is `model.with_effects(effect)`, a longer
parameter vector over the same data, and the gap is measured by the same residual. Begin to read with `explain`: it
calls the other packages step by step. `Constraints`, `Sensor`, `EffectFamily` and `LinearEffect` serve to write a
machine and an effect of one's own (`Cause` and `Linear` are their former names).
"""

from __future__ import annotations

from calibench.core.lazy import public_names
from calibench.discrepancy import machines as machines
from calibench.discrepancy.explain import explain
from calibench.discrepancy.model.effect import Cause, Effect, EffectFamily, Linear, LinearEffect, needs, number
from calibench.discrepancy.model.formulations import Blocks, Constraints, Predicted
from calibench.discrepancy.model.machine import Description, Formulation, Machine
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Instrument, Joint, Length, Roles
from calibench.discrepancy.prediction import Prediction
from calibench.discrepancy.registries import describe
from calibench.discrepancy.report import Report
from calibench.discrepancy.thresholds import THRESHOLDS, Thresholds

__all__ = [
    "THRESHOLDS", "Blocks", "Cause", "Constraints", "DataError", "Description", "Effect", "EffectFamily", "Formulation",
    "Instrument", "Joint", "Length", "Linear", "LinearEffect", "Machine", "MeasuredData", "Model", "Predicted",
    "Prediction", "Report", "Roles", "Sensor", "Thresholds", "describe", "explain", "needs", "number",
]  # fmt: skip

__dir__ = public_names(__all__)
if __name__ == "discrepancy":  # a short name, in a checkout: public names only, as a module has its whole name alone
    __path__ = []
