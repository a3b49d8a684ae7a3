"""The state of a process that foreign code can set: one table of what it is, how it is read and how it is set.

Python has one working folder, one locale, one handling of floating-point faults. `core.own_state` reads all of `KINDS`
before a run of a user's class, and compares and puts it back after. Each is read in some microseconds, as it is done
twice a run.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import locale
import logging
import operator
import os
import signal
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Context, DefaultContext, getcontext
from functools import cache, partial
from multiprocessing import get_start_method, set_start_method
from typing import Any, final

import numpy as np

from calibench.core.process import libraries

if sys.platform == "win32":
    _LIMITS: tuple[int, ...] = ()
else:
    import resource

    _LIMITS = tuple({getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")})

SLOW = 2  # of `KINDS` the first so many take a millisecond once a library was loaded or a thread begun
OWN_THREAD = "calibench-"  # how the names of this package's own threads begin
_PATIENCE = 0.05  # seconds for threads that are about to end
_SMALLEST, _ONE = 5e-324, 1.0
_STREAMS = ("stdin", "stdout", "stderr")
_ALL = slice(None)
_HOOKS = ("excepthook", "displayhook", "unraisablehook", "breakpointhook")
_SIGNALS = tuple(map(int, signal.valid_signals()))
_TIMERS = tuple(
    getattr(signal, name) for name in ("ITIMER_REAL", "ITIMER_VIRTUAL", "ITIMER_PROF") if hasattr(signal, name)
)
_handler_of: Callable[[int], Any] = importlib.import_module("_signal").getsignal  # it looks up no names, so is quicker
_MASKS = ctypes.c_char * 64  # more than fenv_t has on any system


@final
@dataclass(frozen=True)
class Kind:
    """A kind of state: what a row calls it, how it is read, as a value that can be compared, and how it is set.

    A mapping has parts that can be set one by one; of a tuple new items may be at its ends. `same` compares what was
    with what is.
    """

    name: str
    read: Callable[[], Any]
    put: Callable[[Any], Any]
    same: Callable[[Any, Any], bool] = operator.eq

    def merged(self, before: Any, after: Any, now: Any) -> Any:
        """Return `now` with the change from `before` to `after`; where it has no parts it is `after`."""
        if isinstance(now, dict):
            changed = {name: value for name, value in after.items() if name not in before or before[name] != value}
            return {name: value for name, value in now.items() if name in after or name not in before} | changed
        if isinstance(now, tuple) and len(after) > len(before):
            added = len(after) - len(before)
            if after[added:] == before:
                return (*(one for one in after[:added] if one not in now), *now)
            if after[: len(before)] == before:
                return (*now, *(one for one in after[len(before) :] if one not in now))
        return after


@final
@dataclass(frozen=True)
class _FloatingPoint:
    """How the processor rounds, whether it takes the smallest numbers for 0, and its whole environment."""

    rounding: int
    flushes: bool
    environment: bytes = field(compare=False)


def _put_warnings(filters: tuple[Any, ...]) -> None:
    warnings.resetwarnings()  # it also tells the registries of what was shown
    warnings.filters[:] = filters  # type: ignore[index]


def _showing() -> tuple[Any, ...]:
    held: Any = logging
    return warnings.showwarning, warnings.formatwarning, held._warnings_showwarning


def _put_showing(value: tuple[Any, ...]) -> None:
    held: Any = logging
    warnings.showwarning, warnings.formatwarning, held._warnings_showwarning = value


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return ""


def _decimal_of(context: Context) -> dict[str, Any]:
    names = ("prec", "rounding", "Emin", "Emax", "capitals", "clamp")
    return {name: getattr(context, name) for name in names} | {"traps": dict(context.traps)}


def _put_decimal(context: Context, value: Mapping[str, Any]) -> None:
    for name, was in value.items():
        if name == "traps":
            context.traps.update(was)
        else:
            setattr(context, name, was)
    context.clear_flags()


def _environment() -> dict[Any, Any]:
    held: Any = os.environ
    return dict(held._data)  # as the system has it: to decode all of it takes a hundred times as long


def _put_environment(value: Mapping[Any, Any]) -> None:
    held: Any = os.environ
    now = _environment()
    for name in now.keys() - value.keys():
        del os.environ[held.decodekey(name)]
    for name, was in value.items():
        if now.get(name) != was:
            os.environ[held.decodekey(name)] = held.decodevalue(was)
    if sys.platform != "win32":
        zone = held.encodekey("TZ")
        if now.get(zone) != value.get(zone):
            time.tzset()


def _umask() -> int:
    value = os.umask(0o077)  # what another thread makes meanwhile is not open to all
    os.umask(value)
    return value


def _signals() -> dict[Any, Any]:
    found: dict[Any, Any] = {number: _handler_of(number) for number in _SIGNALS}
    if sys.platform != "win32":
        found["blocked"] = frozenset(signal.pthread_sigmask(signal.SIG_BLOCK, ()))
    return found


def _put_signals(value: Mapping[Any, Any]) -> None:
    for number, handler in value.items():
        if number == "blocked" and sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, handler)
        elif handler is not None and signal.getsignal(number) is not handler:
            with suppress(ValueError, OSError):  # not in the main thread
                signal.signal(number, handler)


def _timers() -> tuple[bool, ...]:
    return tuple(any(signal.getitimer(which)) for which in _TIMERS)


def _put_timers(value: tuple[bool, ...]) -> None:
    for which, runs in zip(_TIMERS, value, strict=True):
        if not runs:
            signal.setitimer(which, 0)


def _streams() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in _STREAMS:
        stream: Any = getattr(sys, name)
        found[name] = stream, *(getattr(stream, what, None) for what in ("encoding", "errors", "closed"))
    return found


def _put_streams(value: Mapping[str, Any]) -> None:
    for name, (stream, encoding, errors, _closed) in value.items():
        setattr(sys, name, stream)
        if (getattr(stream, "encoding", None), getattr(stream, "errors", None)) != (encoding, errors):
            with suppress(Exception):
                stream.reconfigure(encoding=encoding, errors=errors)


def _hooks() -> dict[str, Any]:
    found = {name: getattr(sys, name) for name in _HOOKS}
    return found | {"trace": sys.gettrace(), "profile": sys.getprofile(), "threads": threading.excepthook}


def _put_hooks(value: Mapping[str, Any]) -> None:
    for name in _HOOKS:
        setattr(sys, name, value[name])
    threading.excepthook = value["threads"]
    if sys.gettrace() is not value["trace"]:
        sys.settrace(value["trace"])
    if sys.getprofile() is not value["profile"]:
        sys.setprofile(value["profile"])


def _logging() -> tuple[Any, ...]:
    root = logging.root
    return root.level, root.disabled, root.manager.disable, logging.raiseExceptions, tuple(root.handlers)


def _put_logging(value: tuple[Any, ...]) -> None:
    root = logging.root
    level, root.disabled, root.manager.disable, logging.raiseExceptions, handlers = value
    root.handlers[:] = handlers
    root.setLevel(level)  # it also forgets what was decided by the level before


def _put_gc(value: tuple[bool, tuple[int, int, int]]) -> None:
    (gc.enable if value[0] else gc.disable)()
    gc.set_threshold(*value[1])


def _threads_of_libraries() -> dict[str, int]:
    return {one.filepath: one.get_num_threads() for one in libraries().lib_controllers}


def _no_other_number(before: Mapping[str, int], after: Mapping[str, int]) -> bool:
    return all(after.get(name, number) == number for name, number in before.items())  # others may have been loaded


def _put_threads_of_libraries(value: Mapping[str, int]) -> None:
    for one in libraries().lib_controllers:
        if one.filepath in value:
            one.set_num_threads(value[one.filepath])


def _running_threads() -> frozenset[threading.Thread]:
    return frozenset(one for one in threading.enumerate() if not one.name.startswith(OWN_THREAD))


def _no_more_threads(before: frozenset[threading.Thread], after: frozenset[threading.Thread]) -> bool:
    """Tell whether no thread goes on that was not there; one that is about to end may do so."""
    end = time.monotonic() + _PATIENCE
    for thread in after - before:
        if thread is not threading.current_thread():
            thread.join(max(0.0, end - time.monotonic()))
    return not any(thread.is_alive() for thread in after - before)


def _limits() -> dict[int, tuple[int, int]]:
    """Return number of a resource -> its limit, and the highest it may be set to."""
    return {number: resource.getrlimit(number) for number in _LIMITS}


def _put_limits(value: Mapping[int, tuple[int, int]]) -> None:
    for number, limit in value.items():
        with suppress(OSError, ValueError):  # a hard limit that was lowered can be raised again by root alone
            resource.setrlimit(number, limit)


def _floating_point() -> _FloatingPoint | None:
    mathematics = _mathematics()
    if mathematics is None:
        return None
    environment = _MASKS()
    mathematics.fegetenv(environment)
    return _FloatingPoint(mathematics.fegetround(), _SMALLEST * _ONE == 0.0, environment.raw)


def _put_floating_point(value: _FloatingPoint | None) -> None:
    mathematics = _mathematics()
    if value is not None and mathematics is not None:
        mathematics.fesetenv(_MASKS.from_buffer_copy(value.environment))


@cache
def _mathematics() -> Any:
    """Return the library that has the processor's floating-point environment; None where it is not found."""
    for name in (None, "libm.so.6"):
        with suppress(OSError, AttributeError, TypeError):
            found = ctypes.CDLL(name)
            found.fegetenv, found.fesetenv, found.fegetround  # noqa: B018 (they are there)
            return found
    return None


def _list_of_sys(name: str) -> Kind:
    return Kind(
        f"sys.{name}",
        lambda: tuple(getattr(sys, name)),
        lambda value: operator.setitem(getattr(sys, name), _ALL, value),
    )


KINDS: tuple[Kind, ...] = (
    Kind("threads of libraries", _threads_of_libraries, _put_threads_of_libraries, _no_other_number),
    Kind("threads", _running_threads, lambda _: None, _no_more_threads),  # none can be ended from outside
    Kind("timers", _timers, _put_timers),
    Kind("signals", _signals, _put_signals),
    Kind("np.seterr", np.geterr, lambda value: np.seterr(**value)),
    Kind("np.seterrcall", np.geterrcall, np.seterrcall),
    Kind("np.setbufsize", np.getbufsize, np.setbufsize),
    Kind("np.set_printoptions", np.get_printoptions, lambda value: np.set_printoptions(**value)),
    Kind("warnings filters", lambda: tuple(warnings.filters), _put_warnings),
    Kind("warnings.showwarning", _showing, _put_showing),
    Kind("working folder", _folder, os.chdir),
    Kind("decimal context", lambda: _decimal_of(getcontext()), lambda value: _put_decimal(getcontext(), value)),
    Kind(
        "decimal.DefaultContext", lambda: _decimal_of(DefaultContext), lambda value: _put_decimal(DefaultContext, value)
    ),
    Kind("locale", lambda: locale.setlocale(locale.LC_ALL), lambda value: locale.setlocale(locale.LC_ALL, value)),
    Kind("environment", _environment, _put_environment),
    Kind("umask", _umask, os.umask),
    Kind("recursion limit", sys.getrecursionlimit, sys.setrecursionlimit),
    Kind("limit of digits", sys.get_int_max_str_digits, sys.set_int_max_str_digits),
    Kind("switch interval", sys.getswitchinterval, sys.setswitchinterval),
    *map(_list_of_sys, ("path", "argv", "meta_path")),
    Kind("standard streams", _streams, _put_streams),
    Kind("hooks of sys", _hooks, _put_hooks),
    Kind("logging", _logging, _put_logging),
    Kind("garbage collection", lambda: (gc.isenabled(), gc.get_threshold()), _put_gc),
    Kind("socket timeout", socket.getdefaulttimeout, socket.setdefaulttimeout),
    Kind("start of processes", partial(get_start_method, allow_none=True), partial(set_start_method, force=True)),
    Kind("floating-point environment", _floating_point, _put_floating_point),
    Kind("resource limits", _limits, _put_limits),
)
if sys.platform == "linux":
    KINDS += (Kind("processor affinity", partial(os.sched_getaffinity, 0), partial(os.sched_setaffinity, 0)),)
