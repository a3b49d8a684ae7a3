"""Where a model and measured data disagree, which effect is missing, and what is left when it is added.

An effect is a value: the identity at zero coefficients. "Add it to the model" is `model.with_effects(effect)`, a longer
parameter vector over the same data, and the gap is measured by the same residual.
"""

from __future__ import annotations

from discrepancy.data import DataError, MeasuredData
from discrepancy.explain import explain
from discrepancy.model import Model
from discrepancy.report import Report

__all__ = ["DataError", "MeasuredData", "Model", "Report", "explain"]
