"""What a `bench` process does with its end, its garbage collector, the threads of BLAS, and one that tells progress.

It ends at once, after everything that anybody registered for the end has been done: an interpreter that ends in its own
way takes all modules apart before, some 6 % of the time of a small run. The collector rests while modules are loaded:
what they make stays until the end. BLAS has one thread while a run or a search is under way: with more, products of
matrices are added up in another order, and a search that rounding decides ends elsewhere.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_code: list[int] = []


@cache
def at_once() -> None:
    """Let this process end at once after `ends_with`; to be called before libraries load: theirs then comes first."""
    atexit.register(_leave)


def ends_with(code: int) -> None:
    """State the exit code. Without a call the interpreter ends in its own way, as after an exception."""
    _code[:] = [code]


def _leave() -> None:
    if not _code:
        return
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):  # nobody reads on, or it is closed: the interpreter tells it in its own way
        return
    if os.name == "posix" and "ctypes" in sys.modules:  # what C code has printed stands in buffers of its own
        with suppress(OSError, AttributeError):
            sys.modules["ctypes"].CDLL(None).fflush(None)
    os._exit(_code[0])


@contextmanager
def meanwhile(look: Callable[[], object], first: float, every: float) -> Iterator[None]:
    """Call `look` from another thread `first` seconds after the block began, and so `every` so many, until it ends."""
    ended = threading.Event()

    def looking() -> None:
        pause = first
        while not ended.wait(pause):
            look()
            pause = every

    thread = threading.Thread(target=looking, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@cache
def rest() -> None:
    """Collect nothing until `resume` is called, and less often afterwards; later calls in this process do nothing."""
    gc.disable()
    gc.set_threshold(50_000)  # objects that are made before garbage is looked for


@cache
def resume() -> None:
    """Collect again, but look no more at what has been made so far; later calls in this process do nothing."""
    gc.freeze()
    gc.enable()


STATED = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # who states one of them has chosen, and is not overruled
_LOOKED: dict[int, ThreadpoolController] = {}  # how many modules there were -> the libraries that were loaded


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS at one thread; the number of before comes back at the end.

    Where ``OPENBLAS_NUM_THREADS`` or ``MKL_NUM_THREADS`` is set, that is obeyed and nothing is held. Of several threads
    of one process the first that asks decides for all of them (a rule of threadpoolctl).
    """
    if any(name in os.environ for name in STATED):
        yield
        return
    import scipy.linalg  # noqa: F401  its BLAS is another one than NumPy's, and must not come later with all threads

    loaded = (library for library in libraries().lib_controllers if library.user_api == "blas")
    if all(library.get_num_threads() == 1 for library in loaded):  # as within a block around many runs
        yield
        return
    with libraries().limit(limits=1, user_api="blas"):
        yield


def libraries() -> ThreadpoolController:
    """Return the libraries that are loaded; to look for them takes a millisecond, so only after a further import."""
    modules = len(sys.modules)
    if modules not in _LOOKED:
        from threadpoolctl import ThreadpoolController

        _LOOKED.clear()
        _LOOKED[len(sys.modules)] = ThreadpoolController()
    return _LOOKED[len(sys.modules)]
