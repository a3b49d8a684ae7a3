"""A wall: a function that can be called, and whose content cannot be reached.

A closure is readable: ``f.__closure__[0].cell_contents``. The wrapper that `functools.lru_cache` makes for
``maxsize=0`` is written in C, keeps no argument, and has no attribute that shows what it wraps (the ``__wrapped__`` of
a decorated function is put there by Python). It costs no frame of Python.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

_Wall: Any = type(lru_cache(maxsize=0)(len))  # made by itself it takes a hundredth of the time of the decorator


def walled(function: Callable[..., Any]) -> Any:
    """Return `function` behind a wall: the same calls, and no attribute that leads to it."""
    return _Wall(function, 0, False, tuple)  # function, size, typed, and the class of a count that nobody reads
