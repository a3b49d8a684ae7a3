"""Figures from runs: convergence, evaluations to target, the overview of a field."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bench import paper_figures, stats, tables
from bench.drawing import COLOURS, DASHES, STYLE, Drawing
from bench.optimum import optimum_of
from problems import constants

_FIELD = 12  # optimisers from which on a study is a field, and wants an overview
_NOTE: Any = {"fontsize": 7, "color": "0.3"}


def study_figures(runs: pd.DataFrame, traces: pd.DataFrame, only: Sequence[str] = ()) -> Iterator[tuple[str, Drawing]]:
    """Yield (name, drawing) for every figure that these results can fill, or for those of them named in `only`."""
    for name, draw in _drawable(runs, traces):
        if not only or name in only:
            yield name, draw()


def _drawable(runs: pd.DataFrame, traces: pd.DataFrame) -> Iterator[tuple[str, Callable[[], Drawing]]]:
    for title, group in runs.groupby(runs.apply(panel_group, axis=1), sort=False):
        label = file_name(str(title))
        yield f"convergence_{label}", partial(convergence, group, traces, title=str(title))
        if group["targets"].map(len).gt(0).all():
            yield f"target_{label}", partial(target_chart, group, title=str(title))
    if runs["optimizer"].nunique() > _FIELD:
        yield "overview", partial(overview, runs)
    if runs["problem"].isin(["full11", "full12"]).any():
        yield "gauge", paper_figures.gauge
        yield "plans", paper_figures.plans
    if runs["problem"].eq("orthoglide6").any():
        yield "orthoglide_residuals", paper_figures.orthoglide_residuals


def convergence(runs: pd.DataFrame, traces: pd.DataFrame, title: str = "") -> Drawing:
    """Draw the best error over charged evaluations, a panel for each error function (Figs 3-5 of Cong et al. 2008).

    Median over runs with the quartile band; dotted, what the true parameters themselves give: the rounding floor where
    it is that. Where the least value f* is declared and not zero (measured data), f - f* is drawn, down to half a
    rounding of f*; `bench.optimum` decides what is drawn and what the axis is.
    """
    errors = sorted({error_of(row) for _, row in runs.iterrows()})
    runs = runs.assign(method=stats.method_names(runs))
    methods = list(dict.fromkeys(runs["method"]))
    named = methods
    if len(methods) > _FIELD:  # the best are named, the others are a grey background
        named = runs.groupby("method")["best_value"].median().sort_values(kind="stable").index[: _FIELD - 2].tolist()
    by_run = dict(iter(traces.groupby("run_id", sort=False)))
    numbers = []
    with rc_context(STYLE):
        room = 1.0 + 0.068 * max(map(len, named))  # of the legend's widest name
        figure = Figure(figsize=(room + 3.4 * len(errors), 3.7), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, len(errors), sharex=True))
        for axes, error in zip(panels, errors, strict=True):
            mine = runs[[error_of(row) == error for _, row in runs.iterrows()]]
            known = optimum_of(mine)
            last = max(10.0, float(mine["charged"].max()))
            at = np.unique(np.round(np.geomspace(1, last, 240)))
            for method in sorted(methods, key=lambda m: m in named):
                chosen = mine[mine["method"] == method]
                found = [by_run[run_id] for run_id in chosen["run_id"] if run_id in by_run]
                if not found:
                    continue
                band = stats.convergence(found, at).replace(np.inf, np.nan)  # no finite value yet: nothing to draw
                drawn_columns = ["q1", "median", "q3"]
                band[drawn_columns] = known.above(band[drawn_columns])
                numbers.append(band.assign(error=error, method=method))
                if method not in named:
                    label = f"{len(methods) - len(named)} others"
                    axes.plot(band["charged"], band["median"], color="0.75", lw=0.7, label=label)
                    continue
                i = named.index(method)
                colour, dash = COLOURS[i % len(COLOURS)], DASHES[(i + i // len(COLOURS)) % len(DASHES)]
                axes.fill_between(band["charged"], band["q1"], band["q3"], color=colour, alpha=0.18, linewidth=0)
                axes.plot(band["charged"], band["median"], color=colour, linestyle=dash, label=method)
            if known.floor:
                axes.axhline(known.floor, color="0.35", linestyle=":", linewidth=1)
                axes.annotate(
                    known.floor_text, (0.02, known.floor), (0, 3), xycoords=("axes fraction", "data"),
                    textcoords="offset points", **_NOTE,
                )  # fmt: skip
            drawn = np.concatenate([line.get_ydata() for line in axes.get_lines()] or [np.ones(1)])
            seen = drawn[np.isfinite(drawn)]
            scale = known.scale(drawn)
            if not seen.size:  # nothing found a value
                axes.set_xlim(1, last)
            axes.set(xscale="log", yscale=scale, xlabel="charged evaluations")
            if scale == "log" and not seen.all():  # zero has no place on such an axis: the line leaves at the bottom
                axes.set_ylim(bottom=seen[seen > 0].min() / 10)
                axes.annotate("a line that leaves here is at 0", (0.02, 0.02), xycoords="axes fraction", **_NOTE)
            axes.set_ylabel(known.axis)
        handles: dict[str, Any] = {}
        for axes in panels:
            handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(handles.values(), handles.keys(), loc="outside right center", fontsize=8)
        counts = runs.groupby(["optimizer", "optimizer_options", "problem_options"]).size()
        fewest, most = int(counts.min()), int(counts.max())
        several = f"{most} runs" if fewest == most else f"{fewest} to {most} runs"
        spread = "one run each" if most == 1 else f"median and quartiles of {several}"
        figure.suptitle(f"{title}: {spread}" if title else "", fontsize=10)
    return figure, pd.concat(numbers, ignore_index=True) if numbers else pd.DataFrame()


def target_chart(runs: pd.DataFrame, title: str = "") -> Drawing:
    """Draw what each method paid to the last target (1e-18, 1e-23 for J1): a dot a run, a panel an error function.

    Hollow triangles are runs that never got there, at what they had spent; the share that did stands beside the name.
    """
    errors = sorted({error_of(row) for _, row in runs.iterrows()})
    table = runs.assign(
        error=[error_of(row) for _, row in runs.iterrows()],
        method=stats.method_names(runs),
        hit=stats.goal_hits(runs),
    )[["error", "method", "run_id", "hit", "charged", "status"]]
    stopped = panel_group(runs.iloc[0]) == "full12"  # section 4 of the paper, where GA, PSO and DE search
    with rc_context(STYLE):
        room = 3.0 + 0.058 * int(table["method"].map(len).max())  # of a panel and its widest name
        size = (max(6.2, room * len(errors)), 1.5 + 0.26 * table["method"].nunique())
        figure = Figure(figsize=size, layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, len(errors), sharex=True))
        for axes, error in zip(panels, errors, strict=True):
            mine = table[table["error"] == error]
            order = mine.groupby("method").agg(
                reached=("hit", "count"), cost=("hit", "median"), spent=("charged", "median"), runs=("hit", "size")
            )
            order["share"] = order["reached"] / order["runs"]
            order = order.sort_values(["share", "cost", "spent"], ascending=[True, False, False])
            for y, (method, row) in enumerate(order.iterrows()):
                dots = mine[mine["method"] == method]
                hit, missed = dots["hit"].dropna(), dots.loc[dots["hit"].isna(), "charged"].clip(lower=1)
                axes.plot(hit, np.full(len(hit), y), "o", color=COLOURS[0], ms=5, alpha=0.6, mec="none")
                axes.plot(missed, np.full(len(missed), y), ">", mfc="none", mec=COLOURS[1], ms=5)
                if row["reached"]:
                    axes.plot([row["cost"]] * 2, [y - 0.33, y + 0.33], color="black", lw=1.4)
            labels = [f"{method}  {int(row['reached'])}/{int(row['runs'])}" for method, row in order.iterrows()]
            axes.set_yticks(range(len(labels)), labels, fontsize=7.5)
            axes.set(
                xscale="log",
                xlabel=f"charged evaluations to {_target_text(runs, error)}",
                ylim=(-0.7, len(labels) - 0.3),
            )
            if stopped:
                axes.axvline(constants.column("cong2008", "section44")["evaluations"], color="0.35", ls=":", lw=1)
        for axes in panels:
            _plain_ticks(axes)
        panels[0].plot([], [], "o", color=COLOURS[0], label="reached (bar: median)")
        panels[0].plot([], [], ">", mfc="none", mec=COLOURS[1], label="never, spent so much")
        if stopped:
            panels[0].plot([], [], color="0.35", ls=":", lw=1, label="where the paper stopped its searches")
        figure.legend(loc="outside lower center", ncols=3, fontsize=8)
        figure.suptitle(title, fontsize=10)
    return figure, table.drop(columns="run_id")


def _plain_ticks(axes: Any) -> None:
    """Label 1, 2, 5 of each decade where there are few, and never what lies between."""
    axes.xaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_xlim()
    if high < 100 * low:
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def overview(runs: pd.DataFrame) -> Drawing:
    """Draw a field at a glance: a row a method, a column a problem, colour for the median of the best value reached.

    Each cell says how many runs reached the last target; methods are sorted by that share, then by what they reached.
    """
    table = tables.overview(runs)
    order = list(dict.fromkeys(table["optimizer"]))
    columns = list(dict.fromkeys(table["problem"] + " " + table["error"]))
    cells = {(row["optimizer"], f"{row['problem']} {row['error']}"): row for row in table.to_dict("records")}
    halves = 1 if len(order) <= 40 else 2
    rows = -(-len(order) // halves)
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(0.9 + halves * (2.1 + 0.85 * len(columns)), 1.4 + 0.185 * rows), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, halves))
        for i, axes in enumerate(panels):
            names = order[i * rows : (i + 1) * rows]
            grid = np.full((rows, len(columns)), np.nan)
            for y, name in enumerate(names):
                for x, column in enumerate(columns):
                    cell = cells.get((name, column))
                    if cell is None:
                        axes.text(x, y, "cannot", ha="center", va="center", fontsize=6.5, color="0.5")
                        continue
                    grid[y, x] = np.log10(np.clip(cell["best_median"], 1e-20, 1e12))
                    shade = "white" if grid[y, x] < -6 else "black"
                    text = "failed" if cell["failed"] == cell["runs"] else f"{cell['reached']}/{cell['runs']}"
                    axes.text(x, y, text, ha="center", va="center", fontsize=6.5, color=shade)
            image = axes.imshow(grid, aspect="auto", cmap="cividis", vmin=-20, vmax=8)
            axes.set_yticks(range(len(names)), names, fontsize=7)
            axes.set_xticks(range(len(columns)), [c.replace(" ", "\n") for c in columns], fontsize=7)
            axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
            axes.set_ylim(rows - 0.5, -0.5)
            for spine in axes.spines.values():
                spine.set_visible(False)
        figure.colorbar(image, ax=panels, label="log10 of the median best value", shrink=0.4, aspect=30)
        budget, count = int(runs["budget"].max()), int(table["runs"].max())
        each = f"{count} run{'s' if count > 1 else ''} each"
        figure.suptitle(f"{len(order)} methods, {budget} evaluations, {each}: runs at the goal", fontsize=10)
    return figure, table


def error_of(row: pd.Series) -> str:
    """Return the error function of a run's problem; '' where it has no choice of them."""
    return str(json.loads(row["problem_options"]).get("error", ""))


def _target_text(runs: pd.DataFrame, error: str) -> str:
    mine = runs[[error_of(row) == error for _, row in runs.iterrows()]]
    return optimum_of(mine).level(list(mine["targets"].iloc[0])[-1])


def panel_group(row: Mapping[str, Any] | pd.Series) -> str:
    """Return what a figure is of: a problem and all its options but the error function."""
    return stats.problem_name(row["problem"], row["problem_options"], but=("error",))


def file_name(title: str) -> str:
    """Return what the files of a figure of this title end in.

    >>> file_name("full12 gauge=ya2")
    'full12_gaugeya2'
    """
    text = title.replace("=", "").replace(" ", "_")
    return "".join(c if c.isalnum() or c in "._-" else "-" for c in text)
