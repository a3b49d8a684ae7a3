"""What all drawings share: colours, line styles, and how a drawing and its numbers are written side by side.

Colours are Okabe and Ito's, then four of Tol's muted ones, told apart by colour-blind readers too; line styles differ
as well.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, final

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

from calibench.bench.report.shared.minor_ticks import join_minor_ticks

Drawing = tuple[Figure, pd.DataFrame]

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


def entitle(figure: Figure, text: str) -> None:
    """Write the title over a figure, in as many lines as its width needs."""
    across = int(figure.get_figwidth() * 72 / (0.58 * _TITLE))  # letters of this size, somewhat wider than the mean one
    figure.suptitle(textwrap.fill(text, across), fontsize=_TITLE)


def look_of(number: int) -> dict[str, Any]:
    """Return colour and line style of the method of this number; the styles differ where the colours come again."""
    return {
        "color": COLOURS[number % len(COLOURS)],
        "linestyle": DASHES[(number + number // len(COLOURS)) % len(DASHES)],
    }


def others(count: int) -> str:
    """Return the name of the methods without a colour."""
    return f"{count} other{'s' if count > 1 else ''}"


def put_legend(figure: Figure, panels: Iterable[Axes]) -> None:
    """Put one legend of all panels at the right of a figure of ours."""
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside right center", fontsize=8)


def figure_of(axes: Axes) -> Figure:
    """Return the figure that the axes are in."""
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
    _write_powers_as_text(figure)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.{ending}" for ending in ("svg", "png", "csv")]
    with rc_context(STYLE):
        FigureCanvasAgg(figure)  # one for layout and PNG: a new one would measure all texts anew
        join_minor_ticks(figure)
        _lay_out_once(figure)
        figure.savefig(paths[1], dpi=_DPI, pil_kwargs={"compress_level": _PACKED})
        figure.savefig(paths[0], metadata={"Date": None})
    numbers.to_csv(paths[2], index=False)
    return paths


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@final
class _Powers(LogFormatterSciNotation):
    """The labels of a logarithmic axis as plain text, 10⁻³: as Matplotlib's formulas each costs a parser's run."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return _as_text(super().__call__(x, pos))


def _as_text(formula: str) -> str:
    """Return a label of Matplotlib's logarithmic axes as plain text.

    >>> _as_text(r"$\\mathdefault{-2\\times10^{-12}}$"), _as_text("")
    ('−2×10⁻¹²', '')
    """
    inside = re.sub(r"^\$\\mathdefault\{(.*)\}\$$", r"\1", formula).replace(r"\times", "×")
    return re.sub(r"\^\{(-?\d+)\}", lambda power: power[1].translate(_RAISED), inside).replace("-", "−")


def _lay_out_once(figure: Figure) -> None:
    """Compute the layout once for both files, because each `savefig` would draw twice to compute it."""
    engine = figure.get_layout_engine()
    if engine is not None:
        figure.set_dpi(_DPI)  # letters fit their pixels: at another resolution words are some percent wider
        engine.execute(figure)
        figure.set_layout_engine(None)


def _write_powers_as_text(figure: Figure) -> None:
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            scale: Any = axis.get_transform()  # which has a base where it is logarithmic
            for of, put in (
                (axis.get_major_formatter(), axis.set_major_formatter),
                (axis.get_minor_formatter(), axis.set_minor_formatter),
            ):
                if type(of) is LogFormatterSciNotation:
                    put(_Powers(scale.base, of.labelOnlyBase))
