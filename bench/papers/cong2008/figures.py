"""Figures of Cong et al. 2008 that need no runs: the gauge curve, and what measurement plans can tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from calibench import problems
from calibench.bench.papers.cong2008.gauge_points import gauge_points
from calibench.bench.report.shared.drawing import COLOURS, DASHES, STYLE, Drawing

_PLANS = (("line", 80.0), ("circle", 80.0), ("two_circles", 120.0), ("disc", 100.0))


def gauge() -> Drawing:
    """Draw Table 4's and Table 7's printed 12-parameter results on the gauge curve through the true machine.

    Each line is how far a parameter moves when the machine is turned by phi and scaled so that no reading changes.
    """
    points = gauge_points()
    with rc_context(STYLE):
        figure = Figure(figsize=(10.2, 4.9), layout="constrained")
        for axes, (key, table) in zip(figure.subplots(1, 2), points.groupby("table", sort=False), strict=True):
            _draw_gauge(axes, str(key), table)
        figure.suptitle(
            "The 12-parameter results of Cong et al. 2008 are points of a curve along which no reading changes",
            fontsize=10,
        )
    return figure, points


def _draw_gauge(axes: Any, key: str, table: pd.DataFrame) -> None:
    held = str(table["held"].iloc[0])
    problem = problems.full12(gauge=held)
    fitted = float(table["phi"].iloc[0])
    phi = np.linspace(-0.15 * fitted, 1.25 * fitted, 200)
    names = [p.name for p in problem.parameters]
    moved = np.array([problem.gauge_curve(angle) for angle in phi]) - problem.gauge_curve(0.0)
    true = dict(zip(names, problem.gauge_curve(0.0), strict=True))
    groups = {name: [name] for name in names if name[0] in "xy"}
    groups |= {"six link lengths": [n for n in names if n[0] == "l"]}
    groups |= {"offsets z x 244 mm": [n for n in names if n[0] == "z"]}
    for i, (label, members) in enumerate(groups.items()):
        colour = COLOURS[i]
        columns = [names.index(n) for n in members]
        arm = 244.0 if members[0].startswith("z") else 1.0
        axes.plot(
            1e3 * phi, arm * moved[:, columns].mean(axis=1), color=colour, linestyle=DASHES[i], lw=1.4, label=label
        )
        for _, row in table[table["parameter"].isin(members)].iterrows():
            axes.plot(
                1e3 * fitted, arm * (row["printed"] - true[row["parameter"]]), marker="x" if row["misprint"] else "o",
                ms=6, mfc=colour, mec="#C00000" if row["misprint"] else "white", mew=1.2 if row["misprint"] else 0.8,
            )  # fmt: skip
    sound = table[~table["misprint"] & ~table["parameter"].str.startswith("z")]
    axes.axvline(0, color="0.35", lw=0.8)
    axes.annotate("truth", (0, 0), (3, 4), xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=8)
    number = key.partition(".")[0].removeprefix("table")
    where = {"ya2": "section 3, y_a2 held", "xa2": "section 4, x_a2 held"}[held]
    axes.set(xlabel="gauge angle phi [mrad]", ylabel="parameter minus truth [mm]")
    axes.set_title(
        f"Table {number} ({where}): phi = {1e3 * fitted:.4g} mrad, scale {table['scale'].iloc[0]:.6f}\n"
        f"{len(sound)} lengths printed right lie within {sound['misfit_mm'].abs().max():.1g} mm of the curve",
        fontsize=9,
    )
    axes.plot([], [], "o", color="0.4", label="printed")
    axes.plot([], [], "x", color="#C00000", label="printed wrong (errata)")
    axes.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)


def plans(noise: float = 1e-4) -> Drawing:
    """Draw the singular values of `full11` for readings on a line, a circle, two circles and a disc (section 4.5).

    50 configurations each; the standard errors in the legend are the worst of a length at `noise` [rad a reading].
    """
    numbers = []
    with rc_context(STYLE):
        figure = Figure(figsize=(7.6, 3.9), layout="constrained")
        axes = figure.subplots()
        for i, (plan, radius) in enumerate(_PLANS):
            found = problems.identify(problems.make("full11", plan=plan, radius=radius), noise=noise)
            lengths = [float(e) for e, unit in zip(found.standard_errors, found.units, strict=True) if unit == "mm"]
            values = found.singular_values / found.singular_values[0]
            label = (
                f"{plan.replace('_', ' ')} R{radius:g}: condition {found.condition:.1e}, worst {max(lengths):.2g} mm"
            )
            axes.plot(
                range(1, len(values) + 1), values, marker="o", ms=4, color=COLOURS[i], linestyle=DASHES[i], label=label
            )
            numbers.append(
                pd.DataFrame(
                    {
                        "plan": plan, "radius": radius, "index": range(1, len(values) + 1), "singular_value": values,
                        "condition": found.condition, "worst_length_error_mm": max(lengths), "noise_rad": noise,
                    }
                )
            )  # fmt: skip
        axes.set(
            yscale="log", xlabel="singular value", ylabel="relative to the largest", xticks=range(1, 12),
            title="What 50 readings can tell of 11 parameters: on a circle rather than a line, but not on one circle",
        )  # fmt: skip
        axes.title.set_fontsize(10)
        axes.legend(
            fontsize=8, loc="lower left", alignment="left",
            title=f"condition, and worst standard error of a length at {noise:g} rad",
        )  # fmt: skip
    return figure, pd.concat(numbers, ignore_index=True)
