"""Drawings that are made beside the rest of a report: a figure takes half a second, and no figure waits for another."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import TracebackType
from typing import final

from calibench.bench.gate.processes.forked_worker import CAN_FORK
from calibench.bench.gate.processes.worker_pool import WorkerPool
from calibench.bench.report.shared.drawing import Drawing, save

Drawable = tuple[str, Callable[[], Drawing]]  # its name, and what draws it
_MOST = 4  # processes: each holds what it changes of the runs
_WORTH = 3  # figures: fewer are drawn before the processes are there


@final
class Drawings(Mapping[str, Path]):
    """Drawings by name, as a context: the path of an SVG, which is there when it is asked for.

    They are drawn in forked processes, as many as there are cores, the last first: those of the whole field come last
    and take the longest. Where there is one core or the system cannot fork, they are drawn in this process, as the
    context begins. `tell(name)` is called before the wait for each. Asking for a drawing raises what it raised.
    """

    def __init__(self, drawable: Sequence[Drawable], folder: Path, tell: Callable[[str], None]) -> None:
        self._drawable, self._folder, self._tell = drawable, folder, tell
        self._files: dict[str, Future[list[Path]]] = {name: Future() for name, _ in drawable}
        self._pool: WorkerPool | None = None
        self._collector = threading.Thread(target=self._collect, name="drawings", daemon=True)

    def files(self) -> list[Path]:
        """Return the paths of all files of all drawings, when they are there."""
        return [path for each in self._files.values() for path in each.result()]

    def __enter__(self) -> Drawings:
        size = min(os.cpu_count() or 1, _MOST, len(self._drawable))
        if size > 1 and len(self._drawable) >= _WORTH and CAN_FORK:
            self._pool = WorkerPool(self._saved, size)
            self._pool.__enter__()
            self._pool.begin(range(len(self._drawable))[::-1])
            self._collector.start()
        else:
            for number in range(len(self._drawable))[::-1]:
                name, _ = self._drawable[number]
                self._tell(name)
                self._files[name].set_result(self._saved(number))
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        if self._pool is not None:
            if failed is not None:
                self._pool.interrupt()
            self._collector.join()
            self._pool.close()

    def __getitem__(self, name: str) -> Path:
        return self._files[name].result()[0]

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def _saved(self, number: int) -> list[Path]:
        name, draw = self._drawable[number]
        return save(name, draw(), self._folder)

    def _collect(self) -> None:
        """Take the answers of the processes as they come; after one that raised the others have nobody to wait for."""
        assert self._pool is not None
        for name, future in reversed(self._files.items()):
            try:
                self._tell(name)
                future.set_result(self._pool.take())
            except BaseException as error:  # of a drawing, or as the processes are ended: whoever asks is told
                for other in self._files.values():
                    if not other.done():
                        other.set_exception(error)
                return
