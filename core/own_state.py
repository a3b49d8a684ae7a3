"""What a run of foreign code sets in its process is its own: read before, put back after, and named for its row.

A run of a user's class is made within ``kept()``. What still differs after the attempt to put it back, such as a thread
that goes on, is `lasting`: the process should make no further run. What the *import* of a module sets comes once in a
process, yet it belongs to each run whose code imports that module, and to no other. So it is taken off as soon as a
user's file is loaded (`loaded_apart`), and set again where a run comes to that ``import``. What an installed package
sets as it is imported acts likewise and is not named; ``importlib.import_module`` within a run is not seen.
"""

import builtins
import gc
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar, final

from calibench.core.process_state import KINDS, SLOW
from calibench.core.sources import is_local

T = TypeVar("T")
_OURS = __name__.partition(".")[0]
_State = dict[int, Any]  # number of a kind -> its value
_Change = dict[int, tuple[Any, Any]]  # number of a kind -> what it was, and what it became
_LASTING: list[tuple[int, Any]] = []  # number of a kind -> what it should be
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_LASTING.clear)  # a child begins as its parent is
_PYTHONS: list[Callable[..., ModuleType]] = [builtins.__import__]  # in whose place ours stands
_SEEING: list[bool] = []  # of each block whose imports are seen: whether garbage was collected before it
_UNREADABLE = object()  # the value of a kind that a run has put beyond reading


class _Import(NamedTuple):
    """What the import of a module sets: first what the `modules` do that it imports, then what it does itself."""

    modules: tuple[str, ...]
    change: _Change
    is_installed: bool


_BY_IMPORT: dict[str, _Import] = {}  # of the modules whose import sets something


@final
class Kept:
    """The state of the process as a run, or the import of a module, began; and what it has changed since."""

    def __init__(self, first: int = 0) -> None:
        self._before = _state(range(first, len(KINDS)))
        self._usual = dict(self._before)  # with what installed packages have set
        self._expected = dict(self._before)  # with what all imports have set
        self._process = os.getpid()
        self._names: set[str] = set()
        self._is_over = False
        self.acted: dict[str, None] = {}  # modules that were imported here and set something, in that order

    @property
    def names(self) -> list[str]:
        """Return the names of what was found to be changed, in the order of the table."""
        return [name for name in dict.fromkeys(kind.name for kind in KINDS) if name in self._names]

    def note(self, names: Iterable[str]) -> None:
        """Take over what was found to be changed in the child process that made the run."""
        self._names.update(names)

    def put_back(self) -> list[str]:
        """Put all back as it was, once, and return the names of what was changed since the beginning."""
        if not self._is_over:
            self._is_over = True
            change = self.undo()
            self.note(
                KINDS[number].name for number, (_, now) in change.items() if not _same(number, self._usual[number], now)
            )
            for number, (was, _) in change.items():
                if os.getpid() == self._process and not _same(number, was, _state([number])[number]):
                    _LASTING.append((number, was))
        return self.names

    def undo(self) -> _Change:
        """Put all back as it was, and return what was otherwise."""
        change = self.change()
        for number, (was, _) in change.items():
            with suppress(Exception):  # what differs still is looked at
                KINDS[number].put(was)
        return change

    def change(self, own: bool = False) -> _Change:
        """Return all that is otherwise than it was; its `own` without what the modules that were imported have set."""
        before = self._expected if own else self._before
        now = _state(before)
        return {
            number: (was, now[number])
            for number, was in before.items()
            if was is not now[number] and not _same(number, was, now[number])
        }

    def expect(self, what: _Import) -> None:
        """Take what an import sets as what should be."""
        for state in (self._expected, self._usual) if what.is_installed else (self._expected,):
            for number, (before, after) in what.change.items():
                if number in state:
                    state[number] = KINDS[number].merged(before, after, state[number])


UNDER_WAY: ContextVar[tuple[Kept, ...]] = ContextVar("UNDER_WAY", default=())  # runs and imports, the innermost last


@contextmanager
def kept(*modules: str) -> Iterator[Kept]:
    """Keep what is done in the block from all that comes after it; the imports of `modules` act in it."""
    with _imports_seen():
        run = Kept()
        try:
            with _under_way(*UNDER_WAY.get(), run):
                for module in dict.fromkeys(modules):
                    _act(module)
                yield run
        finally:
            run.put_back()


@contextmanager
def _under_way(*these: Kept, undone: bool = False) -> Iterator[None]:
    """Let `these` be under way in the block; `undone`: what the last has changed is put back at the end of it."""
    token = UNDER_WAY.set(these)
    try:
        yield
    finally:
        UNDER_WAY.reset(token)
        if undone:
            these[-1].undo()


def lasting() -> list[str]:
    """Return the names of what runs of this process have changed and nothing could put back."""
    _LASTING[:] = [(number, was) for number, was in _LASTING if not _same(number, was, _state([number])[number])]
    return sorted({KINDS[number].name for number, _ in _LASTING})


def loaded_apart(load: Callable[[], T], module: str = "") -> T:
    """Return what `load` returns, or the module; what its import sets is kept for the runs of `module`."""
    loaded = set(sys.modules)
    with _imports_seen(), _under_way(this := Kept(), undone=True):
        thing = load()
        name: str = module or thing.__name__  # type: ignore[attr-defined]
        if name not in loaded:  # no run has come to its import before
            _remember([name], _Import(tuple(this.acted), this.change(own=True), is_installed=False))
        return thing


def _state(numbers: Iterable[int]) -> _State:
    """Return what the kinds of these numbers are now; it is asked several times a run."""
    state: _State = {}
    for number in numbers:
        try:
            state[number] = KINDS[number].read()
        except Exception:  # a run may have put anything in its place
            state[number] = _UNREADABLE
    return state


def _same(number: int, was: Any, now: Any) -> bool:
    try:
        return was is now or KINDS[number].same(was, now)
    except Exception:  # so too
        return False


def _remember(modules: Iterable[str], what: _Import) -> None:
    for module in modules:
        if what.change or what.modules:
            _BY_IMPORT[module] = what
        else:
            _BY_IMPORT.pop(module, None)


def _act(module: str) -> None:
    """Set what the import of `module` sets, once a run."""
    under_way = UNDER_WAY.get()
    if not under_way or module in under_way[-1].acted or module not in _BY_IMPORT:
        return
    is_done = any(module in one.acted for one in under_way)
    for one in under_way:
        one.acted[module] = None
    if is_done:
        return
    what = _BY_IMPORT[module]
    for other in what.modules:
        _act(other)
    for number, (before, after) in what.change.items():
        value = KINDS[number].merged(before, after, _state([number])[number])
        with suppress(Exception):  # as in `undo`
            KINDS[number].put(value)
    for one in under_way:
        one.expect(what)


@contextmanager
def _imports_seen() -> Iterator[None]:
    """See each ``import`` of the block: what it sets is remembered, and set again by the next of the same module.

    Garbage is collected meanwhile: elsewhere this package may let that rest, and would not see that somebody else does.
    """
    _SEEING.append(gc.isenabled())
    gc.enable()
    if len(_SEEING) == 1 and builtins.__import__ is not _import:
        _PYTHONS[0], builtins.__import__ = builtins.__import__, _import
    try:
        yield
    finally:
        if not _SEEING.pop():
            gc.disable()
        if not _SEEING:
            builtins.__import__ = _PYTHONS[0]


def _import(
    name: str,
    globals: Mapping[str, object] | None = None,
    locals: Mapping[str, object] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    known = globals or {}
    by_ours = str(known.get("__name__")).partition(".")[0] == _OURS
    whole = name
    if level:
        package = known.get("__package__") or str(known.get("__name__", "")).rpartition(".")[0]
        with suppress(ImportError):  # Python says so itself
            whole = importlib.util.resolve_name("." * level + name, str(package))
    # a module's packages, itself, and what may be its parts
    names, parts = fromlist or (), whole.split(".")
    asked = [".".join(parts[: end + 1]) for end in range(len(parts))] + [f"{whole}.{one}" for one in names]

    inside = getattr(sys.modules.get(whole), "__dict__", None)  # None: it is not there, or cannot be imported
    if inside is not None and all(one in inside or one == "*" or f"{whole}.{one}" in sys.modules for one in names):
        if _BY_IMPORT and not by_ours:
            for module in asked:
                _act(module)
        return _PYTHONS[0](name, globals, locals, fromlist, level)

    loaded, this = set(sys.modules), Kept(SLOW)
    with _under_way(*(() if by_ours else UNDER_WAY.get()), this, undone=by_ours):
        try:
            return _PYTHONS[0](name, globals, locals, fromlist, level)
        finally:
            new = [module for module in asked if module in sys.modules and module not in loaded]
            files = [getattr(sys.modules.get(module), "__file__", None) for module in new or [whole]]
            lost = any(module not in sys.modules for module in new or [whole])
            of_users = lost or any(file is not None and is_local(Path(file).resolve()) for file in files)
            what = _Import(tuple(this.acted), this.change(own=True), not of_users)
            _remember(new, what)
            for one in UNDER_WAY.get():
                one.acted |= dict.fromkeys(module for module in new if module in _BY_IMPORT)
                one.expect(what)
