"""What a worker does: execute run after run, tell of each as it ends."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import final

from calibench.bench.execution.costly import ReplayFolder, forget_replay
from calibench.bench.execution.run import Run
from calibench.bench.workers.packs import Pack
from calibench.core import user_file

_TOLD_EVERY = 0.05  # seconds
FOR_EVER = 1e9  # seconds: a time limit that only asks for a process of its own


@final
@dataclass(frozen=True)
class How:
    """How runs are executed: `inner` processes for the batches of each, and where values are kept to go on from."""

    inner: int = 1
    replay: ReplayFolder | None = None


@final
@dataclass(frozen=True)
class Notice:
    """A run has ended and is kept: its row's status, and the seconds that all of it took."""

    run_id: str
    status: str
    seconds: float


def do_pack(pack: Pack, how: How, keep: Callable[[Run], None], tell: Callable[[list[Notice]], None]) -> None:
    """Execute the runs of a pack in order; `keep` each, and `tell` of those that were kept, short ones together.

    A run that a worker was lost with is executed in a process of its own, which tells what ends it.
    """
    ended: list[Notice] = []
    told_at = perf_counter()
    with user_file.as_loaded():
        for job in pack.jobs:
            spec = replace(job.spec, time_limit=job.spec.time_limit or FOR_EVER) if pack.alone else job.spec
            began = perf_counter()
            run = spec.execute(inner=how.inner, replay=how.replay)
            keep(run)
            if how.replay is not None:
                forget_replay(how.replay.folder, job.run_id)
            now = perf_counter()
            ended.append(Notice(run.run_id, run.record.status, now - began))
            if now - told_at > _TOLD_EVERY or job is pack.jobs[-1]:
                tell(ended)
                ended, told_at = [], now


def find_user_code(path: Sequence[str]) -> None:
    """Let this process import a user's classes from where the sweep's own process does."""
    sys.path[:] = list(dict.fromkeys([*sys.path, *path]))
