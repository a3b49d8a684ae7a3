"""One thread for each process that reads the runs in progress now and then, so that no evaluation pays for it.

It starts with the first run and ends some seconds after the last one.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from time import monotonic
from typing import final

from calibench.core.process_state import OWN_THREAD

_IDLE = 10.0  # seconds for which the thread waits for something to look at


@contextmanager
def looked_at(look: Callable[[], None], every: float = 1.0) -> Iterator[None]:
    """Call `look` every so many seconds, from another thread, while the block lasts. Its exceptions are ignored."""
    key = _here().add(look, every)
    try:
        yield
    finally:
        _here().remove(key)


@final
class _Pulse:
    def __init__(self) -> None:
        self._change = threading.Condition()
        self._looks: dict[object, tuple[float, float, Callable[[], None]]] = {}  # when it is due, how often, what
        self._wakes = 0.0
        self._alive = False

    def add(self, look: Callable[[], None], every: float) -> object:
        key, due = object(), monotonic() + every
        with self._change:
            self._looks[key] = (due, every, look)
            if not self._alive:
                self._alive = True
                threading.Thread(target=self._beat, name=f"{OWN_THREAD}pulse", daemon=True).start()
            elif due < self._wakes:
                self._change.notify()
        return key

    def remove(self, key: object) -> None:
        with self._change:
            self._looks.pop(key, None)

    def _beat(self) -> None:
        idle_until = monotonic() + _IDLE
        while True:
            with self._change:
                now = monotonic()
                if self._looks:
                    idle_until = now + _IDLE
                elif now >= idle_until:
                    self._alive = False
                    return
                self._wakes = min((due for due, _, _ in self._looks.values()), default=min(idle_until, now + 1.0))
                if self._wakes > now:
                    self._change.wait(self._wakes - now)
                    continue
                ready = [(key, every, look) for key, (due, every, look) in self._looks.items() if due <= now]
                for key, every, look in ready:
                    self._looks[key] = (now + every, every, look)
            for _, _, look in ready:
                with suppress(Exception):
                    look()


_PULSES: dict[int, _Pulse] = {}  # of this process alone: no thread lives on in a forked child


def _here() -> _Pulse:
    pid = os.getpid()
    if pid not in _PULSES:
        _PULSES.clear()
        _PULSES[pid] = _Pulse()
    return _PULSES[pid]
