"""What all drawings share: colours, line styles, and how a drawing and its numbers are written side by side.

Colours are Okabe and Ito's, then four of Tol's muted ones, told apart by colour-blind readers too; line styles differ
as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

Drawing = tuple[Figure, pd.DataFrame]

COLOURS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7F6A00",
    "#882255", "#332288", "#888888", "#117733",
)  # fmt: skip
DASHES: Any = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (3, 1)), (0, (1, 1)), (0, (7, 2)))
STYLE: Any = {
    "axes.axisbelow": True, "axes.grid": True, "axes.spines.right": False, "axes.spines.top": False, "font.size": 9,
    "grid.alpha": 0.25, "grid.linewidth": 0.6, "legend.frameon": False, "svg.hashsalt": "calibench",
    "svg.fonttype": "none",
}  # fmt: skip


def save(name: str, drawing: Drawing, folder: Path) -> list[Path]:
    """Write ``name.svg``, ``name.png`` and ``name.csv`` into `folder`; return the three paths."""
    figure, numbers = drawing
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.{ending}" for ending in ("svg", "png", "csv")]
    with rc_context(STYLE):
        figure.savefig(paths[0], metadata={"Date": None})
        figure.savefig(paths[1], dpi=160)
    numbers.to_csv(paths[2], index=False)
    return paths
