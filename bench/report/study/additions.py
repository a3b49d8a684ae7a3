"""Additions of others to the report of a study: printed tables beside ours, figures, marks in a figure, links.

The report knows no paper: the command passes `Addition`s to `write_report`, and each decides by the runs if it applies.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import pandas as pd

from calibench.bench.report.shared.drawing import Drawing


@final
@dataclass(frozen=True)
class PrintedTable:
    """A printed table: `build(runs)` returns a row for each printed number and method, none where runs have no part.

    Columns: table (key of a printed column), method, options, start, target, budget, quantity, unit, printed (NaN:
    nothing is), read (where the print is wrong), why, median, q1, q3, n; true, where it is known.
    """

    name: str  # of the file: tables/NAME.csv
    title: str
    build: Callable[[pd.DataFrame], pd.DataFrame]
    column_title: Callable[[str], str] = str  # of a printed column, by its key


@final
@dataclass(frozen=True)
class TableSection:
    """A section of the page for printed tables: its heading, a note above the tables, and the words that link to it."""

    anchor: str
    link: str
    heading: str
    note: str
    tables: tuple[PrintedTable, ...]


@final
@dataclass(frozen=True)
class AddedFigure:
    """A figure that stands beside the runs, drawn from runs and traces where `applies(runs)`."""

    name: str
    caption: str
    applies: Callable[[pd.DataFrame], bool]
    draw: Callable[[pd.DataFrame, pd.DataFrame], Drawing]


@final
@dataclass(frozen=True)
class Mark:
    """A vertical line in the chart of evaluations to the goal, at a count of charged evaluations."""

    at: float
    label: str


@final
@dataclass(frozen=True)
class Addition:
    """All that one source adds: `marks(runs)` of a problem's chart, `links(folder)` to other pages of a study (words ->
    address). What it leaves out adds nothing."""

    sections: tuple[TableSection, ...] = ()
    figures: tuple[AddedFigure, ...] = ()
    marks: Callable[[pd.DataFrame], Sequence[Mark]] = lambda runs: ()
    links: Callable[[Path], Mapping[str, str]] = lambda folder: {}


Additions = Sequence[Addition]
FilledSection = tuple[TableSection, tuple[tuple[PrintedTable, pd.DataFrame], ...]]  # only tables that have rows
