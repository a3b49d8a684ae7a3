"""A wall: a function that can be called and not looked into.

What stands behind a closure is open to all: ``f.__closure__[0].cell_contents``. The wrapper that `functools.lru_cache`
makes for ``maxsize=0`` is written in C, keeps nothing of what passes, and shows nobody what it wraps once its
``__wrapped__`` is taken away. It costs no frame of Python.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any


def walled(function: Callable[..., Any]) -> Any:
    """Return `function` behind a wall: the same calls, and no attribute that leads to it."""
    wall: Any = lru_cache(maxsize=0)(function)
    del wall.__wrapped__
    return wall
