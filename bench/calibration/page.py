"""The page of one calibration, what an owner of an arm reads first, and its drawings, each with its numbers."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from math import degrees, isfinite
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import NullFormatter

from calibench.bench.calibration.words import headline, level_rows, rows_of_changes, rows_of_frame, sentences
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.drawing import COLOURS, Drawing, axes_in, figure_of, new_figure, save
from calibench.bench.report.shared.page import Head, Table, inline_svg, render
from calibench.bench.store.atomic_file import write_whole
from calibench.calibration.calibrate import Calibration
from calibench.calibration.poses import Design
from calibench.calibration.rigid import Index
from calibench.core.words import as_sentence, plain

_TEMPLATE = "calibration/templates/calibration.html.j2"
_MOST_WILD = 50


def write_page(answer: Calibration, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` of a calibration into `folder`; return the page's path."""
    drawings = {}
    for name, drawing in calibration_figures(answer):
        svg = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
        drawings[name] = inline_svg(svg, name)

    heads = ["free in the fit", "rms [mm]", "95 %", "median", "largest"]
    heads += ["rotation [mrad]"] if any(isfinite(one.rotation) for one in answer.levels) else []
    heads += ["sockets apart [mm]"] if any(isfinite(one.spans) for one in answer.levels) else []
    words = {"base": "base of the arm, in the tracker's frame", "target": f"target, on {answer.tip}"}
    frames: list[dict[str, str | Table]] = []
    for name, values in answer.frames.items():
        text = f"x y z {', '.join(f'{value:.3f}' for value in values[:3])} mm"
        if values[3:] and (name == "base" or answer.observed == "pose"):
            text += f"; roll pitch yaw {', '.join(f'{degrees(value):.4f}°' for value in values[3:])}"
        frames.append({"what": words.get(name, f"{name}, on {answer.tip}"), "place": text})
    for frame in (one for one in (answer.camera, answer.board) if one is not None):
        frames.append({"what": f"{frame.child} in {frame.parent}", "table": _table(
            ("number", "value", "standard error", "95 %"), rows_of_frame(frame), ("value", "standard error", "95 %")
        )})  # fmt: skip
    why = ("number", "why")
    badly, undetermined = (
        _table(why, [[one.parameter, one.reason] for one in answer.undetermined if isfinite(one.known_to) == finite])
        for finite in (True, False)
    )
    where = ("poses", "before [mm]", "after [mm]")
    regions, by_joint = (
        _table(("where", *where), [[p.where, str(p.poses), f"{p.before:.3f}", f"{p.after:.3f}"] for p in parts], where)
        for parts in (answer.regions, answer.by_joint)
    )
    origin = provenance()
    versions = json.loads(origin["versions"])
    turned = f", {plain(1e3 * answer.scatter[1], 3)} mrad" if answer.observed == "pose" else ""
    page = render(
        _TEMPLATE, title=f"{answer.case}: how true is the arm, and what is it off by?", described=answer.source,
        better=answer.chosen != "frames", headline=as_sentence(headline(answer)),
        said=[as_sentence(said) for said in sentences(answer)], levels=_table(heads, level_rows(answer), heads[1:]),
        changes=_table(("joint", "what", "changed by", "95 %"), rows_of_changes(answer), ("changed by", "95 %")),
        badly=badly, tolerance=plain(answer.tolerance, 2), undetermined=undetermined,
        regions=regions, by_joint=by_joint,
        wild=_table(("reading", "error [mm]"), [[w.row, plain(w.error, 3)] for w in answer.wild[:_MOST_WILD]]),
        frames=frames, notes=[as_sentence(note.text) for note in answer.notes], files=answer.files,
        facts={
            answer.source: str(answer.arm.path), "chain": f"{answer.base} to {answer.tip}: {', '.join(answer.joints)}",
            "read": answer.observed if answer.camera is None else "the board's pose in the camera",
            "scatter that is left": f"{plain(answer.scatter[0], 3)} mm a coordinate{turned}",
            "commit": origin["git_commit"],
            "versions": ", ".join(f"{name} {version}" for name, version in versions.items() if version),
            "computing time": f"{answer.seconds:.2f} s",
        },
        drawings=drawings,
    )  # fmt: skip
    return write_whole(folder / "report.html", page.encode())


def _table(heads: tuple[str, ...] | list[str], rows: list[list[str]], right: tuple[str, ...] | list[str] = ()) -> Table:
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, "fit", blocks=True)


_BEFORE, _AFTER = COLOURS[1], COLOURS[0]
_DOTS = 3000


def calibration_figures(answer: Calibration) -> Iterator[tuple[str, Drawing]]:
    """Yield (name, drawing) of one calibration."""
    drawn = answer.drawn

    # the share of poses below each error, before and after
    table = pd.DataFrame({"before": drawn.before, "after": drawn.after}).dropna()
    with axes_in(None, 4.6, 2.9) as axes:
        places = _some(len(table))
        for name, colour, dash in (("before", _BEFORE, "--"), ("after", _AFTER, "-")):
            share, errors = 100 * (places + 1) / max(len(table), 1), np.sort(table[name])[places]
            axes.step(errors, share, where="post", color=colour, ls=dash, lw=1.6, label=name)
        axes.set(xlabel="error of a pose that was not fitted [mm]", ylabel="poses with less [%]", ylim=(0, 100))
        axes.set_xscale("log")
        _by_decades(axes.xaxis, table)
        figure_of(axes).legend(loc="outside upper right", ncols=2)
    yield "errors", (figure_of(axes), table)

    # the error from above, before and after, in one scale of colours
    table = pd.DataFrame(drawn.position, columns=["x", "y", "z"])
    table = table.assign(before=drawn.before, after=drawn.after).dropna()
    top = float(table["before"].quantile(0.98)) if len(table) else 1.0
    with new_figure(7.2, 3.1) as figure:
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
        # the rms error over the angle or the way of each joint, before and after
        table = pd.DataFrame([asdict(one) for one in answer.over_joints])
        with axes_in(None, *joints_size(table)) as axes:
            draw_joints(axes, table)
            figure_of(axes).legend(loc="outside upper right", ncols=2)
        yield "joints", (figure_of(axes), table)


def _some(count: int) -> Index:
    """Return the places of at most `_DOTS` of `count`: more dots and steps are not seen."""
    return np.unique(np.linspace(0, count - 1, min(count, _DOTS)).astype(np.int64))


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
    with axes_in(None, 4.6, 2.9) as axes:
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
    return figure_of(axes), table
