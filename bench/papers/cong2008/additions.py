"""What Cong et al. 2008 adds to a report: Tables 2 to 7 beside ours, Figs 3 to 5, two more, where the paper stopped."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import pandas as pd

from calibench.bench.papers.cong2008 import figures, printed_figures
from calibench.bench.papers.cong2008.tables import TABLES
from calibench.bench.report.shared.drawing import Drawing
from calibench.bench.report.study.additions import AddedFigure, Addition, Mark, PrintedTable, TableSection
from calibench.bench.statistics.names.labels import options_seen
from calibench.bench.statistics.summary import problem_name
from calibench.problems import constants

_PAPER = "cong2008"
_NOTE = (
    "Ours are medians, quartiles below where there is more than one run, at this study's budget. A printed number that "
    "is wrong is crossed out, and what to read stands beside it. The sampling plans are not published, so values agree "
    "in kind, not in digits."
)


def _column_title(key: str) -> str:
    """Return a printed column in words.

    >>> _column_title("table2.j1_n3"), _column_title("table4.j3_12"), _column_title("table3.j2")
    ('J1, 3 samples', 'J3, 12 parameters', 'J2')
    """
    error, _, rest = key.partition(".")[2].removeprefix("de_").partition("_")
    more = f"{rest[1:]} samples" if rest.startswith("n") else f"{rest} parameters" if rest else ""
    return error.upper() + (f", {more}" if more else "")


def printed_values(name: str, problem: Any) -> Mapping[str, float]:
    """Return the paper's calibrated values for this problem and error function, corrected for misprints."""
    options = getattr(problem, "options", {})  # a user's own has none, and no printed values
    error = str(options.get("error", "")).lower()
    section3 = options.get("gauge") == "ya2" or options.get("paper_section") == 3
    if name == "sensor_zero":
        key = f"table2.{error}_n{options['n']}"
    elif name == "link_length":
        key = f"table3.{error}"
    elif name in ("full11", "full12") and section3:
        key = f"table4.{error}_{name[-2:]}"
    elif name == "full12":
        key = f"table7.de_{error}"
    else:
        return {}
    try:
        column = constants.column(_PAPER, key)
    except KeyError:
        return {}
    return {quantity: column[quantity] for quantity in column}


def where_searches_stopped(runs: pd.DataFrame) -> tuple[Mark, ...]:
    """Mark where GA, PSO and DE stop in section 4, if these runs of its problem went as far."""
    stop = constants.column(_PAPER, "section44")["evaluations"]
    first = runs.iloc[0]
    if problem_name(first["problem"], first["problem_options"], but=("error",)) != "full12":
        return ()
    return (Mark(stop, "where the paper stopped its searches"),) if float(runs["budget"].max()) >= stop else ()


def _draw_gauge(_: pd.DataFrame, __: pd.DataFrame) -> Drawing:
    return figures.gauge()


def _draw_plans(_: pd.DataFrame, __: pd.DataFrame) -> Drawing:
    return figures.plans()


ADDITION = Addition(
    sections=(
        TableSection(
            anchor="papers",
            link="the papers' tables",
            heading="The paper's tables beside ours",
            note=_NOTE,
            tables=tuple(
                PrintedTable(name, f"Table {name.removeprefix('table')} of Cong et al. 2008", build, _column_title)
                for name, build in TABLES.items()
            ),
        ),
    ),
    figures=(
        *(
            AddedFigure(
                name,
                printed_figures.caption(error),
                partial(printed_figures.applies, error),
                partial(printed_figures.draw, error),
            )
            for name, error in printed_figures.FIGURES.items()
        ),
        AddedFigure(
            "gauge",
            "The printed 12-parameter results on the curve along which no reading changes",
            lambda runs: bool(runs["problem"].eq("full12").any()),
            _draw_gauge,
        ),
        AddedFigure(
            "plans",
            "What sampling plans can tell of 11 parameters",
            lambda runs: len(options_seen(runs, "full11", "plan")) > 1,
            _draw_plans,
        ),
    ),
    printed_values=printed_values,
    marks=where_searches_stopped,
)
