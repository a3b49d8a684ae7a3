"""Figs 3, 4 and 5 of Cong et al. 2008 drawn as they are printed: log10 of J over evaluations, of GA, PSO and DE.

The curves of the print cannot be read from its text; what the text and Table 6 say of them, where each ends, can. That
is a dotted line in the method's colour. One panel is of the runs at hand, the other of the kept run at the paper's own
budget (``results/reference/``), where there is one and the runs at hand are shorter.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibench.bench.papers.cong2008.tables import runs_of
from calibench.bench.papers.evidence import Evidence
from calibench.bench.papers.files import kept
from calibench.bench.report.shared.drawing import STYLE, Drawing, entitle, look_of, put_legend, save
from calibench.bench.report.study.figures import convergence_bands, spread_told
from calibench.bench.store.runs import ResultStore
from calibench.problems import constants

FIGURES = {"cong2008_fig3": "J1", "cong2008_fig4": "J2", "cong2008_fig5": "J3"}
_STUDY = "cong2008"
_METHODS = ("ga", "pso", "de")


def caption(error: str) -> str:
    """Return the caption of the figure of an error function."""
    number = {"J1": 3, "J2": 4, "J3": 5}[error]
    return f"Fig. {number} of Cong et al. 2008, axes as printed: GA, PSO and DE under {error}; dotted, the printed ends"


def applies(error: str, runs: pd.DataFrame) -> bool:
    """Tell whether these are runs of the figure: of its problem, each method in one setting and to one budget."""
    mine = _of(error, runs)
    settings = mine.groupby("optimizer")["optimizer_options"].nunique()
    return len(settings) == len(_METHODS) and settings.max() == 1 and mine["budget"].nunique() == 1


def draw(error: str, runs: pd.DataFrame, traces: pd.DataFrame) -> Drawing:
    """Draw the figure of an error function, beside it at the paper's budget."""
    panels = [(_of(error, runs), traces)]
    store = kept(_STUDY)
    if store is not None:
        longer = _of(error, ResultStore(store).runs())
        if len(longer) and longer["budget"].max() > panels[0][0]["budget"].max():
            panels.append((longer, ResultStore(store).traces()))
    printed = {method: constants.column("cong2008", f"table6.{method}").entries[error.lower()] for method in _METHODS}
    numbers = []
    with rc_context(STYLE):
        figure = Figure(figsize=(1.9 + 4.0 * len(panels), 3.9), layout="constrained")
        both = list(np.atleast_1d(figure.subplots(1, len(panels), sharey=True)))
        for axes, (mine, points) in zip(both, panels, strict=True):
            numbers.append(_draw_panel(axes, mine, points))
            for i, (method, end) in enumerate(printed.items()):
                label = f"{method.upper()}, printed end {end.printed:g}"
                axes.axhline(np.log10(end.printed), color=look_of(i)["color"], lw=1.1, linestyle=":", label=label)
        both[0].set_ylabel(f"log10 of {error} [{printed['de'].unit.replace('^2', '²').replace('^4', '⁴')}]")
        put_legend(figure, both)
        entitle(figure, caption(error))
    return figure, pd.concat(numbers, ignore_index=True)


def write(evidence: Evidence, folder: Path) -> list[Path]:
    """Write the figures that the runs of the paper's own study fill; return their SVG files."""
    mine = evidence.runs[evidence.runs["study"] == _STUDY]
    return [
        save(name, draw(error, mine, evidence.traces), folder)[0]
        for name, error in FIGURES.items()
        if applies(error, mine)
    ]


def _draw_panel(axes: Axes, runs: pd.DataFrame, traces: pd.DataFrame) -> pd.DataFrame:
    """Draw medians and quartiles over the evaluations, which the print has on a linear axis."""
    budget = int(runs["budget"].max())
    drawn = convergence_bands(runs.assign(method=runs["optimizer"]), traces).assign(budget=budget)
    for i, method in enumerate(_METHODS):
        band = drawn[drawn["method"] == method]
        low, middle, high = (np.log10(band[name].clip(lower=1e-300)) for name in ("q1", "median", "q3"))
        axes.fill_between(band["charged"], low, high, color=look_of(i)["color"], alpha=0.18, linewidth=0)
        axes.plot(band["charged"], middle, label=f"{method.upper()}, ours", **look_of(i))
    axes.set(xlim=(0, budget), xlabel="evaluations")
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(f"{budget:,} evaluations: {spread_told(runs)}".replace(",", "\u202f"), fontsize=9)
    return drawn


def _of(error: str, runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of a figure, by the three methods."""
    return runs_of(runs[runs["optimizer"].isin(_METHODS)], "full12", {"error": error, "gauge": "xa2"})
