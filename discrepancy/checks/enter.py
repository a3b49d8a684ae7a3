"""Checks of any table of readings, whatever the machine: valid, split, poses and visits, time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibench.core.tables.marks import valid_rows
from calibench.discrepancy.model.measured.data import DataError, MeasuredData, with_split
from calibench.discrepancy.model.measured.visits import told_visits


def entered(data: MeasuredData) -> MeasuredData:
    """Return the rows that are marked as valid, with `split`, poses and visits in one spelling, and notes.

    Where poses are given without visits, rows of one pose that follow each other are one visit. Data that were entered
    before are returned unchanged. Raises `DataError` for unknown words in `valid` and `split`, and for a time that is
    not a number.
    """
    if not len(data):
        raise DataError(f"{data.name}: there are no readings; a row for each is needed")
    data = _timed(_only_valid(data))
    return _with_visits(told_visits(with_split(data)))


def file_rows(data: MeasuredData) -> NDArray[np.intp]:
    """Return the number in the file, from 1, of each row that `entered` keeps, (m,)."""
    return np.flatnonzero(_marked(data)) + 1


def _marked(data: MeasuredData) -> NDArray[np.bool_]:
    if "valid" not in data:
        return np.ones(len(data), dtype=bool)
    try:
        return valid_rows(data["valid"])
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None


def _only_valid(data: MeasuredData) -> MeasuredData:
    valid = _marked(data)
    if valid.all():
        return data
    if not valid.any():
        raise DataError(f"{data.name}: column valid marks no row as valid; mark those that are to be used with 1")
    count = int((~valid).sum())
    return data.rows(valid).with_note(f"{count} row{'s are' if count > 1 else ' is'} marked as not valid and left out")


def _timed(data: MeasuredData) -> MeasuredData:
    if "t_s" not in data:
        return data
    try:
        time = np.asarray(data["t_s"], dtype=float)
    except (TypeError, ValueError):
        raise DataError(
            f"{data.name}: column t_s holds {str(data['t_s'][0])!r}; seconds, or times such as 2026-03-01T12:30:05, "
            "are needed"
        ) from None
    back = int((np.diff(time) < 0).sum())
    note = f"t_s runs backwards at {back} place{'s' if back > 1 else ''}: the rows are taken in the order of t_s"
    return data.with_note(note) if back and note not in data.notes else data


def _with_visits(data: MeasuredData) -> MeasuredData:
    """Return the data with one visit for each run of rows of one pose, in time, where only poses are given."""
    if "visit_id" in data or "pose_id" not in data:
        return data
    order = np.argsort(data["t_s"], kind="stable") if "t_s" in data else np.arange(len(data))
    pose = np.asarray(data["pose_id"])[order]
    if len(np.unique(pose)) in (1, len(pose)):
        return data
    visit = np.empty(len(data), dtype=np.int64)
    visit[order] = np.cumsum(np.diff(pose, prepend=pose[0]) != 0)
    return data.with_columns({"visit_id": visit})


def visits_at(data: MeasuredData, inputs: Sequence[str]) -> MeasuredData:
    """Return the data with poses and visits found from the commanded `inputs`, where no column gives them.

    Successive rows with equal inputs, and with equal words and levels in all columns of few values, are one visit.
    """
    if not inputs or data.has("visit_id") or data.has("pose_id"):
        return data
    few = [n for n, c in data.columns.items() if n in inputs or len(np.unique(c)) <= len(data) // 3]
    pose = np.zeros(len(data), dtype=np.int64)
    for name in few:
        own = np.unique(data[name], return_inverse=True)[1].reshape(-1)
        pose = np.unique(pose * (own.max() + 1) + own, return_inverse=True)[1].reshape(-1)
    visit = np.cumsum(np.diff(pose, prepend=pose[:1]) != 0)
    if len(np.unique(visit)) in (1, len(data)):
        return data
    note = f"rows that follow each other at the same {', '.join(inputs)} are taken as repeats"
    return data.with_columns({"pose_id": pose, "visit_id": visit}).with_note(note)
