"""A drawing is a function; the numbers behind it are its attribute `data`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, ParamSpec, Protocol, cast

import pandas as pd
from matplotlib.axes import Axes

Draw = ParamSpec("Draw")
Data = ParamSpec("Data")


class _Drawing(Protocol, Generic[Draw, Data]):
    """A function that draws, and `data`, which returns the numbers that it draws."""

    __call__: Callable[Draw, Axes]
    data: Callable[Data, pd.DataFrame]


def with_data(data: Callable[Data, pd.DataFrame]) -> Callable[[Callable[Draw, Axes]], _Drawing[Draw, Data]]:
    """Let a function that draws have the numbers of its drawing as the attribute `data`."""

    def give(draw: Callable[Draw, Axes]) -> _Drawing[Draw, Data]:
        drawing = cast("_Drawing[Draw, Data]", draw)
        drawing.data = data
        return drawing

    return give
