"""The end of a `bench` process: at once, after everything that anybody registered for the end has been done.

An interpreter that ends in its own way takes all modules apart before; that is some 6 % of the time of a small run.
"""

from __future__ import annotations

import atexit
import os
import sys
from contextlib import suppress
from functools import cache

_code: list[int] = []


@cache
def at_once() -> None:
    """Let this process end at once when `ends_with` has been called. To be called before libraries are loaded.

    What is registered first is done last: theirs comes before.
    """
    atexit.register(_leave)


def ends_with(code: int) -> None:
    """State the exit code. Without a call the interpreter ends in its own way, as after an exception."""
    _code[:] = [code]


def _leave() -> None:
    if not _code:
        return
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):  # nobody reads on, or it is closed: the interpreter tells it in its own way
        return
    if os.name == "posix" and "ctypes" in sys.modules:  # what C code has printed stands in buffers of its own
        with suppress(OSError, AttributeError):
            sys.modules["ctypes"].CDLL(None).fflush(None)
    os._exit(_code[0])
