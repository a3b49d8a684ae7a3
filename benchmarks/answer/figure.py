"""The picture of the answer: how many blocks each of the leading methods has brought to the noise, at which charge."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from benchmarks.answer.compact import KNOWS
from benchmarks.answer.standing import curves, standing
from calibench.bench.report.shared.drawing import COLOURS, DASHES, STYLE

PICTURE = Path("docs/images/answer.png")
_OF_EACH = 2  # methods of each kind


def leading(table: pd.DataFrame) -> list[str]:
    """Return the first two methods of each kind, with residuals, with gradients, with values alone."""
    found = standing(table)
    return [str(name) for kind in KNOWS for name in found[found["knows"] == kind]["name"].head(_OF_EACH)]


def draw(table: pd.DataFrame) -> tuple[Figure, pd.DataFrame]:
    """Return the picture of the largest budget in the table, and its numbers (`curves`)."""
    largest = table[table["budget"] == table["budget"].max()]
    names = leading(largest)
    numbers = curves(largest, names)
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.6), layout="constrained")
        axes = figure.subplots()
        for i, name in enumerate(names):
            mine = numbers[numbers["name"] == name]
            line = {"color": COLOURS[i], "linestyle": DASHES[i % len(DASHES)], "label": name}
            end = [largest["budget"].max(), mine["share"].max() if len(mine) else 0.0]
            at, share = [1, *mine["charged"], end[0]], [0.0, *mine["share"], end[1]]
            axes.step(at, share, where="post", **line)
        axes.set(
            xscale="log", ylim=(0, 1.02), xlabel="charged evaluations", ylabel="share of instances as good as noise"
        )
        figure.legend(loc="outside right upper")
    return figure, numbers
