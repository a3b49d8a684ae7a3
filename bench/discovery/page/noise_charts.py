"""Drawings for findings that blame the noise: where the outlying readings stand, the steps of a sensor, the tails.

Such a finding moves no mean, so nothing is drawn before and after: the chart shows what was seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.special import erfc

from calibench.bench.discovery.implied import error_of
from calibench.bench.discovery.page.quantity import in_small_units, largest
from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing
from calibench.core.counted import plain
from calibench.discrepancy.diagnostics.noise_diagnostic import outliers_under
from calibench.discrepancy.labels import quantity_label
from calibench.discrepancy.model.measured.sensor import sensor_of
from calibench.discrepancy.report import Finding, Report
from calibench.problems.base import Array

CAPTIONS = {
    "outlier": "What the misfit of each reading would be as an error of this sensor. The quarter of the readings that "
    "know it least is left out.",
    "quantisation": "Readings of a sensor without steps lie anywhere between two steps (dashed); these lie on them.",
    "heavy_tails": "How many residuals are at least so large. Gaussian noise would follow the dashed line and has an "
    "excess kurtosis of 0; rare shocks reach beyond it and raise that number.",
}
_SIZE = (7.2, 2.8)
_BINS = 41
_MANY = 800  # dots from which on they are drawn as pixels


def noise_charts(report: Report) -> Iterator[tuple[str, Drawing]]:
    """Yield (name, drawing) for every finding of `report` that blames the noise."""
    made: dict[str, Callable[[Report, Finding], Drawing]] = {
        "outlier": outliers_in_time, "quantisation": steps_of_the_sensor, "heavy_tails": tails_of_the_residuals,
    }  # fmt: skip
    told = [finding for finding in report.findings if finding.family in made]
    for number, finding in enumerate(told, start=1):
        yield f"noise_{number}", made[finding.family](report, finding)


def outliers_in_time(report: Report, finding: Finding) -> Drawing:
    """Draw the error that each reading of the sensor implies over time, and mark those taken for outlying."""
    fit = report.model.fit
    sensor = sensor_of(fit.model.formulation.sensors, finding.target)
    encoder, data = sensor.column, fit.model.formulation.data
    label = sensor.label or quantity_label(report.machine, encoder)
    error, weight = error_of(encoder, fit)
    factor, unit = in_small_units(sensor.unit, largest(error))
    error = factor * error
    timed = data.has("t_s")
    at = np.asarray(data["t_s"] if timed else np.arange(len(data)), dtype=float)
    outlying = outliers_under(fit.model, fit.x, finding.target).weights > 0.5
    stated = factor * float(np.median(fit.model.formulation.sigma[encoder]))
    table = pd.DataFrame({"t_s" if timed else "reading": at, f"error_{unit}".rstrip("_"): error, "outlying": outlying})
    known = weight if outlying.all() else weight[~outlying]
    sure = ~outlying & (weight >= np.quantile(known, 0.25))  # others hardly know this encoder
    with rc_context(STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained")
        axes = figure.subplots()
        two = f"two stated deviations, ±{plain(2 * stated, 3)} {unit}".rstrip()
        axes.axhspan(-2 * stated, 2 * stated, color="0.9", zorder=0, label=two)
        many = len(table) > _MANY
        axes.plot(at[sure], error[sure], ".", color=COLOURS[0], ms=4, mec="none", rasterized=many)
        axes.plot(at[outlying], error[outlying], "x", color=COLOURS[1], ms=6, mew=1.4,
                  label=f"{outlying.sum()} of {len(table)} readings taken for outlying")  # fmt: skip
        axes.set(xlabel="time [s]" if timed else "reading", ylabel=f"error of {label}" + (f" [{unit}]" if unit else ""))
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderaxespad=0.2, fontsize=8)
    return figure, table


def steps_of_the_sensor(report: Report, finding: Finding) -> Drawing:
    """Draw how far the sensor's readings lie from the nearest step: all at 0 where it is read in such steps."""
    formulation, step = report.before.fit.model.formulation, finding.amplitude.value
    sensor = sensor_of(formulation.sensors, finding.target)
    factor, unit = in_small_units(sensor.unit, step)
    label = sensor.label or quantity_label(report.machine, sensor.column)
    turns = np.asarray(formulation.data[sensor.column]) / step
    origin = np.angle(np.exp(2j * np.pi * turns).mean()) / (2 * np.pi)
    off = (turns - origin + 0.5) % 1.0 - 0.5
    counts, edges = np.histogram(off, _BINS, (-0.5, 0.5))
    table = pd.DataFrame({"off_step": (edges[:-1] + edges[1:]) / 2, "readings": counts, "smooth": len(off) / _BINS})
    with rc_context(STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained")
        axes = figure.subplots()
        axes.bar(table["off_step"], counts, 0.9 / _BINS, color=COLOURS[1])
        axes.axhline(len(off) / _BINS, color="black", ls="--", lw=1.2, label="readings without steps")
        size = f"{plain(factor * step, 4)} {unit}".rstrip()
        axes.set(xlabel=f"distance of {label} from the nearest step of {size} [steps]", ylabel="readings",
                 xlim=(-0.5, 0.5))  # fmt: skip
        axes.legend(loc="upper right", fontsize=8)
    return figure, table


def tails_of_the_residuals(report: Report, finding: Finding) -> Drawing:
    """Draw how many residuals are larger than a size, and how many Gaussian noise of the same core would leave."""
    size = np.sort(np.abs(report.before.fit.r))[::-1]
    core = float(np.median(size)) / 0.6745  # the deviation of a Gaussian of the same median
    table = pd.DataFrame({"size": size / core, "larger": np.arange(1, len(size) + 1)})
    reach = np.linspace(0, max(4.5, float(table["size"].max())), 200)
    gauss = len(size) * _beyond(reach)
    with rc_context(STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained")
        axes = figure.subplots()
        axes.plot(table["size"], table["larger"], ".-", color=COLOURS[1], ms=4, lw=0.8, label="these residuals")
        seen = gauss > 0.2
        axes.plot(reach[seen], gauss[seen], "--", color="black", lw=1.2, label="Gaussian noise")
        axes.set(xlabel="size of a residual, in standard deviations of the middle half", ylabel="as large or larger",
                 yscale="log", ylim=(0.5, None), xlim=(0, None))  # fmt: skip
        axes.legend(loc="upper right", fontsize=8)
    return figure, table


def _beyond(size: Array) -> Array:
    """Return the part of Gaussian noise that is beyond `size` standard deviations on either side."""
    return np.asarray(erfc(size / np.sqrt(2)))
