"""What to measure next, decided from a report alone: where to repeat readings, and which columns to add."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from typing import final

from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.report import Place, Report

_SHOWS = 0.01  # p below which a place is reported


@final
@dataclass(frozen=True)
class NextStep:
    """The advice of a report.

    `separating` are the measurements, in words, that would tell the rivals of a finding apart, or, where nothing is
    named, the names that came nearest. `unnamed` tells that
    something is missing which no effect explains: then `place` is where to take readings with repeats, None where these
    readings do not tell it. `columns` are columns of data -> labels of the effects that could be tested with them, each
    label once.
    """

    separating: tuple[str, ...]
    unnamed: bool
    place: Place | None
    columns: Mapping[tuple[str, ...], tuple[str, ...]]


def next_step(report: Report) -> NextStep:
    """Return what to measure next after the search of `report`."""
    return NextStep(
        separating=(
            *(finding.separated_by for finding in report.findings if finding.separated_by),
            *report.parted_by,
        ),
        unnamed=report.verdict in ("unknown", "partly"),
        place=clearest_place(report),
        columns=missing_columns(report),
    )


def clearest_place(report: Report) -> Place | None:
    """Return where an unnamed disagreement is strongest; None where nothing shows."""
    places = sorted((place for place in report.where if not isnan(place.p)), key=lambda place: place.p)
    return places[0] if places and places[0].p <= _SHOWS else None


def missing_columns(report: Report) -> dict[tuple[str, ...], tuple[str, ...]]:
    """Return the columns that would let more effects be tested -> labels of these effects.

    Columns that the same effects need are together.
    """
    by_column: dict[str, list[str]] = {}
    for item in report.not_testable:
        for column in item.columns if item.missing else ():
            by_column.setdefault(column, []).append(effect_label(report.machine, item.family, ""))
    asked: dict[tuple[str, ...], list[str]] = {}
    for column, labels in by_column.items():
        asked.setdefault(tuple(dict.fromkeys(labels)), []).append(column)
    return {tuple(columns): labels for labels, columns in asked.items()}
