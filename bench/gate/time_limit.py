"""The time limit of a run, also where a library loops in C and calls nothing back.

The limit works in two ways. The gate looks at the clock before each evaluation, and refuses it when the time is up:
that ends every search that still calls. A search that does not call is ended from outside. It runs in a forked child,
whose gate writes its state into memory that it shares with the parent; so a child that was killed leaves its row all
the same. An evaluation takes about three microseconds more; its values and its trace are the same to the last bit.
"""

from __future__ import annotations

import mmap
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from math import inf, nan
from time import perf_counter, process_time
from typing import Any, TypeVar, final

import numpy as np

from calibench.bench.gate.box import doors_of, looks, watched_doors_of
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import face_of, own_face_of
from calibench.bench.gate.frames import frames_of
from calibench.bench.gate.frames import text_of as text_of
from calibench.bench.gate.guard.foreign_code import held, is_foreign
from calibench.bench.gate.processes.child_messages import Receiver, Sender
from calibench.bench.gate.processes.forked_worker import CAN_FORK, forked
from calibench.bench.gate.processes.process_group import exit_of
from calibench.core import own_state
from calibench.optimizers.base import Stop

T = TypeVar("T")
GRACE = 2.0  # seconds for the gate to end the run by itself
STALL_LIMIT = 60.0  # seconds without an evaluation, after which an optimiser that may hang is taken to hang
_LOOK = 0.5  # seconds between two looks at a child that is silent
_TRACE_POINTS = 1 << 14  # the trace thins itself: a fall through all doubles by tenths is 14 000 points
_HEAD = 19
_ATTEMPTS = 64  # numbers of eight letters, for the names of what was tried
_PASSED = "the time limit has passed"
_DIED = "the process of this run ended"
BEFORE = "before the first evaluation: "


@final
@dataclass(frozen=True)
class Ending:
    """How a run ended: the type, text and last frames of its error (empty: none), and its times."""

    error_type: str
    error: str
    wall_s: float
    cpu_s: float
    traceback: str = ""


Around = AbstractContextManager[Any]  # what a search is made in, in the process that makes it
_NOTHING: Around = nullcontext()


def run_here(
    optimizer: Any,
    gate: Evaluator,
    rng: np.random.Generator,
    problem: Any = None,
    begin: Callable[[], None] = lambda: None,
    around: Around = _NOTHING,
) -> Ending:
    """Run in this process until the gate or the optimiser ends it; any other exception becomes the ending's error.

    What the problem raised, the gate has kept, whatever the optimiser made of it. `KeyboardInterrupt` is raised again.
    The optimiser gets a face of the gate. One that is not this package's is held back from looking behind it, and what
    it tries at the gate or at the `problem`'s class is noted. `begin` is done as the clock starts; the search is made
    within `around`.
    """
    foreign = is_foreign(optimizer)
    doors = doors_of(gate) if stays_inside(optimizer) else watched_doors_of(gate)
    objective = (face_of if foreign else own_face_of)(gate, doors)
    error: BaseException | None = None
    with held(optimizer, problem, objective, gate.note) if foreign else nullcontext():
        begin()
        wall, cpu = perf_counter(), process_time() + _children_cpu()
        try:
            with around:
                optimizer.minimize(objective, rng)
        except Stop:
            pass
        except BaseException as caught:  # a failure of foreign code becomes a row, and the sweep goes on
            if gate.stopped is None or isinstance(caught, KeyboardInterrupt):  # some back ends replace our exception
                error = caught
        earlier_wall, earlier_cpu = gate.earlier
        wall = perf_counter() - wall + earlier_wall
        cpu = process_time() + _children_cpu() - cpu + earlier_cpu
    gate.close()
    error = error if gate.raised is None else gate.raised
    if error is None:
        return Ending("", "", wall, cpu)
    if isinstance(error, KeyboardInterrupt):
        raise error
    return Ending(type(error).__name__, text_of(error), wall, cpu, frames_of(error))


def run_watched(
    optimizer: Any,
    gate: Evaluator,
    rng: np.random.Generator,
    limit: float | None,
    stall_limit: float | None = None,
    problem: Any = None,
    first: Callable[[], Ending | None] = lambda: None,
    around: Around = _NOTHING,
    begun: Callable[[Mirror, int | None], None] = lambda mirror, pid: None,
    *,
    last: Callable[[Ending], T],
) -> T:
    """Run in a child process for at most `limit` seconds, and no longer than `stall_limit` seconds without an
    evaluation; return what `last` makes of the ending.

    `first` is done in the child before the clock of the run starts, and has `limit` seconds of its own; an ending that
    it returns is the run's. `last` ends in time by itself; it is done in the child too, in the state that the run has
    left its process in, unless the child was lost. The gate ends as if it had run here. Where a system cannot fork,
    only the gate watches the clock. `begun` is told of the counts that can be read while it runs, and of the child's
    process.
    """
    allowed = inf if limit is None else limit
    mirror = Mirror(gate)

    def begin() -> None:
        mirror.begun = True
        mirror.deadline = perf_counter() + allowed  # the limit is for the run itself, not for its preparation
        gate.refuse_after(mirror.deadline, mirror.publish)

    def work(theirs: Sender) -> None:
        gate.adopt()
        mirror.deadline = perf_counter() + allowed
        try:
            made, changes = own_state.with_changes(lambda: finish(first() or run()))
        except KeyboardInterrupt as stop:  # by the user's code: the terminal's is for the parent
            theirs.send(KeyboardInterrupt(text_of(stop)))
            return
        sys.stdout.flush()  # what the run has printed; the answer ends this process
        theirs.send((gate.state(), made, changes))

    def run() -> Ending:
        ending = run_here(optimizer, gate, rng, problem, begin, around)
        return replace(ending, error=_PASSED) if gate.stopped == "timeout" else ending

    def finish(ending: Ending) -> T:
        mirror.is_over = True
        return last(ending)

    if not CAN_FORK:
        return last(first() or run())
    if not stays_inside(optimizer):
        looks()  # once here, and not in every child
    began, cpu = perf_counter(), _children_cpu()
    with forked(work) as (child, ours):
        begun(mirror, child.pid)
        try:
            why = _wait(ours, mirror, stall_limit)
            answer = None if why else ours.recv()
        except EOFError:
            why, answer = _DIED, None
    if isinstance(answer, KeyboardInterrupt):
        raise answer
    if answer is not None:
        made: T
        state, made, changes = answer
        gate.restore(state)
        own_state.note(changes)
        return made
    gate.restore(mirror.read())
    earlier_wall, earlier_cpu = mirror.earlier
    took = perf_counter() - began + earlier_wall, _children_cpu() - cpu + earlier_cpu
    before = "" if mirror.begun else BEFORE
    if why == _DIED:
        return last(Ending("ProcessDied", f"{before}{why} with {exit_of(child.exitcode)}", *took))
    gate.stopped = "timeout"
    return last(Ending("", f"{before}{why}", *took))


def _wait(ours: Receiver, mirror: Mirror, stall_limit: float | None) -> str:
    """Return "" when the child has answered, otherwise why nobody waits for it any longer."""
    calls, heard = -1, perf_counter()
    while True:
        now = perf_counter()
        if mirror.is_over:
            ours.poll(None)
            return ""
        if mirror.evaluations != calls:
            calls, heard = mirror.evaluations, now
        end = mirror.deadline + GRACE
        if now >= end:
            return f"{_PASSED}, and it did not stop when told"
        if not mirror.begun:
            heard = now
        if stall_limit is not None and now - heard >= stall_limit:
            return f"it made no evaluation in {stall_limit:g} s"
        if ours.poll(min(end - now, _LOOK if stall_limit is None else min(stall_limit / 4, _LOOK))):
            return ""


def stays_inside(optimizer: Any) -> bool:
    """Tell whether the optimiser is known to stay in the box: one of ours, unless its trait says otherwise."""
    return not is_foreign(optimizer) and getattr(getattr(optimizer, "traits", None), "bounded", True)


def _children_cpu() -> float:
    times = os.times()
    return times.children_user + times.children_system


@final
class Mirror:
    """The state of a gate, as numbers in memory that parent and child share."""

    def __init__(self, gate: Evaluator) -> None:
        self._hits, self._dimension = len(gate.hits), gate.dimension
        size = _HEAD + _ATTEMPTS + 2 * self._hits + self._dimension + 4 * _TRACE_POINTS
        self._all = np.frombuffer(mmap.mmap(-1, 8 * size), dtype=np.float64)
        self._head, rest = self._all[:_HEAD], self._all[_HEAD:]
        self._attempts, rest = rest[:_ATTEMPTS].view(np.uint8), rest[_ATTEMPTS:]
        self._levels, rest = rest[: 2 * self._hits].reshape(2, -1), rest[2 * self._hits :]
        self._best_x, rest = rest[: self._dimension], rest[self._dimension :]
        self._trace = rest.reshape(-1, 4)
        self._traced = 0
        self.deadline = inf
        self.publish(gate, 0)

    @property
    def evaluations(self) -> int:
        """Return the evaluations made, the one in progress included."""
        return int(self._head[0])

    @property
    def charged(self) -> int:
        """Return what the run has cost."""
        return int(self._head[0]) + self._dimension * int(self._head[1])

    @property
    def best_value(self) -> float:
        """Return the best value so far."""
        return float(self._head[4])

    @property
    def earlier(self) -> tuple[float, float]:
        """Return the seconds, wall and processor, that the run took before the child continued it."""
        wall, cpu = self._head[13:15].tolist()
        return wall, cpu

    @property
    def deadline(self) -> float:
        """Return when the gate will refuse, on the clock `time.perf_counter` that parent and child share."""
        return float(self._head[8])

    @deadline.setter
    def deadline(self, when: float) -> None:
        self._head[8] = when

    @property
    def begun(self) -> bool:
        """Tell whether the run itself has begun."""
        return bool(self._head[11])

    @begun.setter
    def begun(self, yes: bool) -> None:
        self._head[11] = yes

    @property
    def is_over(self) -> bool:
        """Tell whether the search has ended; what is done then ends by itself."""
        return bool(self._head[18])

    @is_over.setter
    def is_over(self, yes: bool) -> None:
        self._head[18] = yes

    def publish(self, gate: Evaluator, evaluations: int) -> None:
        """Write the state of `gate`, and that `evaluations` have been made or are being made."""
        best = gate.best_x
        if self._head[5] != gate.best_evaluation and best is not None:
            self._best_x[:] = best
            self._levels[0] = [nan if n is None else n for n in gate.hits]
            self._levels[1] = [nan if n is None else n for n in gate.hits_charged]
        for i in range(max(self._traced - 1, 0), len(gate.trace)):  # the last point may have been put right
            self._trace[min(i, _TRACE_POINTS - 1)] = gate.trace[i]
        self._traced = len(gate.trace)
        self._head[:8] = (
            evaluations, gate.jacobian_evaluations, gate.non_finite, gate.restarts, gate.best_value,
            gate.best_evaluation, min(self._traced, _TRACE_POINTS), best is not None,
        )  # fmt: skip
        self._head[8] = gate.deadline  # which goes on while what is known from before is replayed
        self._head[9:11] = gate.batch_evaluations, gate.residual_evaluations
        self._head[12] = nan if gate.outside_evaluations is None else gate.outside_evaluations
        self._head[13:15] = gate.earlier
        self._head[15:18] = gate.gradient_evaluations, gate.joint_evaluations, gate.non_finite_slopes
        if gate.attempts:
            told = "\0".join(gate.attempts).encode()[: self._attempts.size]
            self._attempts[: len(told)] = np.frombuffer(told, dtype=np.uint8)

    def read(self) -> dict[str, Any]:
        """Return the last state of the gate that was written."""
        evaluations, jacobians, non_finite, restarts, best_value, best_evaluation, points, found = self._head[
            :8
        ].tolist()
        outside, tried = float(self._head[12]), self._attempts.any()
        hits, hits_charged = ([None if n != n else int(n) for n in row] for row in self._levels.tolist())
        return {
            "evaluations": int(evaluations),
            "jacobian_evaluations": int(jacobians),
            "batch_evaluations": int(self._head[9]),
            "residual_evaluations": int(self._head[10]),
            "gradient_evaluations": int(self._head[15]),
            "joint_evaluations": int(self._head[16]),
            "non_finite": int(non_finite),
            "non_finite_slopes": int(self._head[17]),
            "unknown_slopes": 0,  # asked where a search ended by itself
            "outside_evaluations": None if outside != outside else int(outside),
            "attempts": bytes(self._attempts).rstrip(b"\0").decode(errors="ignore").split("\0") if tried else [],
            "restarts": int(restarts),
            "best_value": best_value,
            "best_evaluation": int(best_evaluation),
            "best_x": self._best_x.copy() if found else None,
            "hits": hits if found else [None] * self._hits,
            "hits_charged": hits_charged if found else [None] * self._hits,
            "trace": [(int(n), int(c), value, int(r)) for n, c, value, r in self._trace[: int(points)].tolist()],
            "stopped": None,
        }
