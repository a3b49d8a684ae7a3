"""The critical-difference diagram: mean ranks of methods on a line, those that no test tells apart joined by a bar.

Source: Demsar, J. Machine Learning Research 7 (2006), figure 1.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing, figure_of
from calibench.bench.statistics.comparison.many_methods import Ranked

_LETTER = 0.07  # inches of a letter of a name
_LEAST = 1e-300  # p below it is rounding
_TICK = 0.25  # inches between two numbers of the scale, at least


def critical_difference(ranked: Ranked) -> Drawing:
    """Return the diagram of `ranked` and its numbers; raises `ValueError` where there is no test (`ranked.refused`)."""
    numbers = ranks_of(ranked)
    with rc_context(STYLE):
        figure = Figure(figsize=ranks_size(ranked), layout="constrained")
        draw_ranks(figure.add_subplot(), ranked)
    return figure, numbers


def ranks_size(ranked: Ranked) -> tuple[float, float]:
    """Return width and height of the diagram [inches]."""
    return 3.6 + sum(_beside(ranked)), 1.1 + 0.24 * len(ranked.methods) + 0.12 * len(ranked.groups())


def _beside(ranked: Ranked) -> tuple[float, float]:
    """Return the room for the names at the left and at the right [inches]."""
    half = (len(ranked.methods) + 1) // 2
    left, right = (max(map(len, names), default=0) for names in (ranked.methods[:half], ranked.methods[half:]))
    return _LETTER * (left + 8), _LETTER * (right + 8)


def draw_ranks(axes: Axes, ranked: Ranked) -> None:
    """Draw the diagram, the names of the methods within the axes: what stands beside them is left alone."""
    count = len(ranked.methods)
    bars = ranked.groups()
    low, high = np.floor(ranked.mean_ranks.min()), np.ceil(ranked.mean_ranks.max())
    span = max(high - low, 1.0)
    inches = axes.get_position().width * figure_of(axes).get_figwidth()
    least, most = _beside(ranked)
    scale = max(inches - least - most, 0.25 * inches)
    size = 8 * min(1.0, (inches - scale) / (least + most))  # of names, which in narrow axes are smaller
    least, most = least * size / 8, most * size / 8
    inch = 1.12 * span / scale  # the lines to the names take 6 % on either side
    for i, (name, rank) in enumerate(zip(ranked.methods, ranked.mean_ranks.tolist(), strict=True)):
        left = i < (count + 1) // 2
        depth = -1.0 - 0.12 * len(bars) * 4 - (i if left else count - 1 - i)
        edge = low - 0.06 * span if left else high + 0.06 * span
        axes.plot([rank, rank, edge], [0, depth, depth], color=COLOURS[6], linewidth=0.8)
        axes.text(edge, depth, f" {name}  {rank:.2f} ", ha="right" if left else "left", va="center", fontsize=size)
    for i, (first, last) in enumerate(bars):
        ends = [ranked.mean_ranks[first] - 0.01 * span, ranked.mean_ranks[last] + 0.01 * span]
        axes.plot(ends, [-0.5 - 0.45 * i] * 2, color=COLOURS[0], linewidth=3, solid_capstyle="butt")
    axes.plot([low, low + ranked.critical_difference], [1.1, 1.1], color=COLOURS[1], linewidth=2)
    axes.text(low, 1.3, f"critical difference {ranked.critical_difference:.2f}", fontsize=8, va="bottom")
    axes.set_ylim(-1.6 - 0.48 * len(bars) - (count + 1) // 2, 2.2)
    axes.set_xlim(low - 0.06 * span - least * inch, high + 0.06 * span + most * inch)
    axes.set_yticks([])
    axes.set_xticks(np.arange(low, high + 1, max(1, np.ceil(span / min(12, scale / _TICK)))))
    axes.spines[["left", "right", "bottom"]].set_visible(False)
    axes.spines["top"].set_visible(True)
    axes.spines["top"].set_position(("data", 0.0))
    axes.spines["top"].set_bounds(low, high)
    axes.xaxis.tick_top()
    axes.grid(False)
    chance = f"= {ranked.p:.2g}" if ranked.p > _LEAST else f"< {_LEAST:g}"
    axes.set_title(
        f"mean rank over {ranked.blocks} blocks, 1 is best; Friedman p {chance}\njoined: not told apart at "
        f"{ranked.level:g} (Nemenyi)",
        fontsize=8,
    )


def ranks_of(ranked: Ranked) -> pd.DataFrame:
    """Return the numbers of the diagram; raises `ValueError` where there is no test."""
    if ranked.refused:
        raise ValueError(ranked.refused)
    return pd.DataFrame(
        {
            "method": ranked.methods,
            "mean_rank": ranked.mean_ranks,
            "p_against_best_holm": ranked.against_best,
            "p_against_best_nemenyi": ranked.nemenyi[0],
            "blocks": ranked.blocks,
            "critical_difference": ranked.critical_difference,
            "friedman_p": ranked.p,
        }
    )
