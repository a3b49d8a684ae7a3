"""Dask workers of this machine: processes of one thread, which end when the process that started them does.

They are started anew and not forked, with Python's path of the sweep's own process, so that a script needs no guard
around its main part. A worker that was lost is replaced.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from time import monotonic
from typing import final

import dask
from distributed import Worker

from calibench.bench.workers.dask.task import close_all

_ENTER = (
    "import sys; sys.path[:] = {path!r}; from calibench.bench.workers.dask.local import serve; serve(*sys.argv[1:])"
)
_APART = None if sys.platform == "win32" else 0  # a process group of its own: Ctrl-C is for us to handle
_EARLY = 5.0  # seconds: a worker that ends by itself sooner could not begin
_TRIES = 3
_END = 10.0  # seconds for a worker to end by itself


@final
class LocalWorkers:
    """So many workers of the scheduler at `address`; their files are below `scratch`."""

    def __init__(self, address: str, workers: int, scratch: str) -> None:
        self._address, self._scratch = address, scratch
        self._early = 0
        self._processes = [self._start() for _ in range(workers)]

    def refill(self) -> None:
        """Replace the workers that have ended. Raises `OSError` where they end as soon as they are started."""
        for place, (process, began) in enumerate(self._processes):
            if process.poll() is None:
                continue
            by_itself = process.returncode is not None and process.returncode >= 0
            self._early = self._early + 1 if by_itself and monotonic() - began < _EARLY else 0
            if self._early >= _TRIES:
                raise OSError(f"workers end as soon as they are started, with exit code {process.returncode}")
            self._processes[place] = self._start()

    def close(self) -> None:
        """End them with all that they have started."""
        for process, _ in self._processes:
            if process.stdin is not None:
                process.stdin.close()
        for process, _ in self._processes:
            try:
                process.wait(_END)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self) -> tuple[subprocess.Popen[bytes], float]:
        command = [sys.executable, "-P", "-c", _ENTER.format(path=sys.path), self._address, self._scratch]
        return subprocess.Popen(command, stdin=subprocess.PIPE, process_group=_APART), monotonic()


def serve(address: str, scratch: str) -> None:
    """Be a worker of the scheduler at `address` until the process that started us closes our standard input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends us
    logging.disable(logging.CRITICAL)  # what matters is told by what happens to the runs
    dask.config.set({"distributed.worker.profile.enabled": False})  # it looks a hundred times a second
    threading.Thread(target=_follow, daemon=True).start()
    with suppress(Exception):  # the scheduler is gone, say
        asyncio.run(_serve(address, scratch))
    _end()


async def _serve(address: str, scratch: str) -> None:
    async with Worker(
        address, nthreads=1, memory_limit="0", dashboard=False, local_directory=scratch, host="127.0.0.1"
    ) as worker:
        await worker.finished()


def _follow() -> None:
    """Wait until the parent is gone or wants us no more; then go."""
    os.read(0, 1)
    _end()


def _end() -> None:
    close_all()
    os._exit(0)
