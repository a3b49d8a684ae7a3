"""What an optimiser that is not this package's may not do while it runs: look behind the walls of the gate.

Two ways lead behind them: the frames of the interpreter (its own callers', a traceback's) and the garbage collector.
Python tells an audit hook of both. Where the optimiser's own code asks, it gets a `PermissionError`, and the row tells.
Who asks is the first frame that is not of `inspect` or `traceback`. Asking on its own behalf are the standard library,
installed packages (logging and numba look at frames) and the problem, below the gate; they may. An audit hook stays for
the life of a process, so it is added with the first run that needs it, and between runs it does nothing.

What is replaced rather than read is found after the run: names of this package's gate and of the problem's class that
mean another thing than before.

This holds against Python. Memory that is written by ctypes or by a C extension, files under /proc, and a debugger are
not held; nor is an optimiser kept from importing a problem and evaluating a copy of its own.
"""

from __future__ import annotations

import builtins
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from operator import is_
from pathlib import Path
from threading import enumerate as enumerate_threads
from threading import get_ident
from types import FrameType
from typing import Any

from calibench.bench.gate.guard.wall import walled
from calibench.core.sources import is_ours

_EVENTS = {
    "gc.get_objects", "gc.get_referrers", "gc.get_referents", "sys._getframe", "sys._current_frames",
    "sys._current_exceptions", "sys.settrace", "sys.setprofile", "sys.monitoring.register_callback",
}  # fmt: skip
_FRAMES_OF = {"tb_frame", "gi_frame", "cr_frame", "ag_frame"}
_INSTALLED = tuple({sysconfig.get_paths()[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")})
_GATE = "calibench.bench.gate.evaluator"
_WATCHED = (
    _GATE,
    *(f"calibench.bench.gate.{name}" for name in ("box", "calls", "face", "frames", "time_limit", "guard.wall")),
    *(f"calibench.bench.execution.{name}" for name in ("answer", "merit", "outcome", "request.asked", "row_of", "run")),
)


def is_foreign(thing: Any) -> bool:
    """Tell whether the class of a problem or optimiser is not this package's."""
    return is_foreign_module(type(thing).__module__)


def is_foreign_module(name: str) -> bool:
    """Tell whether the module of this name is not this package's."""
    file = getattr(sys.modules.get(name), "__file__", None)
    return not isinstance(file, str) or not _is_ours(file)


@cache
def _is_ours(file: str) -> bool:
    return is_ours(Path(file).resolve())


@contextmanager
def held(optimizer: Any, problem: Any, objective: Any, note: Callable[[str], None]) -> Iterator[None]:
    """Restrict the code of `optimizer` for as long as the block lasts, and `note` its attempts."""
    before = [(place, dict(place)) for place in _places(problem, objective)]
    release = _hold(type(optimizer).__module__.partition(".")[0], note)
    try:
        yield
    finally:
        release()
        for place, was in before:
            for name in _changed(place, was):
                note(f"replace {name}")


def _places(problem: Any, objective: Any) -> list[Mapping[str, Any]]:
    """Return the places of the names that a run relies on: of the gate, its face, the problem's class, Python."""
    modules = [vars(sys.modules[name]) for name in _WATCHED if name in sys.modules]
    classes = [vars(kind) for kind in (sys.modules[_GATE].Evaluator, type(objective), *type(problem).__mro__[:-1])]
    return [*modules, *classes, vars(builtins)]


def _changed(place: Mapping[str, Any], was: dict[str, Any]) -> list[str]:
    """Return the names whose meaning has changed, without values, as a class may count in its own."""
    if len(place) == len(was) and all(map(is_, place.values(), was.values())):
        return []  # as nearly always
    return [
        name
        for name, value in was.items()
        if place.get(name) is not value and name != "_" and (callable(value) or isinstance(value, property))
    ]


def _holder() -> Callable[[str, Callable[[str], None]], Callable[[], None]]:
    """Return the function that begins the restriction: ``hold(package of the optimiser, note)`` returns its end."""
    held_back: dict[int, tuple[str, Callable[[str], None], frozenset[int]]] = {}
    looking: set[int] = set()  # threads in which the hook itself looks at frames
    installed = False

    def hold(package: str, note: Callable[[str], None]) -> Callable[[], None]:
        nonlocal installed
        if not installed:
            sys.addaudithook(hook)
            installed = True
        me = get_ident()
        held_back[me] = (package, note, frozenset(thread.ident or 0 for thread in enumerate_threads()) - {me})
        release: Callable[[], None] = walled(lambda: held_back.pop(me, None))
        return release

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if not held_back:
            return
        if event == "object.__getattr__" and arguments[1] in _FRAMES_OF:
            event = arguments[1]
        elif event not in _EVENTS:
            return
        me = get_ident()
        if me in looking:
            return
        looking.add(me)
        try:
            frame, holding = sys._getframe(1), list(held_back.values())
            asked = [note for package, note, others in holding if me not in others and _asks(package, frame)]
        finally:
            looking.discard(me)
        if asked:
            asked[0](f"use {event}")
            raise PermissionError(f"{event}: an optimizer does not look behind its objective while it runs")

    return hold


def _asks(package: str, frame: FrameType | None) -> bool:
    """Tell whether the code of `package`, or code that is not installed, asks; not so the problem's, below the gate."""
    while frame is not None and _passes_on(frame):
        frame = frame.f_back
    if frame is None:
        return False
    asker = _module(frame).partition(".")[0]
    if asker == "calibench" or (asker != package and frame.f_code.co_filename.startswith(_INSTALLED)):
        return False
    while frame is not None and _module(frame) != _GATE:
        frame = frame.f_back
    return frame is None


def _passes_on(frame: FrameType) -> bool:
    """Tell whether a frame asks for who called it, as `inspect.stack` and `traceback.walk_tb` do."""
    return _module(frame) == "inspect" or (
        _module(frame) == "traceback" and frame.f_code.co_name in ("walk_tb", "walk_stack")
    )


def _module(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__", ""))


_hold = walled(_holder())
