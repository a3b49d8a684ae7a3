"""A plan of readings on the nominal Orthoglide, before anything is measured: what `bench design` looks at."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.problems.orthoglide.plans import PlanName, named_plan


def planned(plan: PlanName, sigma: float = 0.01, repeats: int = 1) -> MeasuredData:
    """Return the deviations that a nominal machine shows on a named plan, without noise; `sigma` [mm] is stated.

    Each repeat reads its own Zero.
    """
    rows = [(r, repeat) for repeat in range(repeats) for r in named_plan(plan)]
    columns = {
        "leg": np.array([r.leg for r, _ in rows]),
        "direction": np.array([r.direction for r, _ in rows]),
        "posture": np.array([r.axis for r, _ in rows]),
        "gauge_position": np.array([r.gauge_position for r, _ in rows]),
        "level_mm": np.array([r.level_mm for r, _ in rows]),
        "pass": np.array([r.approach for r, _ in rows]),
        "payload_N": np.array([r.payload_N for r, _ in rows]),
        "repeat": np.array([float(repeat) for _, repeat in rows]),
        "deviation": np.zeros(len(rows)),
    }
    empty = MeasuredData(columns, "orthoglide", {"machine": "orthoglide", "sigma": sigma}, plan)
    model = Model(Orthoglide().formulate(empty))
    q = model.quantities(np.zeros(model.size))[1]
    read = np.asarray(model.formulation.constraints(q)[:, 0], dtype=np.float64)
    return empty.with_columns({"deviation": np.round(read, 9)})  # a parallel leg reads 0, not rounding
