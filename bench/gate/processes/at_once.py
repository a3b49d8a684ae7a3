"""Calls that do not wait for each other, in as many forked processes as there are cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

from calibench.bench.gate.processes.forked_worker import CAN_FORK
from calibench.bench.gate.processes.worker_pool import WorkerPool

T = TypeVar("T")


def at_once(calls: Sequence[Callable[[], T]]) -> list[T]:
    """Return what each call returns, in their order. The first call begins first: the longest should stand there.

    What a call changes in memory stays in its process, what it returns is pickled, and what it raises is raised here.
    With one core, or where the system cannot fork, they are made here, one after the other.
    """
    size = min(os.cpu_count() or 1, len(calls))
    if size < 2 or not CAN_FORK:
        return [call() for call in calls]
    with WorkerPool(lambda number: calls[number](), size) as pool:
        pool.begin(range(len(calls)))
        return [pool.take() for _ in calls]
