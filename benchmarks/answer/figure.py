"""The pictures of the answer: what each leading method has brought to the noise at which charge, and their ranks."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from benchmarks.answer.standing import curves, leading, named, ranked
from calibench.bench.report.shared.drawing import COLOURS, DASHES, STYLE
from calibench.bench.report.study.figures import critical_difference

PICTURE, RANKS = Path("docs/images/answer.png"), Path("docs/images/answer_ranks.png")
DRAWN, RANKED = 2, 4  # methods of each kind in the pictures


def draw_ranks(table: pd.DataFrame) -> tuple[Figure, pd.DataFrame]:
    """Return the critical-difference diagram of the leading methods at the largest budget, and its numbers.

    Raises `ValueError` where the blocks are too few for a test.
    """
    largest = table[table["budget"] == table["budget"].max()]
    names = set(leading(largest, RANKED)["name"])
    mine = [named(*key) in names for key in zip(largest["method"], largest["ends"], strict=True)]
    return critical_difference(ranked(largest[mine])[0])


def draw(table: pd.DataFrame) -> tuple[Figure, pd.DataFrame]:
    """Return the picture of the largest budget in the table, and its numbers (`curves`)."""
    largest = table[table["budget"] == table["budget"].max()]
    names = leading(largest, DRAWN)["name"].tolist()
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
            xscale="log",
            xlim=(1, largest["budget"].max()),
            ylim=(0, 1.02),
            xlabel="charged evaluations",
            ylabel="share of instances as good as noise",
        )
        figure.legend(loc="outside right upper")
    return figure, numbers
