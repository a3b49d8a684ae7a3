"""The drawings of a calibration, each with its numbers: errors before and after, over the workspace and each joint."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from calibench.bench.calibration.report.result import Calibration, Drawn
from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing

_BEFORE, _AFTER = COLOURS[1], COLOURS[0]
_BINS = 12
_ACROSS = 3  # joints in a row


def calibration_figures(found: Calibration) -> Iterator[tuple[str, Drawing]]:
    """Yield (name, drawing) of one calibration."""
    if found.drawn is not None:
        yield "errors", error_chart(found.drawn)
        yield "workspace", workspace_chart(found.drawn)
        yield "joints", joint_chart(found.drawn)


def error_chart(drawn: Drawn) -> Drawing:
    """Draw the share of poses below each error, before and after."""
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
    return figure, table


def workspace_chart(drawn: Drawn) -> Drawing:
    """Draw the error from above, before and after, in one scale of colours."""
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
    return figure, table


def joint_chart(drawn: Drawn) -> Drawing:
    """Draw the rms error over the angle or the way of each joint, before and after."""
    rows = -(-len(drawn.names) // _ACROSS)
    found = []
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 0.4 + 1.75 * rows), layout="constrained")
        panels = np.atleast_1d(figure.subplots(rows, min(_ACROSS, len(drawn.names)), sharey=True)).ravel()
        for k, name in enumerate(drawn.names):
            told = _over(drawn, k)
            panels[k].plot(told["at"], told["before"], "--o", color=_BEFORE, ms=3, lw=1.2)
            panels[k].plot(told["at"], told["after"], "-o", color=_AFTER, ms=3, lw=1.2)
            panels[k].set_title(f"{name} [{drawn.units[k]}]", fontsize=8, loc="left")
            found.append(told.assign(joint=name))
        for axes in panels[len(drawn.names) :]:
            axes.set_visible(False)
        for axes in panels[::_ACROSS]:
            axes.set_ylabel("rms [mm]", fontsize=8)
        panels[0].set_ylim(0, None)  # of all: to set it before the last is drawn would cut what is larger there
    return figure, pd.concat(found, ignore_index=True)


def _over(drawn: Drawn, k: int) -> pd.DataFrame:
    """Return the rms before and after in bins of as many poses of joint k, over its mean there [deg or mm]."""
    values = drawn.joints[:, k]
    known = np.isfinite(drawn.before) & np.isfinite(drawn.after)
    bins = np.array_split(np.argsort(values[known], kind="stable"), min(_BINS, max(1, int(known.sum()) // 5)))
    rows = [
        (
            float(values[known][part].mean()),
            float(np.sqrt((drawn.before[known][part] ** 2).mean())),
            float(np.sqrt((drawn.after[known][part] ** 2).mean())),
            len(part),
        )
        for part in bins
        if len(part)
    ]
    return pd.DataFrame(rows, columns=["at", "before", "after", "poses"])
