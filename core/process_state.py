"""The state of a process that foreign code can set: one table of what it is, how it is read and how it is set.

Python has one working folder, one locale, one handling of floating-point faults. `core.own_state` reads all of `KINDS`
before a run of a user's class, and compares and puts it back after. Each is read in some microseconds, as it is done
twice a run.
"""

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
from dataclasses import dataclass
from decimal import Context, DefaultContext, getcontext
from functools import cache, partial
from multiprocessing import get_start_method, set_start_method
from typing import Any, final

import numpy as np

from calibench.core.process import libraries

if sys.platform == "win32":
    _LIMITS: tuple[int, ...] = ()
else:
    import fcntl
    import resource

    _LIMITS = tuple({getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")})

SLOW = 2  # of `KINDS` the first so many take a millisecond once a library was loaded or a thread begun
OWN_THREAD = "calibench-"  # how the names of this package's own threads begin
_PATIENCE = 0.05  # seconds for threads that are about to end
_SMALLEST, _ONE = 5e-324, 1.0
_HOOKS = ("excepthook", "displayhook", "unraisablehook", "breakpointhook")
_SIGNALS = tuple(map(int, signal.valid_signals()))
_TIMERS = tuple(
    getattr(signal, name) for name in ("ITIMER_REAL", "ITIMER_VIRTUAL", "ITIMER_PROF") if hasattr(signal, name)
)
_handler_of: Callable[[int], Any] = importlib.import_module("_signal").getsignal  # it looks up no names, so is quicker
_HELD: dict[tuple[int, int], int] = {}  # device and number of a file -> a descriptor of ours; the last seen at the end
_MOST_HELD = 16
_MASKS = ctypes.c_char * 64  # more than fenv_t has on any system


@final
@dataclass(frozen=True)
class Kind:
    """A kind of state: what a row calls it (several may be called alike), how it is read as a value, and how it is set.

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


def _attributes(name: str, *of: tuple[Any, str]) -> Kind:
    def put(value: Mapping[int, Any]) -> None:
        for k, was in value.items():
            setattr(*of[k], was)

    return Kind(name, lambda: {k: getattr(thing, attribute) for k, (thing, attribute) in enumerate(of)}, put)


def _items(name: str, thing: Any, attribute: str) -> Kind:
    return Kind(
        name,
        lambda: tuple(getattr(thing, attribute)),
        lambda value: operator.setitem(getattr(thing, attribute), slice(None), value),
    )


def _decimal(name: str, get: Callable[[], Context]) -> Kind:
    names = ("prec", "rounding", "Emin", "Emax", "capitals", "clamp")

    def read() -> dict[str, Any]:
        context = get()
        return {name: getattr(context, name) for name in names} | {"traps": dict(context.traps)}

    def put(value: Mapping[str, Any]) -> None:
        context = get()
        context.traps.update(value["traps"])
        for name in names:
            setattr(context, name, value[name])
        context.clear_flags()

    return Kind(name, read, put)


def _put_warnings(filters: tuple[Any, ...]) -> None:
    warnings.resetwarnings()  # it also tells the registries of what was shown
    warnings.filters[:] = filters  # type: ignore[index]


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return ""


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
    handlers: dict[Any, Any] = {number: _handler_of(number) for number in _SIGNALS}
    if sys.platform != "win32":
        handlers["blocked"] = frozenset(signal.pthread_sigmask(signal.SIG_BLOCK, ()))
    return handlers


def _put_signals(value: Mapping[Any, Any]) -> None:
    for number, handler in value.items():
        if number == "blocked" and sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, handler)
        elif handler is not None and signal.getsignal(number) is not handler:
            with suppress(ValueError, OSError):  # not in the main thread
                signal.signal(number, handler)


def _streams() -> dict[str, Any]:
    streams: dict[str, Any] = {name: getattr(sys, name) for name in ("stdin", "stdout", "stderr")}
    about = ("encoding", "errors", "closed")
    return {name: (one, *(getattr(one, what, None) for what in about)) for name, one in streams.items()}


def _put_streams(value: Mapping[str, Any]) -> None:
    for name, (stream, encoding, errors, _closed) in value.items():
        setattr(sys, name, stream)
        if (getattr(stream, "encoding", None), getattr(stream, "errors", None)) != (encoding, errors):
            with suppress(Exception):
                stream.reconfigure(encoding=encoding, errors=errors)


def _standard_files() -> dict[int, tuple[int, int] | None]:
    """Return which files the descriptors of the standard streams are of; a copy of each is held, to put it back."""
    files: dict[int, tuple[int, int] | None] = dict.fromkeys(range(3))
    for number in files:
        with suppress(OSError):  # it is closed
            file = os.fstat(number)
            files[number] = which = (file.st_dev, file.st_ino)
            if sys.platform != "win32":
                _HELD[which] = _HELD.pop(which, 0) or fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, len(files))
    while len(_HELD) > _MOST_HELD:  # of files that were there for one run
        os.close(_HELD.pop(next(iter(_HELD))))
    return files


def _put_standard_files(value: Mapping[int, tuple[int, int] | None]) -> None:
    now = _standard_files()
    for number, which in value.items():
        if which is not None and which != now[number]:
            os.dup2(_HELD[which], number)
        elif which is None and now[number] is not None:
            os.close(number)


def _no_more_threads(before: frozenset[threading.Thread], after: frozenset[threading.Thread]) -> bool:
    """Tell whether no thread goes on that was not there; one that is about to end may do so."""
    end = time.monotonic() + _PATIENCE
    for thread in after - before:
        if thread is not threading.current_thread():
            thread.join(max(0.0, end - time.monotonic()))
    return not any(thread.is_alive() for thread in after - before)


def _put_limits(value: Mapping[int, tuple[int, int]]) -> None:
    for number, limit in value.items():
        with suppress(OSError, ValueError):  # a hard limit that was lowered can be raised again by root alone
            resource.setrlimit(number, limit)


def _floating_point() -> tuple[int, bool, bytes] | None:
    """Return how the processor rounds, whether it takes the smallest numbers for 0, and its whole environment."""
    mathematics = _mathematics()
    if mathematics is None:
        return None
    environment = _MASKS()
    mathematics.fegetenv(environment)
    return mathematics.fegetround(), _SMALLEST * _ONE == 0.0, environment.raw


@cache
def _mathematics() -> Any:
    """Return the library that has the processor's floating-point environment; None where it is not found."""
    for name in (None, "libm.so.6"):
        with suppress(OSError, AttributeError, TypeError):
            library = ctypes.CDLL(name)
            library.fegetenv, library.fesetenv, library.fegetround  # noqa: B018 (they are there)
            return library
    return None


KINDS: tuple[Kind, ...] = (
    Kind(
        "threads of libraries",
        lambda: {one.filepath: one.get_num_threads() for one in libraries().lib_controllers},
        lambda value: [
            one.set_num_threads(value[one.filepath]) for one in libraries().lib_controllers if one.filepath in value
        ],
        lambda was, now: all(now.get(name, number) == number for name, number in was.items()),  # more may be loaded
    ),
    Kind(
        "threads",
        lambda: frozenset(one for one in threading.enumerate() if not one.name.startswith(OWN_THREAD)),
        lambda _: None,  # none can be ended from outside
        _no_more_threads,
    ),
    Kind(
        "timers",
        lambda: tuple(any(signal.getitimer(which)) for which in _TIMERS),
        lambda value: [signal.setitimer(which, 0) for which, runs in zip(_TIMERS, value, strict=True) if not runs],
    ),
    Kind("signals", _signals, _put_signals),
    Kind("np.seterr", np.geterr, lambda value: np.seterr(**value)),
    Kind("np.seterrcall", np.geterrcall, np.seterrcall),
    Kind("np.setbufsize", np.getbufsize, np.setbufsize),
    Kind("np.set_printoptions", np.get_printoptions, lambda value: np.set_printoptions(**value)),
    Kind("warnings filters", lambda: tuple(warnings.filters), _put_warnings),
    _attributes(
        "warnings.showwarning",
        (warnings, "showwarning"),
        (warnings, "formatwarning"),
        (logging, "_warnings_showwarning"),
    ),
    Kind("working folder", _folder, os.chdir),
    _decimal("decimal context", getcontext),
    _decimal("decimal.DefaultContext", lambda: DefaultContext),
    Kind("locale", lambda: locale.setlocale(locale.LC_ALL), lambda value: locale.setlocale(locale.LC_ALL, value)),
    Kind("environment", _environment, _put_environment),
    Kind("umask", _umask, os.umask),
    Kind("recursion limit", sys.getrecursionlimit, sys.setrecursionlimit),
    Kind("limit of digits", sys.get_int_max_str_digits, sys.set_int_max_str_digits),
    Kind("switch interval", sys.getswitchinterval, sys.setswitchinterval),
    *(_items(f"sys.{name}", sys, name) for name in ("path", "argv", "meta_path")),
    Kind("standard streams", _streams, _put_streams),
    _attributes("hooks of sys", *((sys, name) for name in _HOOKS), (threading, "excepthook")),
    Kind("hooks of sys", sys.gettrace, sys.settrace),
    Kind("hooks of sys", sys.getprofile, sys.setprofile),
    _attributes("logging", (logging.root, "disabled"), (logging.root.manager, "disable"), (logging, "raiseExceptions")),
    _items("logging", logging.root, "handlers"),
    Kind("logging", lambda: logging.root.level, logging.root.setLevel),  # which forgets what was decided before
    Kind("garbage collection", gc.isenabled, lambda collects: gc.enable() if collects else gc.disable()),
    Kind("garbage collection", gc.get_threshold, lambda value: gc.set_threshold(*value)),
    Kind("socket timeout", socket.getdefaulttimeout, socket.setdefaulttimeout),
    Kind("start of processes", partial(get_start_method, allow_none=True), partial(set_start_method, force=True)),
    Kind(
        "floating-point environment",
        _floating_point,
        lambda value: None if value is None else _mathematics().fesetenv(_MASKS.from_buffer_copy(value[2])),
        lambda was, now: (was or ())[:2] == (now or ())[:2],
    ),
    Kind("resource limits", lambda: {number: resource.getrlimit(number) for number in _LIMITS}, _put_limits),
)
if sys.platform != "win32":
    KINDS += (Kind("standard files", _standard_files, _put_standard_files),)
if sys.platform == "linux":
    KINDS += (Kind("processor affinity", partial(os.sched_getaffinity, 0), partial(os.sched_setaffinity, 0)),)
