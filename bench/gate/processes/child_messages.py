"""Messages from a child process, heard until the child itself ends.

The end of a pipe tells nothing here: a process that the child has started holds it open for as long as it lives. So the
child is watched, and what it had said before it ended is heard first.
"""

from __future__ import annotations

import os
import pickle
import select
import struct
from contextlib import suppress
from math import inf
from time import perf_counter
from typing import Any, final

_LENGTH = struct.Struct("!Q")
_CHUNK = 1 << 16
_LONGEST = 3600.0  # seconds of one wait: the system has its own largest number


@final
class Sender:
    """The child's end: ``send(message)``, anything that can be pickled."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send(self, message: Any) -> None:
        """Send it whole. Raises what pickle raises, with nothing sent; `OSError` where nobody listens any more."""
        data = pickle.dumps(message)
        left = memoryview(_LENGTH.pack(len(data)) + data)
        while left:
            left = left[os.write(self._descriptor, left) :]


@final
class Receiver:
    """The parent's end, of the pipe and of the process `pid`, a child of ours that nobody has waited for yet."""

    def __init__(self, descriptor: int, pid: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor, self._heard, self._over = descriptor, bytearray(), False
        self._process = _process_descriptor(pid)

    def poll(self, timeout: float | None = 0.0) -> bool:
        """Tell whether `recv` would return, or raise, at once; wait for that at most `timeout` seconds (None: ever)."""
        end = None if timeout is None else perf_counter() + timeout
        while not (self._over or self._is_whole()):
            left = inf if end is None else max(0.0, end - perf_counter())
            ready = self._wait(min(left, _LONGEST))
            if not ready and left <= _LONGEST:
                return False
            self._read()
            if self._process in ready:  # all that it has said is in the pipe, and read
                self._over = True
        return True

    def recv(self) -> Any:
        """Return the next message. Raises `EOFError` where the child ended without a further complete one."""
        self.poll(None)
        if not self._is_whole():
            raise EOFError("the process ended")
        size = self._size()
        message = bytes(self._heard[_LENGTH.size : size])
        del self._heard[:size]
        return pickle.loads(message)

    def close(self) -> None:
        """Close the descriptors."""
        os.close(self._descriptor)
        if self._process is not None:
            os.close(self._process)

    def _wait(self, timeout: float) -> list[int | None]:
        watched = select.poll()
        watched.register(self._descriptor, select.POLLIN)
        if self._process is not None:
            watched.register(self._process, select.POLLIN)
        return [ready for ready, _ in watched.poll(1000 * timeout)]

    def _read(self) -> None:
        with suppress(BlockingIOError):
            while data := os.read(self._descriptor, _CHUNK):
                self._heard += data
            self._over = True  # the process has only this end

    def _size(self) -> int:
        return _LENGTH.size + int(_LENGTH.unpack_from(self._heard)[0])

    def _is_whole(self) -> bool:
        return len(self._heard) >= _LENGTH.size and len(self._heard) >= self._size()


def _process_descriptor(pid: int) -> int | None:
    """Return what tells that the process has ended; None where the system has no such thing: only the pipe tells."""
    try:
        return os.pidfd_open(pid)
    except (AttributeError, OSError):
        return None
