"""Number poses and visits from 0, whatever numbers or words a file has for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.tables.no_value import NO_VALUE
from calibench.discrepancy.model.measured.data import MeasuredData


def told_visits(data: MeasuredData) -> MeasuredData:
    """Return the data with poses and visits numbered through.

    Files may number the visits of each pose from the start, or not number some rows. A visit ends where another pose
    or visit was read between, by time: what comes later is no back-to-back repeat.
    """
    if "pose_id" in data:
        data = data.with_columns({"pose_id": _numbered(data["pose_id"])})
    if "visit_id" not in data:
        return data
    visit = _numbered(data["visit_id"])
    if "pose_id" in data:
        visit = data["pose_id"] * (visit.max() + 1) + visit
    if "t_s" in data and np.ptp(data["t_s"]) > 0:
        order = np.argsort(data["t_s"], kind="stable")
        begun = np.cumsum(np.diff(visit[order], prepend=visit[order[0]] - 1) != 0)
        visit = np.empty(len(data), dtype=np.int64)
        visit[order] = begun
    return data.with_columns({"visit_id": np.unique(visit, return_inverse=True)[1].ravel()})


def _numbered(ids: NDArray[Any]) -> NDArray[np.int64]:
    """Return ids as whole numbers, (n,), equal where they are equal; each that is missing has one of its own."""
    words = np.asarray(ids).astype(str)
    numbers = (
        np.unique(ids if np.asarray(ids).dtype.kind in "iuf" else words, return_inverse=True)[1]
        .ravel()
        .astype(np.int64)
    )
    missing = np.isin(np.char.lower(np.char.strip(words)), sorted(NO_VALUE))
    return np.where(missing, numbers.max() + 1 + np.arange(len(words)), numbers)
