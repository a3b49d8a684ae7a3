"""The drawings of a calibration, each with its numbers: errors before and after, over the workspace and each joint."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing
from calibench.calibration.calibrate import Calibration, OverJoint
from calibench.calibration.poses import Design
from calibench.calibration.rigid import Index

_BEFORE, _AFTER = COLOURS[1], COLOURS[0]
_DOTS = 3000


def calibration_figures(answer: Calibration) -> Iterator[tuple[str, Drawing]]:
    """Yield (name, drawing) of one calibration."""
    drawn = answer.drawn

    # the share of poses below each error, before and after
    table = pd.DataFrame({"before": drawn.before, "after": drawn.after}).dropna()
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 2.9), layout="constrained")
        axes = figure.subplots()
        places = _some(len(table))
        for name, colour, dash in (("before", _BEFORE, "--"), ("after", _AFTER, "-")):
            share, errors = 100 * (places + 1) / max(len(table), 1), np.sort(table[name])[places]
            axes.step(errors, share, where="post", color=colour, ls=dash, lw=1.6, label=name)
        axes.set(xlabel="error of a pose that was not fitted [mm]", ylabel="poses with less [%]", ylim=(0, 100))
        axes.set_xscale("log")
        _by_decades(axes.xaxis, table)
        figure.legend(loc="outside upper right", ncols=2)
    yield "errors", (figure, table)

    # the error from above, before and after, in one scale of colours
    table = pd.DataFrame(drawn.position, columns=["x", "y", "z"])
    table = table.assign(before=drawn.before, after=drawn.after).dropna()
    top = float(table["before"].quantile(0.98)) if len(table) else 1.0
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.1), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, 2, sharex=True, sharey=True))
        for axes, name in zip(panels, ("before", "after")):
            many, some = len(table) > 800, table.iloc[_some(len(table))]
            dots = axes.scatter(
                some["x"], some["y"], c=some[name], s=9, cmap="cividis_r", vmin=0, vmax=top, rasterized=many
            )
            axes.set_title(name, fontsize=9, loc="left")
            axes.set(xlabel="x in the base [mm]", aspect="equal")
        panels[0].set_ylabel("y in the base [mm]")
        bar = figure.colorbar(dots, ax=list(panels), shrink=0.9, aspect=20)
        bar.set_label("error [mm]", fontsize=8)
    yield "workspace", (figure, table)
    if answer.over_joints:
        yield "joints", joint_chart(answer.over_joints)


def _some(count: int) -> Index:
    """Return the places of at most `_DOTS` of `count`: more dots and steps are not seen."""
    return np.unique(np.linspace(0, count - 1, min(count, _DOTS)).astype(np.int64))


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
    axes.set_yscale("log")
    _by_decades(axes.yaxis, table[["before", "after"]])


def _by_decades(axis: Axis, errors: pd.DataFrame) -> None:
    """Label an axis of errors, of which a hundredth may be left after a calibration: the decades, or all if few."""
    low, high = errors.min().min(), errors.max().max()
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("{x:g}" if high < 10 * low else NullFormatter())


def gain_chart(design: Design) -> Drawing:
    """Draw the error of the calibrated arm against the number of further poses, and from where on more hardly help."""
    table = pd.DataFrame([asdict(one) for one in design.gain])
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 2.9), layout="constrained")
        axes = figure.subplots()
        chosen = table["poses"] <= len(design.joints)
        for name, colour, label in (
            ("left_mm", _BEFORE, "of a fresh reading"), ("error_mm", _AFTER, "of the arm's numbers alone")
        ):  # fmt: skip
            axes.plot(table["poses"][chosen], table[name][chosen], "-o", color=colour, ms=3, lw=1.4, label=label)
            rest = table["poses"] >= len(design.joints)
            axes.plot(table["poses"][rest], table[name][rest], ":", color=colour, lw=1.4)
        if enough := design.chosen.enough(design.sigma):
            axes.axvline(enough, color="0.5", lw=0.9, ls="--", label=f"from {enough} on more hardly help")
        axes.set_xscale("function", functions=(np.sqrt, np.square))
        most = table["poses"].max()
        ticks = [n for n in (0, 5, 20, 50, 100, 200, 500, 1000, 2000, 4000) if n <= most and (n == 0 or n > most / 50)]
        axes.set_xticks(ticks, [str(n) for n in ticks])
        axes.set_yscale("log")
        _by_decades(axes.yaxis, table[["left_mm", "error_mm"]])
        beside = f"poses beside {design.measured} measured" if design.measured else "poses"
        axes.set(xlabel=f"{beside} (dotted: more that are as good)", ylabel="error, rms [mm]", xlim=(0, most))
        axes.legend()
    return figure, table
