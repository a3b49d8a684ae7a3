"""Figures of merit: those of the machines have columns of their own; all others of a problem are kept as JSON.

``runs.parquet`` has one text column `merit` for the others, so that its columns are the same for every problem.
`offered` makes a number column ``merit.KEY`` of each key for readers of the rows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench.bench.execution.run_row import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

_OTHERS = "merit"  # the column of all that has none of its own
_OWN = tuple(column.name for column in COLUMNS if column.group == "merit" and column.name != _OTHERS)
PREFIX = "merit."
_INFINITE = ("inf", "-inf")


@final
@dataclass(frozen=True)
class Merit:
    """Figures of merit: of each column of the machines' its number, None where there is none; all others as JSON."""

    columns: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(_OWN))
    others: str | None = None


def merit_of(found: Any) -> Merit:
    """Return the result of ``merit(x)`` as columns of a row.

    A number that is not finite is null there, as JSON has none; of the others an infinite one is the text "inf" or
    "-inf". Raises `TypeError` for a value that is not a number,
    flag or text.
    """
    if not isinstance(found, Mapping):
        raise TypeError(f"merit(x) returned {type(found).__name__}: names and numbers are needed, {{name: number}}")
    own = {key: _number(key, value) for key, value in found.items() if key in _OWN}
    others = {str(key): _plain(key, value) for key, value in found.items() if key not in _OWN}
    text = json.dumps(others, sort_keys=True, ensure_ascii=False) if others else None
    return Merit(dict.fromkeys(_OWN) | own, text)


def offered(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with a column ``merit.KEY`` for each key of their column `merit`; without any, as they are.

    A key whose values are flags in all runs is a column of flags, one of numbers a column of floats, NaN where a run
    has none; any other is text.
    """
    import pandas as pd

    told = runs["merit"].dropna()
    if told.empty:
        return runs
    read = {index: json.loads(text) for index, text in told.items()}
    keys = list(dict.fromkeys(key for each in read.values() for key in each))
    columns = {}
    for key in keys:
        columns[PREFIX + key] = _column([read.get(index, {}).get(key) for index in runs.index], runs.index)
    return pd.concat([runs, pd.DataFrame(columns)], axis=1)


def medians(cell: pd.DataFrame) -> dict[str, float]:
    """Return of each ``merit.KEY`` over the runs of a cell the median, or of flags the share.

    Keys are ``merit.KEY_median`` and ``merit.KEY_share``; text has none. NaN where no run of this cell has the key.
    """
    import pandas as pd

    found = {}
    for key in (key for key in cell.columns if key.startswith(PREFIX)):
        if pd.api.types.is_bool_dtype(cell[key]):
            found[f"{key}_share"] = float("nan") if cell[key].isna().all() else float(cell[key].mean())
        elif pd.api.types.is_float_dtype(cell[key]):
            found[f"{key}_median"] = float(cell[key].median())
    return found


def heading(key: str) -> str:
    """Return the title of a column of `medians`.

    >>> heading("merit.overshoot_median"), heading("merit.stable_share")
    ('overshoot, median', 'stable, share')
    """
    name, _, what = key.removeprefix(PREFIX).rpartition("_")
    return f"{name}, {what}"


def _column(values: list[Any], index: pd.Index) -> pd.Series:
    import pandas as pd

    known = [value for value in values if value is not None]
    if all(value in _INFINITE or type(value) in (int, float) for value in known):
        values = [float(value) if value in _INFINITE else value for value in values]
        known = [value for value in values if value is not None]
    if known and all(isinstance(value, bool) for value in known):
        return pd.Series(values, index, dtype="boolean")
    if all(isinstance(value, int | float) for value in known):
        return pd.Series([np.nan if v is None else float(v) for v in values], index, dtype=float)
    return pd.Series([None if v is None else str(v) for v in values], index, dtype="str")


def _number(key: str, value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError):
        raise TypeError(
            f"merit(x) gave {key}={value!r:.60}: a number is needed, as a column of that name has"
        ) from None


def _plain(key: Any, value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.item() if np.size(value) == 1 else value.tolist()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else None if np.isnan(value) else str(value)
    raise TypeError(f"merit(x) gave {key}={value!r:.60}: a number, True or False, or text is needed")
