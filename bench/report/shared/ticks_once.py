"""The ticks of a finished drawing, placed once for each size: a third of the time that Matplotlib takes to write it.

While it lays out and draws, Matplotlib places all ticks of an axis anew some seven times, and measures their labels as
often, though nothing has changed since. What it found is kept for as long as view, place and resolution are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from matplotlib.figure import Figure

_PLACES, _MEASURES = "_update_ticks", "_get_ticklabel_bboxes"


@contextmanager
def ticks_once(figure: Figure) -> Iterator[None]:
    """Keep, within the context, where the ticks of `figure` stand; its artists must not be changed in it.

    The two methods are Matplotlib's own and not of its public face: where one is missing, all is as without the
    context, only slower.
    """
    axes = [axis for each in figure.axes for axis in (each.xaxis, each.yaxis)]
    known: list[Any] = [axis for axis in axes if hasattr(axis, _PLACES) and hasattr(axis, _MEASURES)]
    for axis in known:
        setattr(axis, _PLACES, _placed_once(axis, getattr(axis, _PLACES)))
        setattr(axis, _MEASURES, _measured_once(axis, getattr(axis, _MEASURES)))
    try:
        yield
    finally:
        for axis in known:
            delattr(axis, _PLACES)
            delattr(axis, _MEASURES)


def _seen_at(axis: Any) -> tuple[Any, ...]:
    """Return what the places of ticks depend on in a drawing that is finished."""
    figure = axis.get_figure(root=True)
    return (*axis.get_view_interval().tolist(), *axis.axes.bbox.bounds, figure.dpi)


def _placed_once(axis: Any, place: Callable[[], list[Any]]) -> Callable[[], list[Any]]:
    at: tuple[Any, ...] = ()
    ticks: list[Any] = []

    def update_ticks() -> list[Any]:
        nonlocal at, ticks
        now = _seen_at(axis)
        if now != at:
            at, ticks = now, place()
        return list(ticks)

    return update_ticks


def _measured_once(axis: Any, measure: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    at: tuple[Any, ...] = ()
    boxes: Any = None

    def get_ticklabel_bboxes(ticks: Any, renderer: Any) -> Any:
        nonlocal at, boxes
        now = (*_seen_at(axis), renderer, tuple(ticks))
        if now != at:
            at, boxes = now, measure(ticks, renderer)
        return boxes

    return get_ticklabel_bboxes
