"""What Pashkevich et al. 2008 adds to a report: its measured deviations before and after calibration."""

from __future__ import annotations

import pandas as pd

from calibench.bench.papers.pashkevich2008.figures import DATA, orthoglide_residuals
from calibench.bench.report.shared.drawing import Drawing
from calibench.bench.report.study.additions import AddedFigure, Addition
from calibench.bench.statistics.names.labels import options_seen


def _experiments(runs: pd.DataFrame) -> list[str]:
    """Return the experiments with measured deviations that these runs fitted, in the order of the paper."""
    seen = options_seen(runs, "orthoglide6", "data")
    return [name for name in DATA if name in seen]


def _draw(runs: pd.DataFrame, _: pd.DataFrame) -> Drawing:
    return orthoglide_residuals(_experiments(runs))


ADDITION = Addition(
    figures=(
        AddedFigure(
            "orthoglide_residuals",
            "The Orthoglide's measured deviations before and after calibration",
            lambda runs: bool(_experiments(runs)),
            _draw,
        ),
    )
)
