"""The work of a worker: execute run after run, and report each as it ends."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import final

from calibench.bench.execution.costly import forget_replay
from calibench.bench.execution.run import Run
from calibench.bench.workers.packs import Pack
from calibench.core import own_state, user_file

_TOLD_EVERY = 0.05  # seconds
FOR_EVER = 1e9  # seconds: a time limit that only asks for a process of its own


@final
@dataclass(frozen=True)
class Notice:
    """A run has ended and is kept: its row's status, and the seconds that all of it took."""

    run_id: str
    status: str
    seconds: float


def do_pack(pack: Pack, keep: Callable[[Run, float], None], tell: Callable[[list[Notice]], None]) -> bool:
    """Execute the runs of a pack in order; `keep` each, which took so many seconds, and `tell` of those that were kept.

    Short ones are told of together. A run that a worker was lost with is executed in a process of its own, which tells
    what ends it. Returns False where no further run may be done in this process (`core.own_state`): it is to end
    at once, and the last run that was kept has not been told of, so that nobody gives it a pack meanwhile.
    """
    replay = pack.how.replay
    if replay is not None and not (Path(replay.folder) / "manifest.json").is_file():
        replay = None  # this machine does not share the folder
    ended: list[Notice] = []
    told_at = perf_counter()
    with user_file.as_loaded():
        for job in pack.jobs:
            spec = replace(job.spec, time_limit=job.spec.time_limit or FOR_EVER) if pack.alone else job.spec
            began = perf_counter()
            run = spec.execute(inner=pack.how.inner, replay=replay, run_id=job.run_id)
            now = perf_counter()
            keep(run, now - began)
            if replay is not None:
                forget_replay(replay.folder, job.run_id)
            ended.append(Notice(run.run_id, run.record.status, now - began))
            if own_state.lasting():
                tell(ended[:-1])
                return False
            if now - told_at > _TOLD_EVERY or job is pack.jobs[-1]:
                tell(ended)
                ended, told_at = [], now
    return True


def find_user_code(path: Sequence[str]) -> None:
    """Let this process import a user's classes from where the sweep's own process does."""
    sys.path[:] = list(dict.fromkeys([*sys.path, *path]))
