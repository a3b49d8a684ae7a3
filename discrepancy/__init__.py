"""Find where a model and measured data disagree, name the missing effect, add it, and measure what is left.

An effect is a value: the identity at zero coefficients. "Add it to the model" is `model.with_effects(effect)`, a longer
parameter vector over the same data, and the gap is measured by the same residual. Begin to read with `procedure`: its
`explain` calls the other packages step by step. `Constraints`, `Sensor`, `EffectFamily` and `LinearEffect` serve to
write a machine and an effect of one's own (`Cause` and `Linear` are their former names).
"""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names

if TYPE_CHECKING:
    from calibench.discrepancy import machines as machines
    from calibench.discrepancy.across import carried
    from calibench.discrepancy.model.effect import Cause, Effect, EffectFamily, Linear, LinearEffect, needs, number
    from calibench.discrepancy.model.formulations import Blocks, Constraints, Predicted
    from calibench.discrepancy.model.machine import Description, Formulation, Machine
    from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor
    from calibench.discrepancy.model.model import Model
    from calibench.discrepancy.model.roles import Instrument, Joint, Length, Roles
    from calibench.discrepancy.procedure import explain
    from calibench.discrepancy.registries import describe
    from calibench.discrepancy.report import Prediction, Report
    from calibench.discrepancy.thresholds import THRESHOLDS, Thresholds

__all__ = [
    "THRESHOLDS", "Blocks", "Cause", "Constraints", "DataError", "Description", "Effect", "EffectFamily", "Formulation",
    "Instrument", "Joint", "Length", "Linear", "LinearEffect", "Machine", "MeasuredData", "Model", "Predicted",
    "Prediction", "Report", "Roles", "Sensor", "Thresholds", "carried", "describe", "explain", "needs", "number",
]  # fmt: skip

_NAMES = {
    "across": ("carried",),
    "model.effect": ("Cause", "Effect", "EffectFamily", "Linear", "LinearEffect", "needs", "number"),
    "model.formulations": ("Blocks", "Constraints", "Predicted"),
    "model.machine": ("Description", "Formulation", "Machine"),
    "model.measured": ("DataError", "MeasuredData", "Sensor"),
    "model.model": ("Model",),
    "model.roles": ("Instrument", "Joint", "Length", "Roles"),
    "procedure": ("explain",),
    "registries": ("describe",),
    "report": ("Prediction", "Report"),
    "thresholds": ("THRESHOLDS", "Thresholds"),
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}
_MODULES = ("checks", "design", "diagnostics", "effects", "fitting", "machines", "model", "noise", "search")

__getattr__ = loader("calibench.discrepancy", _HOMES, _MODULES)
__dir__ = public_names(__all__)
if __name__ == "discrepancy":  # a short name, in a checkout: public names only, as a module has its whole name alone
    __path__ = []
