"""A trial of a user's class in a child process before this process builds it: it may crash or hang there.

Planning a sweep builds every problem and optimiser once. A crash there would end the command, and with it the runs of
all other problems.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from calibench.bench.execution.request.own_problem import OPTIONAL
from calibench.bench.gate.processes.forked_worker import CAN_FORK, Lost, apart
from calibench.core.registry import Registry
from calibench.core.sources import file_of, is_ours

PATIENCE = 60.0  # seconds for building
_READ = ("lower", "upper", "start", "data_id", "name", "options", "traits", "library", *OPTIONAL)


def probe(registry: Registry[Any], name: str, options: Mapping[str, Any]) -> Lost | None:
    """Return why the entry `name` cannot be built with `options`: its process ended, or took too long; None: it can.

    An exception is not reported here, because building raises it again. A process that ended may have been killed from
    outside, as a worker may: it is at fault the second time. Our own classes are not tried, and nothing is tried where
    a system cannot fork.
    """
    factory = registry.factory(name)
    file = file_of(getattr(factory, "func", factory).__module__)
    if not CAN_FORK or (file is not None and is_ours(file)):
        return None

    def look() -> None:
        built = registry.make(name, **options)
        for attribute in _READ:
            with suppress(Exception):
                getattr(built, attribute, None)

    ended: Lost | None = None
    for _ in range(2):
        try:
            apart(look, PATIENCE)
        except Lost as lost:
            if lost.timed_out:
                why = f"{registry.kind} {name} was not built within {PATIENCE:g} s"
                return Lost(lost.error_type, why, timed_out=True)
            if lost.error_type == "ProcessDied":
                ended = Lost(lost.error_type, f"as {registry.kind} {name} was built, {lost.error}")
                continue
        return None
    return ended
