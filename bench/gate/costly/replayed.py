"""A run that goes on where it was killed: the gate answers from the values of before until these are used up.

Whatever library searches, it is begun again from its seed and asks the same points; each is compared by its digest. So
nothing of its state is ever saved. The budget, the best and the trace are counted anew and come out the same.

Which runs write their values down: where it is left to us (`always` is False) those whose evaluations take `DEAR`
seconds or more. The first `FIRST` calls are timed and held in memory; if none is dear the gate asks the problem as
if there were no replay, and no later call pays anything. `look`, called every second by another thread, sees from the
gate's count when evaluations have become slower than that, and has the next calls timed again. A call that was not
written down is made again after a kill: the place of each value among the calls stands beside it. A method that asks
from several threads is not replayed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from hashlib import blake2b
from threading import Lock, get_ident
from time import perf_counter, process_time
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.gate.calls import Calls
from calibench.bench.gate.costly.replay_file import Record, ReplayFile, copied
from calibench.bench.gate.evaluator import Evaluator

Array = NDArray[np.float64]
DEAR = 0.02  # seconds an evaluation from which on its value is worth a record, which takes about 1e-4
FIRST = 3  # calls that are timed
_CHEAP, _WINDOW = DEAR / 4, 16  # mean of so many calls below which no more is written
_VALUE, _BATCH, _BELOW, _RESIDUALS, _JACOBIAN, _GRADIENT, _JOINT = range(7)
_NAMES = ("a value", "a batch", "a batch", "residuals", "a Jacobian", "a gradient", "a value and its gradient")


class ReplayDiffers(RuntimeError):
    """The optimiser asks another point than before it was killed."""


@final
class Replayed:
    """Let `gate` be answered from `file` first, then by `calls`, whose answers are added to it.

    `processes` evaluate at once. `limit` [s] is that of the run: the gate's clock stands where it stood at each answer.
    `noise` is the generator that a noisy problem draws from: it is put to where it was.
    """

    def __init__(
        self,
        gate: Evaluator,
        calls: Calls,
        file: ReplayFile,
        *,
        always: bool = False,
        processes: int = 1,
        limit: float | None = None,
        noise: np.random.Generator | None = None,
    ) -> None:
        self._gate, self._bare, self._file = gate, calls, file
        self._always, self._processes, self._limit, self._noise = always, processes, limit, noise
        self._began, self._cpu_began = perf_counter(), process_time()
        self._writing = always or file.next is not None
        self._held: list[tuple[int, int, tuple[Array, ...], Any, Any]] = []  # what is not written yet
        self._calls, self._took = 0, 0.0  # of the window
        self._armed = False
        self._useless = False  # the file cannot be written, or not be answered from
        self._thread: int | None = None
        self._noting = Lock()  # a second thread gives up while the first may be writing
        self._told: BaseException | None = None
        self.differs: ReplayDiffers | None = None
        self._seen, self._wait, self._patience = -1, 0, 1
        self._ours = Calls(
            self._value, calls.fixed, self._again,
            calls.batch and (lambda points: self._through(_BATCH, calls.batch, points)),
            calls.below and (lambda points, limits: self._through(_BELOW, calls.below, points, limits)),
            calls.residuals and (lambda x: self._through(_RESIDUALS, calls.residuals, x)),
            calls.jacobian and (lambda x: self._through(_JACOBIAN, calls.jacobian, x)),
            calls.gradient and (lambda x: self._through(_GRADIENT, calls.gradient, x)),
            calls.joint and (lambda x: self._through(_JOINT, calls.joint, x)),
            calls.ahead and self._ahead,
        )  # fmt: skip

    def arm(self) -> None:
        """Replace the gate's calls by ours."""
        self._armed = True
        self._gate.ask(self._ours)

    def look(self) -> None:
        """Check, once a second from another thread, whether evaluations have become costly, and time them again."""
        if self._armed or self._useless:
            return
        made = self._gate.evaluations + self._gate.jacobian_evaluations
        slow = made - self._seen < self._processes / DEAR
        self._seen = made
        self._wait -= 1
        if slow and self._wait < 0:
            self._patience = self._wait = min(2 * self._patience, 64)  # an optimiser may be what is slow
            self.arm()

    def _value(self, x: Array, _fixed: Any) -> float:
        try:
            value: float = self._through(_VALUE, self._bare.one, x)
        except BaseException as error:
            self._told = error
            raise
        return value

    def _again(self, x: Array) -> float:
        """Raise our own exceptions; repeat the call as without us where the problem failed before we were armed."""
        if sys.exception() is self._told:
            raise
        value: float = self._bare.again(x)
        return value

    def _ahead(self, points: Array) -> None:
        """Have those points computed ahead whose values are not known."""
        known = self._file.known(self._place() + 1, len(points))
        if known < len(points):
            self._bare.ahead(points[known:])

    def _place(self) -> int:
        return self._gate.evaluations + self._gate.jacobian_evaluations  # each call raises one of the two, or both

    def _through(self, kind: int, ask: Callable[..., Any], *given: Array) -> Any:
        """Return the answer to what is `given`: the one of before, or else what ``ask(*given)`` returns."""
        if self.differs is not None:
            raise self.differs
        if self._thread != get_ident():
            if self._thread is not None:
                return self._give_up(ask, given)
            self._thread = get_ident()
        place, known = self._place(), self._file.next
        if known is not None and known.place <= place:
            return self._known(known, kind, place, given)
        if not self._armed:  # a batch that was begun before we were switched off
            self._gate.ask(self._bare)
            return ask(*given)
        began = perf_counter()
        answer = ask(*given)
        took = perf_counter() - began
        with self._noting:
            if known is None and not self._useless:
                self._note(kind, place, given, answer, took)
        return answer

    def _known(self, record: Record, kind: int, place: int, given: tuple[Array, ...]) -> Any:
        if (record.place, record.kind, record.point) != (place, kind, _digest(given)):
            self.differs = ReplayDiffers(
                f"evaluation {place} after a kill: the optimiser or its library asks for {_NAMES[kind]} at another "
                f"point than before (then {_NAMES[record.kind]}, evaluation {record.place}); same versions? does it "
                "draw from rng alone, and the objective depend on x alone?"
            )
            raise self.differs
        self._file.passed()
        now, cpu = perf_counter(), process_time()
        self._gate.earlier = record.wall_s - (now - self._began), record.cpu_s - (cpu - self._cpu_began)
        if self._limit is not None:
            self._gate.put_off(now + self._limit - record.wall_s)
        if self._noise is not None and record.noise is not None:
            self._noise.bit_generator.state = record.noise
        return record.answer

    def _note(self, kind: int, place: int, given: tuple[Array, ...], answer: Any, took: float) -> None:
        """Write an answer to the file, hold it in memory, or switch ourselves off, depending on its time."""
        each = took * self._processes / (len(given[0]) if kind in (_BATCH, _BELOW) else 1)
        state = None if self._noise is None else dict(self._noise.bit_generator.state)
        if self._writing or each >= DEAR:
            self._held.append((kind, place, given, answer, state))
        else:  # the optimiser may write to either
            self._held.append((kind, place, tuple(map(np.array, given)), copied(answer), state))
        if self._writing or each >= DEAR:
            self._writing = True
            self._write()
        elif len(self._held) >= FIRST:
            self._off()
        if self._writing and not self._always:
            self._calls, self._took = self._calls + 1, self._took + each
            if self._calls == _WINDOW:
                if self._took < _CHEAP * _WINDOW:
                    self._off()
                self._calls, self._took = 0, 0.0

    def _write(self) -> None:
        wall, cpu = self._gate.earlier
        wall, cpu = wall + perf_counter() - self._began, cpu + process_time() - self._cpu_began
        try:
            for kind, place, given, answer, state in self._held:
                self._file.add(Record(kind, place, _digest(given), answer, wall, cpu, state))
        except OSError:  # no room, say: the run goes on, and what is whole so far is of use after a kill
            self._useless = True
            self._off()
        self._held = []

    def _give_up(self, ask: Callable[..., Any], given: tuple[Array, ...]) -> Any:
        """Answer a call from a second thread, and switch ourselves off: the order of calls cannot be repeated."""
        with self._noting:
            self._useless = True
            self._off()
            self._file.clear()
        return ask(*given)

    def _off(self) -> None:
        """Have the gate ask the problem without us."""
        self._writing, self._held = False, []
        self._seen = self._place()
        self._gate.ask(self._bare)
        self._armed = False  # last, for `look`


def _digest(given: tuple[Array, ...]) -> bytes:
    told = blake2b(digest_size=16)
    for array in given:
        values = np.ascontiguousarray(array, dtype=np.float64)
        told.update(repr(values.shape).encode() + values.tobytes())
    return told.digest()
