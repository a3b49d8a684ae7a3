"""Figures of merit: those of the machines have columns of their own, any other that a problem returns is kept as JSON.

``runs.parquet`` has one text column `merit` for the others, so that its columns are the same for every problem.
`offered` makes a number column ``merit.KEY`` of each key for who reads the rows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

COLUMNS = (
    "gauge_phi", "kmrmse", "kmrmse_aligned", "parameter_error_mm", "parameter_error_rad", "parameter_error_mm_aligned",
    "parameter_error_rad_aligned",
)  # fmt: skip
PREFIX = "merit."


def merit_columns(found: Any) -> dict[str, Any]:
    """Return what ``merit(x)`` gave as columns of a row: those of `COLUMNS`, and `merit`, JSON of all others.

    A number that is not finite is null there, as JSON has none. Raises `TypeError` for what is no number, flag or text.
    """
    if not isinstance(found, Mapping):
        raise TypeError(f"merit(x) returned {type(found).__name__}: names and numbers are needed, {{name: number}}")
    own = {key: float(value) for key, value in found.items() if key in COLUMNS}
    others = {str(key): _plain(key, value) for key, value in found.items() if key not in COLUMNS}
    return own | ({"merit": json.dumps(others, sort_keys=True, ensure_ascii=False)} if others else {})


def offered(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with a column ``merit.KEY`` for each key of their column `merit`; without any, as they are.

    A key whose values are numbers in all runs is a column of floats, NaN where a run has none; any other is text.
    """
    told = runs["merit"].dropna()
    if told.empty:
        return runs
    read = {index: json.loads(text) for index, text in told.items()}
    keys = list(dict.fromkeys(key for each in read.values() for key in each))
    columns = {}
    for key in keys:
        values = [read.get(index, {}).get(key) for index in runs.index]
        numbers = all(value is None or isinstance(value, int | float) for value in values)
        columns[PREFIX + key] = (
            pd.Series([np.nan if v is None else float(v) for v in values], runs.index, dtype=float)
            if numbers
            else pd.Series([None if v is None else str(v) for v in values], runs.index, dtype="str")
        )
    return pd.concat([runs, pd.DataFrame(columns)], axis=1)


def medians(cell: pd.DataFrame) -> dict[str, float]:
    """Return the median of each ``merit.KEY`` of numbers over the runs of a cell, NaN where no run has it."""
    keys = [key for key in cell.columns if key.startswith(PREFIX) and pd.api.types.is_float_dtype(cell[key])]
    return {f"{key}_median": float(cell[key].median()) for key in keys}


def _plain(key: Any, value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.item() if np.size(value) == 1 else value.tolist()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    raise TypeError(f"merit(x) gave {key}={value!r:.60}: a number, True or False, or text is needed")
