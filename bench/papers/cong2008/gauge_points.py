"""The printed 12-parameter columns of Cong et al. 2008 as points of the gauge curve, as a table to be drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from calibench import problems
from calibench.problems import constants


def gauge_points() -> pd.DataFrame:
    """Return the printed 12-parameter columns of Tables 4 and 7 on their gauge curve, a row for each parameter.

    phi is fitted over the cells that are printed right; columns: table, held, phi, scale, parameter, printed, read,
    curve, misfit_mm (angles times a link length), misprint.
    """
    from scipy.optimize import least_squares

    rows = []
    cases = (("table4.j3_12", problems.full12(gauge="ya2")), ("table7.de_j3", problems.full12(gauge="xa2")))
    for key, problem in cases:
        column = constants.column("cong2008", key)
        names = [p.name for p in problem.parameters]
        arms = np.array([244.0 if p.unit == "rad" else 1.0 for p in problem.parameters])
        read = np.array([column[name] for name in names])
        sound = np.array([not column.entries[name].is_misprint for name in names])
        fit = sound & np.array([p.unit == "mm" for p in problem.parameters])  # angles are printed to 1e-4 only
        curve = problem.gauge_curve

        def misfit(phi: Any, curve: Any = curve, read: Any = read, fit: Any = fit) -> Any:
            return (curve(float(phi[0])) - read)[fit]

        phi = float(least_squares(misfit, [0.0], method="lm", xtol=1e-15, ftol=1e-15).x[0])
        on_curve = curve(phi)
        scale = float(on_curve[names.index("lb1")] / curve(0.0)[names.index("lb1")])
        for i, name in enumerate(names):
            entry = column.entries[name]
            rows.append(
                {
                    "table": key, "held": problem.options["gauge"], "phi": phi, "scale": scale, "parameter": name,
                    "printed": entry.printed, "read": entry.value, "curve": float(on_curve[i]),
                    "misfit_mm": float((read[i] - on_curve[i]) * arms[i]), "misprint": entry.is_misprint,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)
