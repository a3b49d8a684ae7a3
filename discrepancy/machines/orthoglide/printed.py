"""The five sets the chapter prints, as measured data: exp1, exp2, exp2_t1, exp3_t1, exp3_t2."""

from __future__ import annotations

from typing import get_args

import numpy as np

from calibench.core.options import suggest
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.problems import constants
from calibench.problems.orthoglide.kinematics import PAPER
from calibench.problems.orthoglide.measured import SetName, measured

_STEP_NOTE = (
    "the chapter prints no times: the path Zero, Max, Min, Zero of section 4.1 stands for them, a step of t_s "
    "a move, so Max and Zero were reached moving towards +, Min towards -"
)


def names() -> tuple[str, ...]:
    """Return the names of the printed sets."""
    return get_args(SetName)


def printed(name: str) -> MeasuredData:
    """Return a printed set: `sigma` is section 4.1's dissimilarity of three readings as the noise of their mean.

    The dissimilarity is an upper limit of .02 mm; the spread of three readings is 1.69 sigma on average, so sigma of
    one reading is at most about .012 mm: section 3.4's .01 mm is taken.
    """
    for choice in get_args(SetName):
        if choice == name:
            plan, deviations = measured(choice)
            break
    else:
        raise DataError(f"data={name}: {suggest(name, names())}")
    ends = np.array([r.level_mm > 0 for r in plan])
    compared = np.array([r.against_mm != 0 for r in plan])  # Table 1: Max minus Min
    columns = {
        "leg": np.array([r.leg for r in plan]),
        "direction": np.array([r.direction for r in plan]),
        "posture": np.array([r.axis for r in plan]),
        "gauge_position": np.array([r.gauge_position for r in plan]),
        "level_mm": np.array([r.level_mm for r in plan]),
        "against_mm": np.array([r.against_mm for r in plan]),
        "pass": np.where(ends, "fwd", "rev"),
        "zero_pass": np.where(compared, "rev", "fwd"),
        "payload_N": np.zeros(len(plan)),
        "repeat": np.zeros(len(plan)),
        "t_s": np.where(ends, 1.0, 2.0),
        "zero_t_s": np.where(compared, 2.0, 0.0),
        "split": np.full(len(plan), "train"),
        "deviation": deviations,
    }
    sigma = constants.column(PAPER, "text.section34")["sigma"]
    metadata = {"sigma": sigma, "free": "rho", "machine": "orthoglide"}
    return MeasuredData(columns, "orthoglide", metadata, name, (_STEP_NOTE,))
