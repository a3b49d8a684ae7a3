"""What comes home from a Dask cluster: messages over a queue of its scheduler; and what keeps them in the folder.

The queue holds few messages. Where this process is slower than its workers they wait, and its memory does not grow.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, final

from calibench.bench.execution.in_progress import Progress, to_files, was_silent
from calibench.bench.execution.run import Run
from calibench.bench.provenance.environment import Provenance
from calibench.bench.store.journal import Journal
from calibench.bench.workers.dask.cluster import Cluster

_MESSAGES = 64  # on their way, after which workers wait for us
_LOOK = 0.5  # seconds between two looks at whether we are closed


@final
class Keeper:
    """The journals of this process, and how far the long runs are.

    Rows say where they were made, so each kind of machine has a journal of its own.
    """

    def __init__(self, folder: Path, study: str) -> None:
        self._folder, self._study = folder, study
        self._journals: dict[tuple[Any, ...], Journal] = {}
        self._publish = to_files(folder)
        self._running: dict[str, Progress] = {}

    def keep(self, run: Run) -> None:
        """Write a finished run."""
        made = tuple(getattr(run.record, key) for key in Provenance.__annotations__)
        if made not in self._journals:
            origin = dict(zip(Provenance.__annotations__, made, strict=True))
            self._journals[made] = Journal(self._folder, self._study, origin=origin)
        self._journals[made].append(run)
        self._forget(run.run_id)

    def note(self, progress: Progress) -> None:
        """Write how far a run is, where `bench status` looks."""
        if progress["ended"]:
            self._forget(progress["run_id"])
            return
        self._running[progress["run_id"]] = progress
        with suppress(OSError):  # no run is lost by it
            self._publish(progress)

    def was_silent(self, run_id: str) -> bool:
        """Tell whether a run that was lost had made no evaluation for ten minutes; from here on it does not run."""
        silent = was_silent(self._folder, run_id)
        self._forget(run_id)
        return silent

    def _forget(self, run_id: str) -> None:
        progress = self._running.pop(run_id, None)
        if progress is not None:
            with suppress(OSError):
                self._publish({**progress, "ended": True})

    def close(self) -> None:
        """Forget what runs: nothing does any more."""
        for run_id in list(self._running):
            self._forget(run_id)


@final
class Inbox:
    """The messages that have come over the scheduler's queue; so many at most, then the workers wait."""

    def __init__(self, there: Cluster, name: str) -> None:
        from distributed import Queue

        self._cluster = there
        make: Any = Queue  # it has no types
        self._queue = make(name, client=there.client, maxsize=_MESSAGES)
        self._come: queue.Queue[Any] = queue.Queue(_MESSAGES)
        self._closed = False
        threading.Thread(target=self._receive, daemon=True).start()

    @property
    def is_empty(self) -> bool:
        """Tell whether nothing waits to be heard."""
        return self._come.empty()

    def get(self, patience: float) -> Mapping[str, Any] | None:
        """Return the next message; None where none comes in so many seconds. Raises `ClusterError`."""
        with suppress(queue.Empty):
            come: Mapping[str, Any] | BaseException = self._come.get(timeout=patience)
            if isinstance(come, BaseException):
                raise self._cluster.lost(come)
            return come
        return None

    def close(self) -> None:
        """Hear nothing more."""
        self._closed = True
        with suppress(Exception):
            if self._cluster.client.status == "running":
                self._queue.put(None, timeout=_LOOK)  # it wakes the receiver, else the end of the client does
                self._queue.close()

    def _receive(self) -> None:
        come: Any = None
        while not self._closed:
            try:
                come = self._queue.get()
            except BaseException as error:
                come = error
            while not self._closed:
                with suppress(queue.Full):
                    self._come.put(come, timeout=_LOOK)
                    break
            if isinstance(come, BaseException):
                return
