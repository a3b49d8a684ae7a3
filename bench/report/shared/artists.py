"""Artists of Matplotlib that ours take the place of: axes that a notebook shows, labels of powers, minor ticks."""

import re
from io import BytesIO
from typing import Any, final

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKDOWN, TICKLEFT
from matplotlib.ticker import LogFormatterSciNotation, NullLocator

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SAME = 1e-5  # of the axis' length: Matplotlib draws no minor tick so near to a major one


@final
class Shown(Axes):
    """The axes of a figure of its own: what a notebook shows of them is the picture of the figure."""

    def _repr_png_(self) -> bytes:
        written = BytesIO()
        figure: Any = self.get_figure(root=True)
        figure.savefig(written, format="png", dpi=110)
        return written.getvalue()


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


def put_powers(figure: Figure) -> None:
    """Let the logarithmic axes of `figure` label their powers of ten as plain text."""
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        scale: Any = axis.get_transform()  # which has a base where it is logarithmic
        for of, put in (
            (axis.get_major_formatter(), axis.set_major_formatter),
            (axis.get_minor_formatter(), axis.set_minor_formatter),
        ):
            if type(of) is LogFormatterSciNotation:
                put(_Powers(scale.base, of.labelOnlyBase))
