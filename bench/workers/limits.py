"""The limits of the process (memory, files, processor time), restored after a run that has changed them.

A run may set such a limit for itself, to fail early instead of filling the memory. It is that of the whole process, so
later runs there would fail too. A hard limit that was lowered can be raised again by root alone.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import cache

Limits = Mapping[int, tuple[int, int]]  # number of a resource -> its limit, and the highest it may be set to


def limits() -> Limits:
    """Return the limits of this process; none where the system has none."""
    if sys.platform == "win32":
        return {}
    import resource

    return {number: resource.getrlimit(number) for number in _numbers()}


def put_back(before: Limits) -> bool:
    """Set the limits of this process to what they were; return whether they are so now."""
    if limits() == before:
        return True
    if sys.platform != "win32":
        import resource

        for number, limit in before.items():
            with suppress(OSError, ValueError):
                resource.setrlimit(number, limit)
    return limits() == before


@cache
def _numbers() -> tuple[int, ...]:
    import resource

    return tuple({getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")})
