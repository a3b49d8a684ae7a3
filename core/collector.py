"""The garbage collector of a `bench` process, which rests while modules are loaded.

What modules make stays until the end: to look through all of it again and again slows a small run, and finds nothing.
"""

from __future__ import annotations

import gc
from functools import cache

_OBJECTS = 50_000  # made anew before garbage is looked for


@cache
def rest() -> None:
    """Collect nothing until `resume` is called, and less often afterwards; later calls in this process do nothing."""
    gc.disable()
    gc.set_threshold(_OBJECTS)


@cache
def resume() -> None:
    """Collect again, but look no more at what has been made so far; later calls in this process do nothing."""
    gc.freeze()
    gc.enable()
