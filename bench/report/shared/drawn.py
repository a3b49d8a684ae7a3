"""Draw many figures at once: a figure takes half a second, and no figure waits for another."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from calibench.bench.gate.processes.forked_worker import CAN_FORK
from calibench.bench.gate.processes.worker_pool import WorkerPool
from calibench.bench.report.shared.drawing import Drawing, save

Drawable = tuple[str, Callable[[], Drawing]]  # its name, and what draws it
_MOST = 4  # processes: each holds what it changes of the runs
_WORTH = 3  # figures: fewer are drawn before the processes are there


def save_all(
    drawable: Sequence[Drawable], folder: Path, tell: Callable[[str], None]
) -> Iterator[tuple[str, list[Path]]]:
    """Yield each drawing's name and the paths of its files in `folder`, in the given order.

    `tell(name)` is called before each wait for one. They are drawn in forked processes, as many as there are cores; in
    this one, where there is one core or the system cannot fork. Raises what a drawing raises.
    """

    def saved(number: int) -> list[Path]:
        name, draw = drawable[number]
        return save(name, draw(), folder)

    size = min(os.cpu_count() or 1, _MOST, len(drawable))
    if size < 2 or len(drawable) < _WORTH or not CAN_FORK:
        for number, (name, _) in enumerate(drawable):
            tell(name)
            yield name, saved(number)
        return
    with WorkerPool(saved, size) as pool:
        pool.begin(range(len(drawable)))
        for name, _ in drawable:
            tell(name)
            yield name, pool.take()
