"""What all drawings share: colours, line styles, and how a drawing and its numbers are written side by side.

Colours are Okabe and Ito's, then four of Tol's muted ones; line styles differ as well. Drawings are made beside the
rest of a report (`drawn`): a figure takes half a second, and no figure waits for another. Matplotlib is imported by
what draws (`new_figure`, `axes_in`, `save`), not with this module: it takes as long as all else of a report.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.report.shared.kept import ENDINGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Drawing = tuple["Figure", pd.DataFrame]
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


@contextmanager
def new_figure(width: float, height: float, style: Any = (), layout: Any = "constrained") -> Iterator[Figure]:
    """Yield a figure of this size [inches], to be drawn in our style with changes; pyplot knows nothing of it."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE | dict(style)):
        yield Figure(figsize=(width, height), layout=layout)


@contextmanager
def axes_in(ax: Axes | None, width: float, height: float, style: Any = ()) -> Iterator[Axes]:
    """Yield `ax`, in the caller's style, or the axes of a new figure in ours; pyplot knows nothing of either."""
    if ax is not None:
        yield ax
        return
    from calibench.bench.report.shared.artists import Shown

    with new_figure(width, height, style) as figure:
        yield figure.add_subplot(axes_class=Shown)


def save(name: str, drawing: Drawing, folder: Path) -> list[Path]:
    """Write ``name.svg``, ``name.png`` and ``name.csv`` into `folder`; return the three paths."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from calibench.bench.report.shared import artists

    figure, numbers = drawing
    artists.put_powers(figure)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.{ending}" for ending in ENDINGS]
    with rc_context(STYLE):
        FigureCanvasAgg(figure)  # one for layout and PNG: a new one would measure all texts anew
        artists.join_minor_ticks(figure)
        engine = figure.get_layout_engine()
        if engine is not None:  # the layout once for both files: each `savefig` would draw twice to compute it
            figure.set_dpi(_DPI)  # letters fit their pixels: at another resolution words are some percent wider
            engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(paths[1], dpi=_DPI, pil_kwargs={"compress_level": _PACKED})
        figure.savefig(paths[0], metadata={"Date": None})
    numbers.to_csv(paths[2], index=False)
    return paths


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
