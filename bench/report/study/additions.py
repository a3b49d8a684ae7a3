"""Additions of others to the report of a study: printed tables beside ours, figures, marks in a figure, links.

The report itself knows no paper. A package with published numbers of a problem describes them as an `Addition`, the
command passes the additions to `bench.report.study.write.write_report`, and each decides by the runs whether it
applies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import pandas as pd

from calibench.bench.report.shared.drawing import Drawing


@final
@dataclass(frozen=True)
class PrintedTable:
    """A printed table, which the runs fill with values beside the printed ones.

    `build` takes the runs and returns a row for each printed number and method, none where the runs have no part in it.
    Columns: table (the key of a printed column), method, options, start, target, budget, quantity, unit, printed (NaN
    where nothing is), read (what to read where the print is wrong), why, median, q1, q3, n; true, where it is known.
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


def _no_values(name: str, problem: Any) -> Mapping[str, float]:
    return {}


def _no_marks(runs: pd.DataFrame) -> Sequence[Mark]:
    return ()


def _no_links(folder: Path) -> Mapping[str, str]:
    return {}


@final
@dataclass(frozen=True)
class Addition:
    """All that one source adds; what it leaves out adds nothing.

    `printed_values(name, problem)` are the printed results of a problem, parameter -> value, beside which the table of
    calibrated values sets ours. `marks(runs)` are those of one problem's chart, under all its error functions.
    `links(folder)` are other pages for the study in `folder`: words -> address, relative to the folder.
    """

    sections: tuple[TableSection, ...] = ()
    figures: tuple[AddedFigure, ...] = ()
    printed_values: Callable[[str, Any], Mapping[str, float]] = _no_values
    marks: Callable[[pd.DataFrame], Sequence[Mark]] = _no_marks
    links: Callable[[Path], Mapping[str, str]] = _no_links


Additions = Sequence[Addition]
FilledSection = tuple[TableSection, tuple[tuple[PrintedTable, pd.DataFrame], ...]]  # only tables that have rows


def filled_sections(additions: Additions, runs: pd.DataFrame) -> list[FilledSection]:
    """Return the sections of which the runs fill a table, each with the tables they fill."""
    filled = []
    for section in (section for addition in additions for section in addition.sections):
        tables = ((table, table.build(runs)) for table in section.tables)
        if found := tuple((table, rows) for table, rows in tables if not rows.empty):
            filled.append((section, found))
    return filled


def figures_for(additions: Additions, runs: pd.DataFrame) -> Iterator[AddedFigure]:
    """Yield the figures that belong beside these runs."""
    yield from (figure for addition in additions for figure in addition.figures if figure.applies(runs))


def marks_for(additions: Additions, runs: pd.DataFrame) -> list[Mark]:
    """Return the marks in the chart of these runs of one problem."""
    return [mark for addition in additions for mark in addition.marks(runs)]


def captions_of(additions: Additions) -> dict[str, str]:
    """Return name -> caption of every figure that may be added, in order."""
    return {figure.name: figure.caption for addition in additions for figure in addition.figures}


def links_for(additions: Additions, folder: Path) -> dict[str, str]:
    """Return the links to other pages: words -> address."""
    return {words: address for addition in additions for words, address in addition.links(folder).items()}


def printed_values(additions: Additions, name: str, problem: Any) -> dict[str, float]:
    """Return the printed results of this problem, parameter -> value; none where no addition knows it."""
    return {key: value for addition in additions for key, value in addition.printed_values(name, problem).items()}
