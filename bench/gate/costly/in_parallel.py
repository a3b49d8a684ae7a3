"""The batches of one run, evaluated by several processes at once: the same points, the same values, in the same order.

A problem with a `batch` of its own is given slices of the points, if it says ``splits_batches = True``: that the value
of a point has the same bits whatever points stand beside it. Of any other problem each point is one call in some
process. The gate then still asks for one value after another, and gets those that have been computed ahead: it counts,
traces and stops as if it had waited for each.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.bench.gate.calls import Calls, raise_again
from calibench.bench.gate.processes.worker_pool import WorkerPool

Array = NDArray[np.float64]
_SLICES = 4  # for each process, so that one slow slice does not keep the others waiting for long


@contextmanager
def in_parallel(calls: Calls, processes: int) -> Iterator[Calls]:
    """Yield `calls` whose batches are evaluated by that many processes, which end with the block."""

    def work(job: tuple[Any, ...]) -> Any:
        what, *given = job
        return calls.one(*given) if what == "one" else getattr(calls, what)(*given)

    with WorkerPool(work, processes) as pool:
        if calls.batch is None:
            yield _one_by_one(calls, pool)
        else:
            lock = Lock()
            below = calls.below and _in_slices("below", pool, processes, lock)
            yield replace(calls, batch=_in_slices("batch", pool, processes, lock), below=below)


def _one_by_one(calls: Calls, pool: WorkerPool) -> Calls:
    """Return calls whose `ahead` begins the values of a batch; each is then waited for when it is asked for."""
    awaited: list[Array] = []  # the last one is the next; the processes begin when that is asked for
    begun = [False]
    lock = Lock()  # a method may ask from several threads: each gets the value of its point

    def ahead(points: Array) -> None:
        with lock:
            awaited[:] = list(np.array(points, dtype=np.float64))[::-1]
            begun[0] = False

    def value(x: Array, fixed: Any) -> float:
        with lock:
            if awaited and np.array_equal(awaited[-1], x):
                if not begun[0]:
                    pool.begin([("one", point) for point in reversed(awaited)])
                    begun[0] = True
                awaited.pop()
                known: float = pool.take()
                return known
            awaited.clear()
        return calls.one(x)

    return replace(calls, value=value, again=raise_again, ahead=ahead)


def _in_slices(what: str, pool: WorkerPool, processes: int, lock: Any) -> Any:
    def batch(points: Array, *limits: Array) -> Array:
        if not len(points):
            return np.empty(0)
        size = max(1, -(-len(points) // (_SLICES * processes)))
        slices = [slice(i, i + size) for i in range(0, len(points), size)]
        with lock:
            pool.begin([(what, points[s], *(limit[s] for limit in limits)) for s in slices])
            return np.concatenate([pool.take() for _ in slices])

    return batch
