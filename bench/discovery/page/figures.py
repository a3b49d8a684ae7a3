"""The drawings of a search for a missing effect, each with its numbers, of the plain values that `shown` has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.special import erfc

from calibench.bench.discovery.page.shown import Residuals, Shown
from calibench.bench.report.shared.drawing import COLOURS, Drawing, axes_in, figure_of, new_figure, save
from calibench.core.words import plain
from calibench.discrepancy.labels import NO_WORDS, effect_label, quantity_label, quantity_of
from calibench.discrepancy.report import Gap, Place
from calibench.problems.base import Array

_BEFORE, _AFTER = COLOURS[1], COLOURS[0]
_BEFORE_DARK, _AFTER_DARK = "#7a3500", "#003f63"  # of means among the dots of both
_SHOWN = 10  # candidates of which a bar is drawn
_NAME = 34  # letters in a line of a candidate's name
_LINE = 0.155  # inches of a line of it
_KNOWING = 0.01  # part of the weight of those that know a quantity best: ten times their standard deviation
_DOTS = 2500  # readings of which a dot is drawn; the means are of all that know the quantity
_FEW = 12  # values of a covariate up to which each has a mean of its own
_PANEL = 185.0  # points between the outer values of a panel of two
_LETTER = 5.5  # points that a letter of a tick's label takes
_VECTOR = 800  # dots up to which a drawing keeps them as shapes
_SIZE = (7.2, 2.8)  # inches, of a drawing of the noise
_BINS = 41
_MANY = 800  # dots from which on they are drawn as pixels


def written(shown: Shown, folder: Path) -> Path:
    """Write the files of a drawing into `folder`; return the path of its SVG."""
    drawing: Drawing = globals()[shown.drawing](*shown.values)
    return save(shown.name, drawing, folder)[0]


def where_map(machine: str, where: Sequence[Place], words: Mapping[str, str] = NO_WORDS) -> Drawing:
    """Draw the strength of the disagreement, -log10 p: a column for each target, a row for each covariate."""
    table = pd.DataFrame([asdict(place) for place in where])
    table["strength"] = 0.0 - np.log10(np.clip(table["p"], 1e-16, 1.0))
    table["over"] = [quantity_label(machine, str(covariate), words) for covariate in table["covariate"]]
    for k, (target, covariate) in enumerate(zip(table["target"], table["covariate"])):
        known = quantity_of(machine, str(covariate))
        if known.own and known.own == target:  # what each target has of its own, as a velocity, is one row for all
            table.loc[k, "over"] = f"its own {known.label.partition(' of ')[0]}"
    targets = sorted(dict.fromkeys(table["target"]))
    overs = list(table.groupby("over", sort=False)["strength"].max().sort_values(ascending=False).index)
    grid = np.full((len(overs), len(targets)), np.nan)
    for target, over, strength in zip(table["target"], table["over"], table["strength"]):
        grid[overs.index(over), targets.index(target)] = strength
    top = max(4.0, float(np.nanmax(grid)))
    size = (2.8 + 0.62 * len(targets), 1.5 + 0.25 * len(overs))
    with axes_in(None, *size, {"axes.grid": False}) as axes:
        image = axes.imshow(grid, aspect="auto", cmap="cividis_r", vmin=0, vmax=top)
        for (y, x), value in np.ndenumerate(grid):
            if np.isfinite(value):
                shade = "white" if value > 0.55 * top else "black"
                heavy = "bold" if value >= 2 else "normal"
                exponent = "≥16" if value >= 16 else f"{value:.1f}"
                axes.text(x, y, exponent, ha="center", va="center", fontsize=7.5, color=shade, fontweight=heavy)
        axes.set_xticks(range(len(targets)), targets, fontsize=8)
        axes.set_yticks(range(len(overs)), overs, fontsize=8)
        axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
        axes.xaxis.set_label_position("top")
        axes.set_xlabel("residual of", fontsize=8)
        axes.set_ylabel("over", fontsize=8)
        axes.spines[:].set_visible(False)
        bar = figure_of(axes).colorbar(image, ax=axes, shrink=0.9, aspect=22)
        bar.set_label("−log10 p (bold: p < .01)", fontsize=8)
    return figure_of(axes), table[["target", "covariate", "p", "strength"]]


def workspace_map(x: Array, y: Array, residual: Array) -> Drawing:
    """Draw the whitened residual of the model without an effect over the workspace: mean of each small region."""
    size = min(14, max(4, int(np.sqrt(len(x) / 6))))
    edges = [np.linspace(v.min(), v.max() + 1e-9, size + 1) for v in (x, y)]
    column, row = (np.clip(np.digitize(v, e) - 1, 0, size - 1) for v, e in zip((x, y), edges))
    regions = pd.DataFrame({"row": row, "column": column, "residual": residual}).groupby(["row", "column"])
    table = regions["residual"].agg(["mean", "size"]).reset_index()
    table["strength"] = table["mean"] * np.sqrt(table["size"])  # a mean of noise alone has standard deviation 1
    table["x"] = ((edges[0][:-1] + edges[0][1:]) / 2)[table["column"]]
    table["y"] = ((edges[1][:-1] + edges[1][1:]) / 2)[table["row"]]
    grid = np.full((size, size), np.nan)
    grid[table["row"], table["column"]] = table["strength"]
    limit = max(4.0, float(np.nanmax(np.abs(grid))))
    with new_figure(4.6, 3.7, {"axes.grid": False}, layout="compressed") as figure:
        axes = figure.subplots()
        extent = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
        axes.set_facecolor("0.88")  # no readings there: not the white of no residual
        image = axes.imshow(grid, origin="lower", extent=extent, cmap="PuOr_r", vmin=-limit, vmax=limit)
        axes.set(xlabel="x [mm]", ylabel="y [mm]")
        bar = figure.colorbar(image, ax=axes, shrink=0.9, aspect=18)
        bar.set_label("mean residual over its own noise", fontsize=8)
    return figure, table[["x", "y", "size", "mean", "strength"]]


def candidate_chart(machine: str, candidates: pd.DataFrame | Mapping[str, Sequence[Any]]) -> Drawing:
    """Draw what each candidate explains beyond its cost (BIC gain); those on the shortlist are dark and have a dot."""
    candidates = pd.DataFrame(candidates)
    # of two that gain the same, the one that is reported comes first
    rank = pd.DataFrame({"gain": candidates["gain"].round(1), "chosen": candidates.get("chosen", False)})
    order = rank.sort_values(["gain", "chosen"], ascending=False, kind="stable").index
    table = candidates.loc[order].reset_index(drop=True)
    shown = table.head(_SHOWN).iloc[::-1].reset_index(drop=True)
    names = [fill(effect_label(machine, f, t), _NAME) for f, t in zip(shown["family"], shown["target"])]
    row = max(0.25, _LINE * max(name.count("\n") + 1 for name in names) + 0.06)  # inches
    with axes_in(None, 4.9, 0.8 + row * len(shown)) as axes:
        colours = [_AFTER if inside else "0.72" for inside in shown["in_set"]]
        axes.barh(range(len(shown)), shown["gain"], color=colours, height=0.66)
        axes.axvline(0, color="0.4", lw=0.8)
        for y, (gain, inside) in enumerate(zip(shown["gain"], shown["in_set"])):
            words = f"{round(gain)}{'  ●' if inside else ''}"
            axes.annotate(words, (max(gain, 0.0), y), (4, 0), textcoords="offset points", va="center", fontsize=7.5)
        axes.set_yticks(range(len(shown)), names, fontsize=8)
        axes.set_xlabel("gain (BIC)" + ("; ● on the shortlist" if shown["in_set"].any() else ""))
        axes.margins(x=0.12)
        if shown["gain"].abs().max() < 0.5:  # all are told as 0: no scale of rounding errors
            axes.set_xlim(-1, 10)
        axes.grid(axis="y", visible=False)
    return figure_of(axes), table


def residual_chart(residuals: Residuals) -> Drawing:
    """Draw the implied errors of the quantity an effect changes, over what the effect depends on, before and after.

    Faint dots are the readings of largest weight; the line joins means of many readings, bars are two standard errors.
    """
    with new_figure(7.2, 3.0) as figure:
        without, with_it = figure.subplots(1, 2, sharex=True, sharey=True)
        binned = draw_residuals(without, with_it, residuals)
        with_it.set_ylabel("")
        for axes, title in ((without, "model without"), (with_it, "model with")):
            axes.set_title(fill(f"{title} {residuals.effect}", 44), fontsize=9, loc="left")
    return figure, binned


def draw_residuals(without: Axes, with_it: Axes, residuals: Residuals) -> pd.DataFrame:
    """Draw what is implied without the effect and with it, on two axes of one scale or on one; return the means."""
    table, few = _known(residuals)
    binned = means_of(residuals)
    sure = table[table["weight"] >= table["weight"].quantile(0.25)]
    some = sure.iloc[:: max(1, len(sure) // _DOTS)]
    typical = float(1 / np.sqrt(table["weight"].median())) if len(table) else 1.0
    ends = binned[["before", "after"]].abs().add(2 * binned["standard_error"], axis=0)
    dots = some[["before", "after"]].abs()
    far = 1.1 * float(dots.quantile(0.98).max()) if len(some) else 0.0  # a tenth above all dots but the outer 2 %
    reach = max(3 * typical, 1.1 * float(ends.max().max()), far)
    gap = float(np.diff(np.unique(table["value"])).min()) if few and table["value"].nunique() > 1 else 1.0
    spread = gap * 0.12 * np.sin(2.4 * np.arange(len(some)))  # so that dots at one value do not hide each other
    overlaid = without is with_it
    ticks = binned["value"].to_numpy() if few else np.zeros(0)  # where all their labels have room in one panel of two
    room = _PANEL * np.diff(ticks).min() / np.ptp(ticks) if len(ticks) > 1 else np.inf
    longest = max((len(f"{value:.4g}") + 1 for value in ticks), default=0)
    for axes in dict.fromkeys((without, with_it)):
        axes.axhspan(-typical, typical, color="0.92", zorder=0)
        axes.set(xlabel=residuals.label, ylabel=residuals.error, ylim=(-reach, reach))
        if few and _LETTER * longest < room:
            axes.set_xticks(binned["value"])
    for axes, when, colour, edge in (
        (without, "before", _BEFORE, _BEFORE_DARK), (with_it, "after", _AFTER, _AFTER_DARK),
    ):  # fmt: skip
        beside = 0.0 if not (overlaid and few) else (-0.16 if when == "before" else 0.16) * gap
        across = some["value"] + beside + (spread if few else 0.0)
        many = len(some) > _VECTOR
        axes.plot(across, some[when], ".", color=colour, ms=4, alpha=0.55, mec="none", rasterized=many)
        for side, mark in ((1, "^"), (-1, "v")):  # what lies beyond the frame is seen to
            beyond = side * some[when] > reach
            at = np.full(beyond.sum(), 0.97 * side * reach)
            axes.plot(across[beyond], at, mark, color=colour, ms=3.5, mec="none")
        mark = "s" if overlaid and when == "before" else "o"
        errors, line = 2 * binned["standard_error"], mark if few else f"-{mark}"
        dark = edge if overlaid else "black"
        axes.errorbar(
            binned["value"] + beside, binned[when], errors, fmt=line, color=dark, ms=3.5, lw=1.2, elinewidth=1,
            label=when,
        )  # fmt: skip
    return binned


def means_of(residuals: Residuals) -> pd.DataFrame:
    """Return the means that are drawn: value, before, after, standard_error, readings."""
    # weighted means over bins of equal counts; a covariate of few values has a bin for each
    table, few = _known(residuals)
    ranks = table["value"].rank(method="first")
    bins = np.minimum((ranks * 15 / (len(table) + 1)).to_numpy().astype(int), 14)
    label = table["value"].to_numpy() if few else bins
    weighted = table[["value", "before", "after"]].mul(table["weight"], axis=0).groupby(label).sum()
    weight = table.groupby(label)["weight"].sum()
    means = weighted.div(weight, axis=0)
    return means.assign(standard_error=1 / np.sqrt(weight), readings=table.groupby(label).size()).reset_index(drop=True)


def _known(residuals: Residuals) -> tuple[pd.DataFrame, bool]:
    """Return the readings that know the quantity (rows of another kind hardly do), and whether all have few values."""
    table = pd.DataFrame(
        {"value": residuals.values, "before": residuals.before, "after": residuals.after, "weight": residuals.weight}
    )
    table = table[np.isfinite(table.to_numpy()).all(axis=1) & (table["weight"] > 0).to_numpy()]
    few = bool(table["value"].nunique() <= _FEW)
    return table.loc[table["weight"] >= _KNOWING * table["weight"].quantile(0.9)], few


def gap_chart(gap: Gap, names: tuple[str, str], noise: str = "the stated noise", floor: bool = True) -> Drawing:
    """Draw the rms error on unseen readings, by `names`, in `noise`; with `floor`, what noise alone leaves."""
    table = gap_of(gap, names)
    with axes_in(None, 4.9, 1.05 + 0.42 * len(table)) as axes:
        draw_gap(axes, table, noise, floor)
    return figure_of(axes), table


def gap_of(gap: Gap, names: tuple[str, str]) -> pd.DataFrame:
    """Return the rms on unseen readings: model, rms, low, high (95 %), noise_floor; one row where nothing was added."""
    (low, high), before, after = gap.held_out_ci95, gap.held_out_before, gap.held_out_after
    added = np.isfinite(after) and after != before
    rows = [(names[0], before, np.nan, np.nan), (names[1], after, low, high)] if added else [
        ("as it is", before, low, high)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["model", "rms", "low", "high"]).assign(noise_floor=gap.noise_floor)


def draw_gap(axes: Axes, table: pd.DataFrame, noise: str, floor: bool) -> None:
    rows = table.iloc[::-1]
    bars = zip(rows["rms"], rows["low"], rows["high"], (_AFTER, _BEFORE)[-len(rows) :])
    for y, (rms, left, right, colour) in enumerate(bars):
        axes.barh(y, rms, color=colour, height=0.5)
        if np.isfinite(left):
            axes.plot([left, right], [y, y], color="black", lw=1.6, marker="|", ms=9)
        ends = f" ({left:.2f} to {right:.2f})" if np.isfinite(left) else ""
        axes.annotate(f"{rms:.2f}{ends}", (max(rms, float(np.nan_to_num(right))), y), (6, 0),
                      textcoords="offset points", va="center", fontsize=8, zorder=4,
                      bbox={"fc": "white", "ec": "none", "pad": 0.6})  # fmt: skip
    if floor:
        best = float(table["noise_floor"].iloc[0])
        axes.axvline(best, color="black", ls="--", lw=1.2)
        axes.annotate(f"best possible {best:.2f}", (best, 1), (3, 2), va="bottom",
                      xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=8)  # fmt: skip
    axes.set_yticks(range(len(rows)), [fill(model, 22) for model in rows["model"]], fontsize=8)
    axes.set(xlabel=f"rms error on unseen readings [{noise.removeprefix('the ')}]", xlim=(0, None))
    axes.margins(x=0.12)
    axes.grid(axis="y", visible=False)


def outliers_in_time(
    timed: bool, at: Array, error: Array, outlying: NDArray[np.bool_], sure: NDArray[np.bool_], stated: float,
    label: str, unit: str,
) -> Drawing:  # fmt: skip
    """Draw the error that each reading of the sensor implies over time, and mark those taken for outlying."""
    table = pd.DataFrame({"t_s" if timed else "reading": at, f"error_{unit}".rstrip("_"): error, "outlying": outlying})
    with axes_in(None, *_SIZE) as axes:
        two = f"two stated deviations, ±{plain(2 * stated, 3)} {unit}".rstrip()
        axes.axhspan(-2 * stated, 2 * stated, color="0.9", zorder=0, label=two)
        many = len(table) > _MANY
        axes.plot(at[sure], error[sure], ".", color=COLOURS[0], ms=4, mec="none", rasterized=many)
        axes.plot(at[outlying], error[outlying], "x", color=COLOURS[1], ms=6, mew=1.4,
                  label=f"{outlying.sum()} of {len(table)} readings taken for outlying")  # fmt: skip
        axes.set(xlabel="time [s]" if timed else "reading", ylabel=f"error of {label}" + (f" [{unit}]" if unit else ""))
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2, fontsize=8)
    return figure_of(axes), table


def steps_of_the_sensor(off: Array, label: str, size: str) -> Drawing:
    """Draw how far the sensor's readings lie from the nearest step of this size."""
    counts, edges = np.histogram(off, _BINS, (-0.5, 0.5))
    table = pd.DataFrame({"off_step": (edges[:-1] + edges[1:]) / 2, "readings": counts, "smooth": len(off) / _BINS})
    with axes_in(None, *_SIZE) as axes:
        axes.bar(table["off_step"], counts, 0.9 / _BINS, color=COLOURS[1])
        axes.axhline(len(off) / _BINS, color="black", ls="--", lw=1.2, label="readings without steps")
        axes.set(xlabel=f"distance of {label} from the nearest step of {size} [steps]", ylabel="readings",
                 xlim=(-0.5, 0.5))  # fmt: skip
        axes.legend(loc="upper right", fontsize=8)
    return figure_of(axes), table


def tails_of_the_residuals(size: Array) -> Drawing:
    """Draw how many residuals are larger than a size, and how many Gaussian noise of the same core would leave."""
    table = pd.DataFrame({"size": size, "larger": np.arange(1, len(size) + 1)})
    reach = np.linspace(0, max(4.5, float(table["size"].max())), 200)
    gauss = len(size) * np.asarray(erfc(reach / np.sqrt(2)))
    with axes_in(None, *_SIZE) as axes:
        axes.plot(table["size"], table["larger"], ".-", color=COLOURS[1], ms=4, lw=0.8, label="these residuals")
        seen = gauss > 0.2
        axes.plot(reach[seen], gauss[seen], "--", color="black", lw=1.2, label="Gaussian noise")
        axes.set(xlabel="size of a residual, in standard deviations of the middle half", ylabel="as large or larger",
                 yscale="log", ylim=(0.5, None), xlim=(0, None))  # fmt: skip
        axes.legend(loc="upper right", fontsize=8)
    return figure_of(axes), table
