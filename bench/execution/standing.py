"""The standing process: it makes the runs that have a time limit, one after the other, and is begun anew on overrun.

Each thread that makes such runs has one, forked as the first of them comes. It does all of a run (it builds, compiles,
searches, judges), so a class that hangs or crashes in any of these costs that run alone; what one run sets in it is put
back before the next (`core.own_state`), as in any process. It is begun anew where a run was cut, where one has left
something that cannot be put back, where its memory is too small, and where this process is no longer what it was when
it forked: it has loaded a further kernel, or has another working folder, environment, path or stream.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from math import inf
from typing import Any, final

from calibench import optimizers, problems
from calibench.bench.execution.costly import ReplayFolder
from calibench.bench.execution.kernels import is_own, load_new_kernels
from calibench.bench.execution.lost import lost_run
from calibench.bench.execution.request import check_numbers
from calibench.bench.execution.run import Found, Heard, Run, Spec, as_lost_in_judging
from calibench.bench.gate.processes import has_children
from calibench.bench.gate.time_limit import ROOM, Cut, Larger, Phase, Runner, Watch
from calibench.core import own_state
from calibench.core.process_state import SLOW

_PATIENCE = 5.0  # seconds to look again at what could not be built


@final
@dataclass(frozen=True)
class _Request:
    """A run to be made, or of one that was `found` cut its row; `building_s` is how long building may take."""

    spec: Spec
    inner: int
    replay: ReplayFolder | None
    building_s: float
    found: Found | None = None


@final
@dataclass(frozen=True)
class _Standing:
    """A standing process, and the state of this one as it was begun."""

    runner: Runner
    before: own_state.Kept

    def serves(self, room: int) -> bool:
        """Tell whether it can make the next run as this process would."""
        return self.runner.is_there and self.runner.room >= room and not self.before.change()


_STANDING: dict[threading.Thread, _Standing] = {}  # a process ends with the thread that began it
os.register_at_fork(after_in_child=_STANDING.clear)


def run_apart(spec: Spec, inner: int, replay: ReplayFolder | None, run_id: str) -> Run:
    """Make the run in the standing process of this thread, or the row of a run that is cut there.

    `run_id` is that of a run whose parts cannot be built.
    """
    check_numbers(spec.budget, spec.repetition, spec.target, spec.time_limit)
    began = datetime.now(UTC)
    limited = not (is_own(problems.registry, spec.problem) and is_own(optimizers.registry, spec.optimizer))
    building_s = spec.time_limit if limited and spec.time_limit is not None else inf
    found: Found | None = None
    while True:
        heard = Heard()
        with heard:
            run = _made(_Request(spec, inner, replay, building_s, found), heard)
        if not isinstance(run, Cut):
            return run
        if heard.draft is not None:
            return as_lost_in_judging(heard.draft, run)
        run_id = run_id if heard.name is None else heard.name.run_id
        if found is not None or run.phase == Phase.BUILDING:
            cut = run if found is None else found.cut
            ending, patience = cut.ending, _PATIENCE if spec.time_limit is None else min(spec.time_limit, _PATIENCE)
            return lost_run(
                spec, run_id, ending.error_type, ending.error, timed_out=cut.timed_out,
                wall_s=ending.wall_s, cpu_s=ending.cpu_s, patience=patience,
            )  # fmt: skip
        found = Found(run, began)


def _made(request: _Request, heard: Heard) -> Run | Cut:
    """Return what the standing process makes of a request; it gets more room where the run needs it."""
    spec, room = request.spec, ROOM
    limit = inf if spec.time_limit is None else spec.time_limit
    plain = _is_plain([spec.problem_options, spec.optimizer_options])
    if plain and load_new_kernels(spec):
        _begin_anew()  # from here, where they are
    while True:
        try:
            if plain:
                return _standing(room).ask(request, limit, heard.hear)  # type: ignore[no-any-return]
            runner = Runner(partial(_make_one, request), room)  # an object cannot be sent there
            return runner.ask(None, limit, heard.hear)  # type: ignore[no-any-return]
        except Larger as larger:
            room = 2 * larger.room


def _standing(room: int) -> Runner:
    """Return the standing process of this thread, a new one where there is none or it will not do."""
    for thread in [thread for thread in _STANDING if not thread.is_alive()]:
        _STANDING.pop(thread).runner.end()
    standing = _STANDING.get(threading.current_thread())
    if standing is None or not standing.serves(room):
        _begin_anew()
        standing = _STANDING[threading.current_thread()] = _Standing(Runner(_make, room), own_state.Kept(SLOW))
    return standing.runner


def _begin_anew() -> None:
    standing = _STANDING.pop(threading.current_thread(), None)
    if standing is not None:
        standing.runner.end()


def _make(request: _Request, watch: Watch) -> tuple[Run, bool]:
    """Make a run in the standing process; the second tells whether it may make another."""
    watch.enter(Phase.BUILDING, request.building_s)
    run = request.spec.made(request.inner, request.replay, watch, request.found)
    return run, not (own_state.lasting() or has_children())


def _make_one(request: _Request, _: None, watch: Watch) -> tuple[Run, bool]:
    return _make(request, watch)[0], False


def _is_plain(value: Any) -> bool:
    """Tell whether options are values that mean the same in another process."""
    if isinstance(value, dict):
        return all(isinstance(name, str) and _is_plain(one) for name, one in value.items())
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or type(value) in (bool, int, float, str)
