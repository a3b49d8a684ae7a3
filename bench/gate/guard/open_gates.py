"""The gates of this process, for the moment of a fork: a child that an optimiser forks must not evaluate uncounted.

`os.register_at_fork` keeps what it is given for ever, so there is one entry for all gates, made with the first. The
set of gates stands behind a wall: it would lead from an import to the counters.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any
from weakref import WeakSet

from calibench.bench.gate.guard.wall import walled


def _registrar() -> Callable[[Any], None]:
    gates: WeakSet[Any] = WeakSet()
    registered = False

    def add(gate: Any) -> None:
        nonlocal registered
        if not registered and hasattr(os, "register_at_fork"):
            registered = True
            os.register_at_fork(before=before, after_in_child=after)
        gates.add(gate)

    def before() -> None:
        for gate in list(gates):
            gate.before_fork()

    def after() -> None:
        for gate in list(gates):
            gate.after_fork()

    wall: Callable[[Any], None] = walled(add)
    return wall


opened = _registrar()  # opened(gate): from now on each fork is told to it, for as long as somebody holds it
