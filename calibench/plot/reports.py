"""Drawings of what was found: the residual of a missing effect, and the error of a calibrated arm over its joints."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from textwrap import fill
from typing import Any, Literal

import pandas as pd
from matplotlib.axes import Axes

from calibench.bench.calibration.page import draw_joints, joints_size
from calibench.bench.discovery.page.figures import draw_gap, draw_residuals, gap_of, means_of
from calibench.bench.discovery.page.shown import Residuals, series_of
from calibench.bench.discovery.page.words import compared, floor_holds_the_gap, noise_words
from calibench.bench.report.shared.drawing import axes_in, explain_lines, figure_of
from calibench.calibration.calibrate import Calibration
from calibench.core.options import suggest
from calibench.discrepancy import Report
from calibench.plot.studies import with_data

Searched = Report | Mapping[str, Any] | str | Path
Show = Literal["residuals", "gap"]


def _discovery(report: Searched, *, show: Show | None = None, effect: str | None = None) -> pd.DataFrame:
    """Return the means that are drawn (value, before, after, standard_error, readings), or of the gap model and rms."""
    read, residuals = _read(report, show, effect)
    return gap_of(read.gap, compared(read)) if residuals is None else means_of(residuals)


@with_data(_discovery)
def discovery(report: Searched, ax: Axes | None = None, *, show: Show | None = None, effect: str | None = None) -> Axes:
    """Draw what each reading implies of the quantity that an effect changes, before it was added and after.

    In the legend stands the gap: the rms error on unseen readings, in units of the noise. ``show="gap"`` draws that
    alone, as bars with its interval; so does a report without an effect, and one that was read from JSON, which has no
    readings any more. `effect` chooses among several by the name in ``report.findings``; by default the first.
    """
    read, residuals = _read(report, show, effect)
    if residuals is None:
        table = gap_of(read.gap, compared(read))
        with axes_in(ax, 5.4, 1.3 + 0.42 * len(table)) as axes:
            draw_gap(axes, table, noise_words(read), not floor_holds_the_gap(read))
        return axes
    with axes_in(ax, 5.6, 3.6) as axes:
        draw_residuals(axes, axes, residuals)
        gap, title = read.gap, ""
        if isfinite(gap.held_out_before) and isfinite(gap.held_out_after):
            for line, rms in zip(axes.containers, (gap.held_out_before, gap.held_out_after)):
                line.set_label(f"{line.get_label()}: {rms:.2f}")
            floor = "" if floor_holds_the_gap(read) else f" (noise alone leaves {gap.noise_floor:.2f})"
            title = f"rms on unseen readings{floor}"
        if ax is None:
            axes.set_title(fill(residuals.effect, 60), fontsize=10)
            figure_of(axes).legend(title=title, ncols=2, fontsize=8, title_fontsize=8, loc="outside lower center")
        else:
            explain_lines(axes, title=fill(title, 24), title_fontsize=7.5)
    return axes


def _read(report: Searched, show: Show | None, effect: str | None) -> tuple[Report, Residuals | None]:
    """Return the report, and the residuals that are to be drawn; None where it is the gap."""
    if isinstance(report, str | Path):
        report = _json(report)
    if isinstance(report, Mapping):
        try:
            report = Report.from_dict(report)
        except KeyError as missing:
            raise ValueError(f"this is no report of a search: it has no {missing}") from None
    names = [finding.effect for finding in report.findings]
    if effect is not None and effect not in names:
        raise ValueError(f"effect={effect!r}: the report has none of that name; {suggest(effect, names)}")
    if show not in (None, "residuals", "gap"):
        raise ValueError(f"show={show!r}: 'residuals' or 'gap' is needed")
    if show == "gap" or (show is None and (report.fitted is None or not names)):
        return report, None
    if report.fitted is None or not names:
        what = "was read from JSON, which has no readings" if names else "has no effect"
        raise ValueError(f"show='residuals': the report {what}; show='gap' draws the error on unseen readings")
    drawn = series_of(report).residuals
    at = 0 if effect is None else names.index(effect)
    return report, drawn[min(at, len(drawn) - 1)]


def _calibration(calibration: Calibration | Mapping[str, Any] | str | Path) -> pd.DataFrame:
    """Return the error over the place of each joint: joint, unit, at, low, high, before, after [mm], poses."""
    if isinstance(calibration, Calibration):
        return pd.DataFrame([asdict(one) for one in calibration.over_joints])
    content = _json(calibration) if isinstance(calibration, str | Path) else calibration
    if not content.get("over_joints"):
        raise ValueError("calibration: it has no over_joints; the calibration.json of bench calibrate has them")
    return pd.DataFrame(content["over_joints"])


@with_data(_calibration)
def calibration(calibration: Calibration | Mapping[str, Any] | str | Path, ax: Axes | None = None) -> Axes:
    """Draw the rms error of poses that were not fitted over the range of each joint, before and after.

    `calibration` is what `calibench.calibrate` returns, the path of a calibration.json of ``bench calibrate``, its
    folder, or what stands in it.
    """
    table = _calibration(calibration)
    with axes_in(ax, *joints_size(table)) as axes:
        draw_joints(axes, table)
        if ax is None:
            figure_of(axes).legend(loc="outside upper right", ncols=2, fontsize=8)
        else:
            explain_lines(axes)
    return axes


def _json(path: str | Path) -> Mapping[str, Any]:
    """Return what stands in a JSON file, or in the calibration.json of a folder."""
    file = Path(path)
    file = file / "calibration.json" if file.is_dir() else file
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise ValueError(f"{file}: is no report: an object is needed")
    return content
