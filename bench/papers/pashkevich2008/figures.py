"""The figure of Pashkevich et al. 2008 that needs no runs: what calibration leaves of the measured deviations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from calibench import problems
from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing

DATA = {"exp2": "Experiment 2", "exp3_t2": "Experiment 3 (Table 2)"}


def orthoglide_residuals(data_sets: Sequence[str] = tuple(DATA)) -> Drawing:
    """Draw the Orthoglide's measured deviations before and after calibration with three parameter sets, a panel a set.

    Experiments 2 and 3 of Table 2 of Pashkevich et al. 2008; `left` is the deviation that the fitted model leaves.
    """
    rows = []
    for data in data_sets:
        for free in ("full", "rho", "L"):
            p: Any = problems.make("orthoglide6", data=data, free=free)
            before, left = p.deviations, -p.residuals(p.best)  # residuals are modelled minus measured
            for reading, old, new in zip(p.plan, before, left, strict=True):
                rows.append({"data": data, "free": free, "row": reading.label, "before": old, "left": new})
    table = pd.DataFrame(rows)
    with rc_context(STYLE):
        figure = Figure(figsize=(10.4, 0.2 + 2.6 * len(data_sets)), layout="constrained")
        for axes, data in zip(np.atleast_1d(figure.subplots(len(data_sets), 1)), data_sets, strict=True):
            mine = table[table["data"] == data]
            names = list(dict.fromkeys(mine["row"]))
            place = np.arange(len(names))
            first = mine[mine["free"] == "full"]
            bars = [("before", first["before"], "0.75", "")]
            for colour, hatch, free in zip(COLOURS, ("", "////", "...."), ("full", "rho", "L"), strict=False):
                bars.append((f"after {free}", mine.loc[mine["free"] == free, "left"], colour, hatch))
            for k, (label, values, colour, hatch) in enumerate(bars):
                rms = float(np.sqrt((values**2).mean()))
                axes.bar(
                    place + 0.2 * (k - 1.5), values, 0.2, color=colour, hatch=hatch, edgecolor="white", linewidth=0,
                    label=f"{label}: rms {rms:.3f} mm",
                )  # fmt: skip
            axes.axhline(0, color="0.3", lw=0.6)
            axes.set_xticks(place, names, fontsize=8)
            axes.set(ylabel="deviation [mm]", title=DATA[data])
            axes.legend(fontsize=7.5, ncols=4, loc="lower center", bbox_to_anchor=(0.5, -0.28))
    return figure, table
