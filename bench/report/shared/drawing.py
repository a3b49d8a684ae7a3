"""What all drawings share: colours, line styles, and how a drawing and its numbers are written side by side.

Colours are Okabe and Ito's, then four of Tol's muted ones; line styles differ as well. Drawings are made beside the
rest of a report (`drawn`): a figure takes half a second, and no figure waits for another.
"""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT
from matplotlib.ticker import LogFormatterSciNotation, NullLocator

from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.report.shared.kept import ENDINGS

Drawing = tuple[Figure, pd.DataFrame]
Drawable = tuple[str, Callable[[], Drawing]]  # its name, and what draws it

COLOURS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7F6A00",
    "#882255", "#332288", "#888888", "#117733",
)  # fmt: skip
DASHES: Any = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (3, 1)), (0, (1, 1)), (0, (7, 2)))
_TITLE = 10.0  # points
STYLE: Any = {
    "text.parse_math": False,  # a name with dollars is a name
    "axes.axisbelow": True, "axes.grid": True, "axes.spines.right": False, "axes.spines.top": False, "font.size": 9,
    "grid.alpha": 0.25, "grid.linewidth": 0.6, "legend.frameon": False, "svg.hashsalt": "calibench",
    "svg.fonttype": "none",
}  # fmt: skip
_DPI = 160  # of the PNG
_PACKED = 3  # of 9: 6, which is usual, makes files 7 % smaller in three times the time
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SAME = 1e-5  # of the axis' length: Matplotlib draws no minor tick so near to a major one
_MOST = 4  # processes: each holds what it changes of the runs
_WORTH = 3  # figures: fewer are drawn before the processes are there


def entitle(figure: Figure, text: str) -> None:
    """Write the title over a figure, in as many lines as its width needs."""
    across = int(figure.get_figwidth() * 72 / (0.58 * _TITLE))  # letters of this size, somewhat wider than the mean one
    figure.suptitle(textwrap.fill(text, across), fontsize=_TITLE)


def look_of(number: int) -> dict[str, Any]:
    """Return colour and line style of the method of this number; the styles differ where the colours come again."""
    return {
        "color": COLOURS[number % len(COLOURS)], "linestyle": DASHES[(number + number // len(COLOURS)) % len(DASHES)],
    }  # fmt: skip


def put_legend(figure: Figure, panels: Iterable[Axes]) -> None:
    """Put one legend of all panels at the right of a figure of ours."""
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside right center", fontsize=8)


def figure_of(axes: Axes) -> Figure:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return figure


def explain_lines(axes: Axes, **options: Any) -> None:
    """Put the legend of axes that were given beside them where the figure makes room by itself, else into them."""
    beside = figure_of(axes).get_layout_engine() is not None
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if beside else {"loc": "best"}
    axes.legend(**{"fontsize": 7.5, "framealpha": 0.85, "frameon": not beside} | place | options)


@final
class _Shown(Axes):
    """The axes of a figure of its own: what a notebook shows of them is the picture of the figure."""

    def _repr_png_(self) -> bytes:
        written = BytesIO()
        figure_of(self).savefig(written, format="png", dpi=110)
        return written.getvalue()


@contextmanager
def axes_in(ax: Axes | None, width: float, height: float, style: Any = STYLE) -> Iterator[Axes]:
    """Yield `ax`, in the caller's style, or the axes of a new figure in ours; pyplot knows nothing of either."""
    if ax is not None:
        yield ax
        return
    with rc_context(style):
        yield Figure(figsize=(width, height), layout="constrained").add_subplot(axes_class=_Shown)


def save(name: str, drawing: Drawing, folder: Path) -> list[Path]:
    """Write ``name.svg``, ``name.png`` and ``name.csv`` into `folder`; return the three paths."""
    figure, numbers = drawing
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        scale: Any = axis.get_transform()  # which has a base where it is logarithmic
        for of, put in (
            (axis.get_major_formatter(), axis.set_major_formatter),
            (axis.get_minor_formatter(), axis.set_minor_formatter),
        ):
            if type(of) is LogFormatterSciNotation:
                put(_Powers(scale.base, of.labelOnlyBase))
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.{ending}" for ending in ENDINGS]
    with rc_context(STYLE):
        FigureCanvasAgg(figure)  # one for layout and PNG: a new one would measure all texts anew
        join_minor_ticks(figure)
        engine = figure.get_layout_engine()
        if engine is not None:  # the layout once for both files: each `savefig` would draw twice to compute it
            figure.set_dpi(_DPI)  # letters fit their pixels: at another resolution words are some percent wider
            engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(paths[1], dpi=_DPI, pil_kwargs={"compress_level": _PACKED})
        figure.savefig(paths[0], metadata={"Date": None})
    numbers.to_csv(paths[2], index=False)
    return paths


@final
class _Powers(LogFormatterSciNotation):
    """The labels of a logarithmic axis as plain text, −2×10⁻¹²: as Matplotlib's formulas each costs a parser's run."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        inside = re.sub(r"^\$\\mathdefault\{(.*)\}\$$", r"\1", super().__call__(x, pos)).replace(r"\times", "×")
        return re.sub(r"\^\{(-?\d+)\}", lambda power: power[1].translate(_RAISED), inside).replace("-", "−")


@final
class _MinorTicks(Line2D):
    """The minor ticks of an axis without labels, found anew as they are drawn: they depend on the axis' length."""

    def __init__(self, axis: Any, locator: Any) -> None:
        across, name = axis.axis_name == "x", axis.axis_name
        style: Any = rcParams
        mark: Any = TICKDOWN if across else TICKLEFT
        super().__init__(
            [], [], linestyle="none", marker=mark, clip_on=False,
            markersize=style[f"{name}tick.minor.size"], markeredgewidth=style[f"{name}tick.minor.width"],
            color=style[f"{name}tick.color"], zorder=axis.get_zorder(),
        )  # fmt: skip
        self._axis, self._locator, self._across = axis, locator, across
        axis.axes.add_artist(self)
        self.set_transform(axis.axes.get_xaxis_transform("tick1") if across else axis.axes.get_yaxis_transform("tick1"))
        self.set_in_layout(False)

    def draw(self, renderer: Any) -> None:
        """Draw the ticks that the locator sets now."""
        to_length = self._axis.get_transform().transform
        low, high = np.sort(to_length(np.asarray(self._axis.get_view_interval(), dtype=float)))
        places = np.asarray(self._locator(), dtype=float)
        major = to_length(np.asarray(self._axis.get_majorticklocs(), dtype=float))
        with np.errstate(divide="ignore", invalid="ignore"):
            at = to_length(places)
        near = _SAME * (high - low)
        seen = (at >= low - near) & (at <= high + near)
        if major.size:
            seen &= np.abs(at[:, None] - major).min(axis=1) > near
        zeros = np.zeros(int(seen.sum()))
        self.set_data(*((places[seen], zeros) if self._across else (zeros, places[seen])))
        super().draw(renderer)


def join_minor_ticks(figure: Figure) -> None:
    """Let each logarithmic axis of `figure`, its view final, draw its minor ticks without labels as one artist."""
    plain: list[tuple[Any, Any]] = []  # all before the first is changed: panels of one axis share their locator
    for axes in figure.axes:
        axis: Any
        for axis, side in ((axes.xaxis, "bottom"), (axes.yaxis, "left")):
            if axis.get_scale() != "log" or axis.get_tick_params(which="minor").get(side) is False:
                continue
            places = axis.get_minorticklocs()
            if len(places) and not any(axis.get_minor_formatter().format_ticks(places)):
                plain.append((axis, axis.get_minor_locator()))
    for axis, locator in plain:
        _MinorTicks(axis, locator)
        axis.set_minor_locator(NullLocator())


@contextmanager
def drawn(
    drawable: Sequence[Drawable], folder: Path, tell: Callable[[str], None]
) -> Iterator[Callable[[], dict[str, list[Path]]]]:
    """Yield what returns the files of each drawing by its name, drawn meanwhile in forked processes where there are
    several, the last first: those of the whole field take the longest. `tell(name)` is called before each wait."""
    backwards = drawable[::-1]

    def saved(number: int) -> list[Path]:
        name, draw = backwards[number]
        return save(name, draw(), folder)

    def collect(take: Callable[[int], list[Path]]) -> dict[str, list[Path]]:
        files = {}
        for number, (name, _) in enumerate(backwards):
            tell(name)
            files[name] = take(number)
        return files

    size = min(os.cpu_count() or 1, _MOST, len(drawable))
    if size < 2 or len(drawable) < _WORTH or not CAN_FORK:
        files = collect(saved)
        yield lambda: files
        return
    with WorkerPool(saved, size) as pool, ThreadPoolExecutor(1) as collector:
        pool.begin(range(len(drawable)))
        collected = collector.submit(collect, lambda _: pool.take())
        try:
            yield collected.result
        except BaseException:
            pool.interrupt()
            raise
