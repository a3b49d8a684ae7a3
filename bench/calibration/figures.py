"""The drawings of a calibration, each with its numbers: errors before and after, over the workspace and each joint."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing
from calibench.calibration.calibrate import Calibration, OverJoint

_BEFORE, _AFTER = COLOURS[1], COLOURS[0]


def calibration_figures(answer: Calibration) -> Iterator[tuple[str, Drawing]]:
    """Yield (name, drawing) of one calibration."""
    drawn = answer.drawn

    # the share of poses below each error, before and after
    table = pd.DataFrame({"before": drawn.before, "after": drawn.after}).dropna()
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 2.9), layout="constrained")
        axes = figure.subplots()
        share = 100 * np.arange(1, len(table) + 1) / max(len(table), 1)
        for name, colour, dash in (("before", _BEFORE, "--"), ("after", _AFTER, "-")):
            axes.step(np.sort(table[name]), share, where="post", color=colour, ls=dash, lw=1.6, label=name)
        axes.set(xlabel="error of a pose that was not fitted [mm]", ylabel="poses with less [%]", ylim=(0, 100))
        axes.set_xlim(0, None)
        axes.legend(loc="lower right")
    yield "errors", (figure, table)

    # the error from above, before and after, in one scale of colours
    table = pd.DataFrame(drawn.position, columns=["x", "y", "z"])
    table = table.assign(before=drawn.before, after=drawn.after).dropna()
    top = float(table["before"].quantile(0.98)) if len(table) else 1.0
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.1), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, 2, sharex=True, sharey=True))
        for axes, name in zip(panels, ("before", "after")):
            many = len(table) > 800
            dots = axes.scatter(
                table["x"], table["y"], c=table[name], s=9, cmap="cividis_r", vmin=0, vmax=top, rasterized=many
            )
            axes.set_title(name, fontsize=9, loc="left")
            axes.set(xlabel="x in the base [mm]", aspect="equal")
        panels[0].set_ylabel("y in the base [mm]")
        bar = figure.colorbar(dots, ax=list(panels), shrink=0.9, aspect=20)
        bar.set_label("error [mm]", fontsize=8)
    yield "workspace", (figure, table)
    if answer.over_joints:
        yield "joints", joint_chart(answer.over_joints)


def joint_chart(over_joints: Sequence[OverJoint]) -> Drawing:
    """Draw the rms error over the angle or the way of each joint, before and after."""
    table = pd.DataFrame([asdict(one) for one in over_joints])
    with rc_context(STYLE):
        figure = Figure(figsize=joints_size(table), layout="constrained")
        axes = figure.subplots()
        draw_joints(axes, table)
        figure.legend(loc="outside upper right", ncols=2)
    return figure, table


def joints_size(table: pd.DataFrame) -> tuple[float, float]:
    """Return width and height of the drawing of all joints [inches]."""
    return max(4.6, 0.8 + 1.05 * table["joint"].nunique()), 3.0


def draw_joints(axes: Axes, table: pd.DataFrame) -> None:
    """Draw the rows of `OverJoint`: the joints side by side, each from its least to its largest place."""
    names = list(dict.fromkeys(table["joint"]))
    labels = []
    for k, name in enumerate(names):
        mine = table[table["joint"] == name]
        low, high = mine["low"].min(), mine["high"].max()
        across = k + 0.08 + 0.84 * (mine["at"] - low) / max(high - low, 1e-300)
        for when, colour, line in (("before", _BEFORE, "--s"), ("after", _AFTER, "-o")):
            axes.plot(across, mine[when], line, color=colour, ms=3, lw=1.2, label=None if k else when)
        if k:
            axes.axvline(k, color="0.8", lw=0.8)
        labels.append(f"{name}\n{low:.0f} to {high:.0f} {mine['unit'].iloc[0]}")
    axes.set_xticks(np.arange(len(names)) + 0.5, labels, fontsize=7.5)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="x", visible=False)
    axes.set(xlim=(0, len(names)), ylabel="rms error [mm]")
    axes.set_ylim(bottom=0)
