"""`Found`: the content of a file of measured data, whatever its format, before names and units are interpreted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final


@final
@dataclass(frozen=True)
class Found:
    """Columns name -> (n,), the units stated of them, what stands before the header or as metadata, and notes.

    `of_day` are the columns that were times of day, such as 14:03:22.
    """

    columns: dict[str, Any]
    units: Mapping[str, str]
    said: str = ""
    notes: tuple[str, ...] = ()
    of_day: frozenset[str] = frozenset()
