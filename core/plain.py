"""Values as JSON can hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from typing import Any

import numpy as np


def finite(value: Any) -> Any:
    """Return what JSON can hold: a number that is none becomes null, NumPy's numbers and arrays their like.

    A dataclass becomes a mapping of its fields, as they are named.

    >>> finite({"gain": float("nan"), "ci95": (1.0, float("inf"))})
    {'gain': None, 'ci95': [1.0, None]}
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: finite(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value
