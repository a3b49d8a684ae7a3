"""The time limit of a run, also where a library loops in C and calls nothing back.

The gate looks at the clock before each evaluation, and refuses it when the time is up. A run that does not call is
ended from outside: it is made in a child process (a `Runner`, which may make run after run), whose gate writes its
state into memory that it shares with the parent.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from functools import partial
from math import inf, nan
from multiprocessing.util import Finalize
from time import perf_counter, process_time
from typing import Any, cast, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.gate.endings import ToldError, frames_of, text_of
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import doors_of, face_of, watched_doors_of
from calibench.bench.gate.processes import Receiver, Sender, exit_of, flush_output, forked
from calibench.core.sources import is_foreign
from calibench.optimizers.base import Stop

GRACE = 2.0  # seconds for the gate to end the run by itself, and for what of ours takes time beside foreign code
STALL_LIMIT = 60.0  # seconds without an evaluation, after which an optimiser that may hang is taken to hang
_LOOK = 0.5  # seconds between two looks at a child that is silent
_TRACE_POINTS = 1 << 14  # the trace thins itself: a fall through all doubles by tenths is 14 000 points
_COUNTS = (
    "evaluations", "jacobian_evaluations", "best_evaluation", "non_finite", "restarts", "batch_evaluations",
    "residual_evaluations", "gradient_evaluations", "joint_evaluations", "non_finite_slopes",
)  # fmt: skip  # of a gate, as they stand in the head of a mirror; then its other numbers, and what is told of the run
_BEST, _EARLIER, _SIZES = slice(10, 14), slice(14, 16), slice(16, 18)
DEADLINE, PHASE, CPU_BEFORE, STALL, _HEAD = 18, 19, 20, 21, 22
_ROOM = 1 << 21  # numbers of the best point and the targets, 16 MB: a system gives only what is written to
_ATTEMPTS = 64  # numbers of eight letters, for the names of what was tried
PASSED = "the time limit has passed"
_DIED = "the process of this run ended"
BEFORE = "before the first evaluation: "
JUDGING = "in judging the answer: "


@final
@dataclass(frozen=True)
class Ending:
    """How a run ended: the type, text and last frames of its error (empty: none), and its times."""

    error_type: str
    error: str
    wall_s: float
    cpu_s: float
    traceback: str = ""


def run_here(
    optimizer: Any, gate: Evaluator, rng: np.random.Generator, clock: Callable[[], object],
    begin: Callable[[], object], around: AbstractContextManager[Any],
) -> Ending:  # fmt: skip
    """Run in this process until the gate or the optimiser ends it; any other exception becomes the ending's error.

    `clock` is begun first. The search is made within `around` after `begin`: a process forked there begins `random`
    anew. `KeyboardInterrupt` is raised again.
    """
    objective = face_of(gate, doors_of(gate) if stays_inside(optimizer) else watched_doors_of(gate))
    error: BaseException | None = None
    clock()
    wall, cpu = perf_counter(), process_time() + children_cpu()
    try:
        with around:
            begin()
            optimizer.minimize(objective, rng)
    except Stop:
        pass
    except BaseException as caught:  # a failure of foreign code becomes a row, and the sweep goes on
        if gate.stopped is None or isinstance(caught, KeyboardInterrupt):  # some back ends replace our exception
            error = caught
    earlier_wall, earlier_cpu = gate.earlier
    wall = perf_counter() - wall + earlier_wall
    cpu = process_time() + children_cpu() - cpu + earlier_cpu
    gate.close()
    error = error if gate.raised is None else gate.raised
    if error is None:
        return Ending("", "", wall, cpu)
    if isinstance(error, KeyboardInterrupt):
        raise error
    return Ending(type(error).__name__, text_of(error), wall, cpu, frames_of(error))


def stays_inside(optimizer: Any) -> bool:
    """Tell whether the optimiser is known to stay in the box: one of ours, unless its trait says otherwise."""
    return not is_foreign(optimizer) and getattr(getattr(optimizer, "traits", None), "bounded", True)


def children_cpu() -> float:
    times = os.times()
    return times.children_user + times.children_system


@final
class Phase(IntEnum):
    """What a run is at; in each it has its time limit anew."""

    BUILDING = 0
    COMPILING = 1
    SEARCH = 2
    JUDGING = 3


_WHERE = {
    Phase.BUILDING: "in building the problem and the optimizer: ", Phase.COMPILING: BEFORE, Phase.SEARCH: "",
    Phase.JUDGING: JUDGING,
}  # fmt: skip
_SEARCH = float(Phase.SEARCH)  # as a mirror has it: of an enumeration it would be looked up at each evaluation


@final
@dataclass(frozen=True)
class Watch:
    """What a run tells of itself to the process that watches it; `limit` [s] is that of each phase, infinite: none."""

    mirror: Mirror
    limit: float
    tell: Callable[[Any], None] = lambda message: None

    def enter(self, phase: Phase, limit: float | None = None) -> None:
        """Begin a phase that may last `limit` seconds, if that is said."""
        self.mirror.enter(phase, self.limit if limit is None else limit)

    def begin(self, gate: Evaluator, stall_limit: float) -> None:
        """Begin the search: the gate looks at the clock, counts can be seen, silence lasts `stall_limit` at most."""
        self.mirror.head[STALL] = stall_limit
        self.enter(Phase.SEARCH)
        counts: Any = memoryview(cast(Any, self.mirror.head))
        gate.refuse_after(float(self.mirror.head[DEADLINE]), self.mirror.publish, counts)


@final
class Mirror:
    """The state of a run and its gate, as numbers in memory that parent and child share.

    It serves run after run: `show` begins one. In its `head` stand the `DEADLINE` (when the gate will refuse, on the
    clock `time.perf_counter` that parent and child share), the `PHASE`, `CPU_BEFORE` (processor seconds of the process
    before the run), and `STALL` (seconds that a search has without an evaluation).
    """

    def __init__(self) -> None:
        size = _HEAD + _ATTEMPTS + 4 * _TRACE_POINTS + _ROOM
        whole = np.frombuffer(mmap.mmap(-1, 8 * size), dtype=np.float64)
        self.head, rest = whole[:_HEAD], whole[_HEAD:]
        self._attempts, rest = rest[:_ATTEMPTS].view(np.uint8), rest[_ATTEMPTS:]
        self._trace, self._rest = rest[: 4 * _TRACE_POINTS].reshape(-1, 4), rest[4 * _TRACE_POINTS :]
        self._traced = 0
        self.head[STALL] = inf
        self.enter(Phase.BUILDING, inf)

    def show(self, gate: Evaluator) -> None:
        """Show `gate` from now on, and nothing of what was shown before."""
        if gate.dimension + 2 * len(gate.hits) > _ROOM:
            raise ValueError(f"time_limit: a run with one has at most {_ROOM} parameters, targets counted twice")
        self.head[_SIZES] = gate.dimension, len(gate.hits)
        self._attempts[:] = 0
        self._traced = 0
        self.head[2] = -1.0  # no best evaluation: the next is written
        self.publish(gate, 0)

    def enter(self, phase: Phase, limit: float) -> None:
        # before the phase: whoever waits must not see a later phase with an older end
        self.head[DEADLINE] = perf_counter() + limit
        self.head[PHASE] = phase

    @property
    def evaluations(self) -> int:
        return int(self.head[0])

    @property
    def charged(self) -> int:
        return int(self.head[0]) + int(self.head[_SIZES][0]) * int(self.head[1])

    @property
    def best_value(self) -> float:
        return float(self.head[_BEST][0])

    def publish(self, gate: Evaluator, evaluations: int) -> None:
        """Write the state of `gate`, and that `evaluations` have been made or are being made."""
        best = gate.best_x
        if self.head[2] != gate.best_evaluation and best is not None:
            best_x, hits, hits_charged = self._places()
            best_x[:] = best
            hits[:] = [nan if n is None else n for n in gate.hits]
            hits_charged[:] = [nan if n is None else n for n in gate.hits_charged]
        for i in range(max(self._traced - 1, 0), len(gate.trace)):  # the last point may have been put right
            self._trace[min(i, _TRACE_POINTS - 1)] = gate.trace[i]
        self._traced = len(gate.trace)
        self.head[: len(_COUNTS)] = evaluations, *(getattr(gate, name) for name in _COUNTS[1:])
        outside = nan if gate.outside_evaluations is None else gate.outside_evaluations
        self.head[_BEST] = gate.best_value, min(self._traced, _TRACE_POINTS), best is not None, outside
        self.head[_EARLIER] = gate.earlier
        if self.head[PHASE] == _SEARCH:
            self.head[DEADLINE] = gate.deadline  # which goes on while what is known from before is replayed
        if gate.attempts:
            attempts = "\0".join(gate.attempts).encode()[: self._attempts.size]
            self._attempts[: len(attempts)] = np.frombuffer(attempts, dtype=np.uint8)

    def read(self) -> dict[str, Any]:
        best_value, points, found, outside = self.head[_BEST].tolist()
        best_x, *levels = self._places()
        hits, hits_charged = ([None if n != n else int(n) for n in row.tolist()] for row in levels)
        attempts = bytes(self._attempts).rstrip(b"\0").decode(errors="ignore")
        return {
            **dict(zip(_COUNTS, map(int, self.head.tolist()), strict=False)),
            "unknown_slopes": 0,  # asked where a search ended by itself
            "outside_evaluations": None if outside != outside else int(outside),
            "attempts": attempts.split("\0") if attempts else [],
            "best_value": best_value, "best_x": best_x.copy() if found else None,
            "hits": hits if found else [None] * len(hits),
            "hits_charged": hits_charged if found else [None] * len(hits),
            "trace": [(int(n), int(c), value, int(r)) for n, c, value, r in self._trace[: int(points)].tolist()],
            "stopped": None,
        }  # fmt: skip

    def _places(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        dimension, hits = (int(number) for number in self.head[_SIZES])
        best_x, rest = self._rest[:dimension], self._rest[dimension:]
        return best_x, rest[:hits], rest[hits : 2 * hits]


@final
@dataclass(frozen=True)
class Cut:
    """A run whose process was ended or ended by itself: when it began, in which phase it was cut, and how; the counts
    of its search, if any.
    """

    began: datetime
    phase: Phase
    timed_out: bool
    ending: Ending
    state: dict[str, Any] | None

    def restored(self, gate: Evaluator) -> Ending:
        """Let `gate` be where it was, and return how the run ended."""
        for name, value in (self.state or {}).items():
            setattr(gate, name, value)
        if self.timed_out:
            gate.stopped = "timeout"
        return self.ending


Make = Callable[[Any, Watch], tuple[Any, bool]]


@final
class Runner:
    """A child process that makes runs: ``make(request, watch)``, which gives the run and whether it may make more.

    It ends with the thread that began it. `child` is the process, and `end` ends it with all that it has started.
    """

    def __init__(self, make: Make) -> None:
        self._mirror, stack = Mirror(), ExitStack()
        self.child, self._line = stack.enter_context(forked(partial(self._serve, make)))
        self.end = Finalize(None, stack.close, exitpriority=0)  # also at the end of this process

    def ask(self, request: Any, limit: float, hear: Callable[[Any, Mirror, int], None]) -> Any:
        """Return the run of `request`, or a `Cut`; each of its phases has `limit` seconds.

        `hear` gets what the run tells meanwhile, with its counts and the number of the process, which is ended where no
        run came, or it may make no more. Raises what could not be made into a run.
        """
        assert self.child.pid is not None
        mirror, at = self._mirror, datetime.now(UTC)
        try:
            began, cpu = perf_counter(), children_cpu()
            mirror.enter(Phase.BUILDING, inf)
            try:
                self._line.connection.send((request, limit))
                kind, found = "told", cast(Any, None)
                while kind == "told" and not (why := _wait(self._line, mirror)):
                    kind, found = self._line.recv()
                    if kind == "told":
                        hear(found, mirror, self.child.pid)
            except (EOFError, ConnectionError):
                why = _DIED
            if why:
                self.end()
                phase = Phase(int(mirror.head[PHASE]))
                took = perf_counter() - began, children_cpu() - cpu - float(mirror.head[CPU_BEFORE])
                if phase >= Phase.SEARCH:  # and what the run took before the child continued it
                    earlier = mirror.head[_EARLIER].tolist()
                    took = took[0] + earlier[0], took[1] + earlier[1]
                ended = f" with {exit_of(self.child.exitcode)}" if why == _DIED else ""
                ending = Ending("ProcessDied" if ended else "", f"{_WHERE[phase]}{why}{ended}", *took)
                return Cut(at, phase, why != _DIED, ending, mirror.read() if phase >= Phase.SEARCH else None)
            if kind == "raised":
                raise found.rebuilt()
            run, may_go_on = found
            if not may_go_on:
                self.end()
            return run
        except BaseException:
            self.end()
            raise

    def _serve(self, make: Make, theirs: Sender) -> None:
        while True:
            request, limit = theirs.connection.recv()
            watch = Watch(self._mirror, limit, lambda message: theirs.send(("told", message)))
            self._mirror.head[CPU_BEFORE] = process_time() + children_cpu()
            answer: tuple[str, Any]
            try:
                answer = "run", make(request, watch)
            except BaseException as error:  # of a request that makes no sense, or to end it all
                answer = "raised", ToldError.of(error)
            flush_output()
            theirs.send(answer)


def _wait(line: Receiver, mirror: Mirror) -> str:
    """Return "" when the child has said something, otherwise why nobody waits for it any longer."""
    calls, heard = -1, perf_counter()
    while True:
        now, searches, stall_limit = perf_counter(), mirror.head[PHASE] == _SEARCH, float(mirror.head[STALL])
        if mirror.evaluations != calls or not searches:
            calls, heard = mirror.evaluations, now
        end = float(mirror.head[DEADLINE]) + GRACE
        if now >= end:
            return f"{PASSED}, and it did not stop when told" if searches else PASSED
        if now - heard >= stall_limit:
            return f"it made no evaluation in {stall_limit:g} s"
        if line.poll(min(end - now, stall_limit / 4, _LOOK)):
            return ""
