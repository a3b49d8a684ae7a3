"""The critical-difference diagram: mean ranks of methods on a line, those that no test tells apart joined by a bar.

Source: Demsar, J. Machine Learning Research 7 (2006), figure 1.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from calibench.bench.report.shared.drawing import COLOURS, STYLE, Drawing
from calibench.bench.statistics.comparison.many_methods import Ranked


def critical_difference(ranked: Ranked) -> Drawing:
    """Return the diagram of `ranked` and its numbers; raises `ValueError` where there is no test (`ranked.refused`)."""
    if ranked.refused:
        raise ValueError(ranked.refused)
    count = len(ranked.methods)
    bars = ranked.groups()
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 1.1 + 0.24 * count + 0.12 * len(bars)), layout="constrained")
        axes = figure.add_subplot()
        low, high = np.floor(ranked.mean_ranks.min()), np.ceil(ranked.mean_ranks.max())
        span = max(high - low, 1.0)
        for i, (name, rank) in enumerate(zip(ranked.methods, ranked.mean_ranks.tolist(), strict=True)):
            left = i < (count + 1) // 2
            depth = -1.0 - 0.12 * len(bars) * 4 - (i if left else count - 1 - i)
            edge = low - 0.06 * span if left else high + 0.06 * span
            axes.plot([rank, rank, edge], [0, depth, depth], color=COLOURS[6], linewidth=0.8)
            axes.text(edge, depth, f" {name}  {rank:.2f} ", ha="right" if left else "left", va="center", fontsize=8)
        for i, (first, last) in enumerate(bars):
            ends = [ranked.mean_ranks[first] - 0.01 * span, ranked.mean_ranks[last] + 0.01 * span]
            axes.plot(ends, [-0.5 - 0.45 * i] * 2, color=COLOURS[0], linewidth=3, solid_capstyle="butt")
        axes.plot([low, low + ranked.critical_difference], [1.1, 1.1], color=COLOURS[1], linewidth=2)
        axes.text(low, 1.3, f"critical difference {ranked.critical_difference:.2f}", fontsize=8, va="bottom")
        axes.set_ylim(-1.6 - 0.48 * len(bars) - (count + 1) // 2, 2.2)
        axes.set_xlim(low - 0.06 * span, high + 0.06 * span)
        axes.set_yticks([])
        axes.spines[["left", "bottom"]].set_visible(False)
        axes.spines["top"].set_visible(True)
        axes.spines["top"].set_position(("data", 0.0))
        axes.xaxis.tick_top()
        axes.grid(False)
        axes.set_title(
            f"mean rank over {ranked.blocks} blocks, 1 is best; Friedman p = {ranked.p:.2g}; joined: not told apart at "
            f"{ranked.level:g} (Nemenyi)",
            fontsize=8,
        )
    numbers = pd.DataFrame(
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
    return figure, numbers
