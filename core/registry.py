"""Names with checked options: a decorator and a dictionary; a class in a user's own file by its path, or its refusal.

An entry's options are the parameters of its factory's signature, and are checked here and nowhere else. People outside
add entries through an entry point, or name a class as ``pkg.module:Class`` or ``./file.py:Class``. Who types such a
path asks for its code. A file that names one does not: within `names_of_files` a registry has what is registered, and
what was typed in this process; it imports nothing else unless the user trusts the files.
"""

import ast
import difflib
import importlib
import operator
import sys
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, Literal, TypeVar

from calibench.core import sources, user_file
from calibench.core.options import Option, checked_options, declared_options, shown, suggest

T = TypeVar("T")
_DEPTH = 12  # of lists in lists, as rows tell them
_DOES = {"problem": "__call__", "optimizer": "minimize", "machine": "formulate"}  # what a class of a kind has
_LISTED = 8  # names of a user's file that a message lists; of a long file those that are near
_NAMES: ContextVar[Literal["typed", "read", "trusted"]] = ContextVar("_NAMES", default="typed")
_LEAVES_OUT: ContextVar[str] = ContextVar("_LEAVES_OUT", default="")
_NOT_IMPORTED: dict[tuple[str, str], dict[str, None]] = {}  # of what files named and nobody has typed, what is left out


class UnknownName(ValueError):
    """A name that is in no registry of its kind; the message suggests the nearest."""


class MissingFile(ValueError):
    """A class by its path, and there is no such file."""


class NotImported(ValueError):
    """A class by its path that a file names, and nobody has typed: reading does not import it."""


@contextmanager
def names_of_files(trust: bool = False, leaves_out: str = "") -> Iterator[None]:
    """Let registries import no class that a file names, unless `trust`; `leaves_out` is what goes untold without it."""
    before = _NAMES.set("trusted" if trust or _NAMES.get() == "trusted" else "read")
    untold = _LEAVES_OUT.set(leaves_out)
    try:
        yield
    finally:
        _NAMES.reset(before)
        _LEAVES_OUT.reset(untold)


def take_not_imported() -> dict[tuple[str, str], list[str]]:
    """Return by kind and name, of each class that was not imported since the last call, what was left out for it."""
    taken = {key: [what for what in left_out if what] for key, left_out in _NOT_IMPORTED.items()}
    _NOT_IMPORTED.clear()
    return taken


@dataclass(frozen=True)
class Made:
    """What something was made with: the entry's name, the arguments given, all with the defaults, and the factory."""

    name: str
    given: Mapping[str, Any]
    arguments: Mapping[str, Any]
    factory: Callable[..., Any]


@dataclass
class Registry(Generic[T]):
    """The entries of one kind (`kind` is the word users see: problem, optimizer, ...).

    `group` is the entry-point group in which other packages name their own. Names that were promised (`promise`) are
    known at once, and their modules loaded when one of them is asked for.
    """

    kind: str
    group: str
    _factories: dict[str, Callable[..., T]] = field(default_factory=dict)
    _options: dict[str, Callable[..., Any]] = field(default_factory=dict)
    _order: dict[str, None] = field(default_factory=dict)
    _promised: dict[str, str] = field(default_factory=dict)
    _left_out: dict[str, str] = field(default_factory=dict)
    _by_path: dict[str, Callable[..., T]] = field(default_factory=dict)
    _places: dict[str, Path] = field(default_factory=dict)
    _known: dict[str, str] = field(default_factory=dict, repr=False)
    _read: dict[str, tuple[Callable[..., Any], dict[str, Option]]] = field(default_factory=dict, repr=False)
    _made: dict[int, tuple[Callable[[], Any], Made]] = field(default_factory=dict, repr=False)
    _outside_loaded: bool = False

    def register(
        self, name: str, options: Callable[..., Any] | None = None, *, same: Callable[[T], bool] | None = None
    ) -> Callable[[Callable[..., T]], Any]:
        """Enter the decorated factory under `name`. A name is entered once; its options are those of its signature.

        `options` is another callable whose signature declares the options, for a factory that takes ``**options``.
        An entry that is the `same` is replaced: its code was run again.
        """

        def enter(factory: Callable[..., T]) -> Callable[..., T]:
            if (home := self._promised.get(name)) and home not in sys.modules:  # another's, under a name of ours
                self._load_promised(home)
            if name in self._factories and not (same and same(self._factories[name]())):
                raise ValueError(f"{self.kind} {name!r} is registered twice; give one of them another name")
            self._factories[name] = factory
            self._options[name] = options or factory
            self._order.setdefault(name)
            return factory

        return enter

    def promise(self, module: str, *names: str) -> None:
        """Say that `module` registers `names` when it is loaded; they are listed in the order of the promises."""
        for name in names:
            self._order.pop(name, None)
            self._order[name] = None
            if name not in self._factories:
                self._promised[name] = module

    def exclude(self, name: str, reason: str) -> None:
        """Keep `name` for what a library has and this registry has not; asking for it gives the reason."""
        if name in self._factories:
            raise ValueError(f"{self.kind} {name!r} is registered: it cannot be left out")
        self._left_out[name] = reason

    @property
    def left_out(self) -> dict[str, str]:
        """Return name -> the reason why it is not in the registry, or why another package's is not."""
        self._load_promised()
        self._load_outside()
        return dict(self._left_out)

    def names(self) -> list[str]:
        """Return all names in order of entry, those of other packages last."""
        self._load_outside()
        return list(self._order)

    def __contains__(self, name: object) -> bool:
        """Tell whether `name` is one of the names; other packages are asked where it is none of ours."""
        if name not in self._order:
            self._load_outside()
        return name in self._order

    def factories(self) -> dict[str, Callable[..., T]]:
        """Return name -> what builds it."""
        self._load_promised()
        return {name: self._factories[name] for name in self.names()}

    def options(self, name: str) -> dict[str, Option]:
        """Return the options of `name` in the order they are declared."""
        return self._declared(self.told_name(name))

    def option(self, name: str, key: str) -> Option:
        """Return the option `key` of `name`, ``noise.sigma`` inside another; raise `ValueError` where there is none."""
        declared, owner, (first, *inside) = self.options(name), name, key.split(".")
        if first in declared and inside and not declared[first].fields:
            raise ValueError(f"{name} has no option {key!r}, as {first} is one value; write {first}=VALUE")
        for part in (first, *inside):
            if part not in declared:
                raise ValueError(f"{owner} has no option {part!r}; {suggest(part, declared)}")
            option, owner = declared[part], f"{owner}.{part}"
            declared = option.fields
        return option

    def make(self, name: str, /, **options: Any) -> T:
        """Build the entry `name` with `options`; raise `ValueError` for what is no name, option or value of one."""
        known = self.told_name(name)
        given = checked_options(known, self._declared(known), options)
        factory = self._by_path[known] if ":" in known else self._factories[known]
        defaults = {key: option.default for key, option in self._declared(known).items()}
        # lists and arrays are each object's own, defaults too: what it does to them reaches no other
        own = {key: copy for key, value in defaults.items() if (copy := _copied(value)) is not value}
        try:
            thing = factory(**own | {key: _copied(value) for key, value in given.items()})
        except ValueError as error:
            if ":" not in known:
                raise
            asked = "".join(f" {key}={shown(value)}" for key, value in given.items())
            raise ValueError(f"{known}{asked}: {error}") from error  # a class of a user's says what, and not where
        number = id(thing)
        try:
            get: Callable[[], Any] = weakref.ref(thing, lambda _: self._made.pop(number, None))
        except TypeError:  # it takes no weak reference (__slots__): keep it, so that nothing else gets its id
            get = partial([thing].__getitem__, 0)
        self._made[number] = get, Made(known, given, defaults | given, factory)
        return thing

    def made(self, thing: Any) -> Made | None:
        """Return what `thing` was made with; None where it was not made here."""
        get, made = self._made.get(id(thing), (lambda: None, None))
        return made if get() is thing else None

    def factory(self, name: str) -> Callable[..., T]:
        """Return what builds the entry `name`."""
        known = self.told_name(name)
        return self._by_path[known] if ":" in known else self._factories[known]

    def place(self, name: str) -> str:
        """Return the name under which another process, in any folder, finds the entry `name`."""
        known = self.told_name(name)
        return f"{self._places[known]}:{known.rpartition(':')[2]}" if known in self._places else known

    def check(self, name: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return `options` with values in the types their declarations ask for; raise `ValueError` as `make` does."""
        known = self.told_name(name)
        return checked_options(known, self._declared(known), options)

    def complete(self, name: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return what `check` does, and the defaults of the options that are not given."""
        return {key: one.default for key, one in self.options(name).items()} | self.check(name, options)

    def _declared(self, known: str) -> dict[str, Option]:
        factory = self._by_path[known] if ":" in known else self._options[known]
        before = self._read.get(known)
        if before is None or before[0] is not factory:  # a user's file is loaded again after an edit
            before = self._read[known] = factory, declared_options(factory)
        return before[1]

    def told_name(self, name: str) -> str:
        """Return the name of an entry in results, after it was loaded; a user's file has no path of this machine."""
        if name in self:
            if name in self._promised:
                self._load_promised(self._promised[name])
            return name
        if _NAMES.get() == "read" and (":" in name or name.endswith(".py")):
            if name not in self._by_path:
                _NOT_IMPORTED.setdefault((self.kind, name), {})[_LEAVES_OUT.get()] = None
                raise NotImported(f"the {self.kind} is {name}, which reading does not import; --trust does")
            return name
        if name in self._known and user_file.KEPT:
            return self._known[name]
        if user_file.is_file_path(name):  # by itself too once it was loaded, wherever one stands
            file, attribute = user_file.place_of(name), name.rpartition(":")[2]
            if name in self._places and not file.is_file():
                file = self._places[name]
            known = f"{user_file.told_name(self._file(name, file))}:{attribute}"
            before = self._places.get(known, file)
            if before != file and before.is_file():
                raise ValueError(
                    f"{self.kind} {name!r}: {known} is also {before}, and results could not tell the two apart; rename "
                    "one file, or make their folders packages (an empty __init__.py in each)"
                )
            module = self._module(name, file)
            self._by_path[known], self._places[known] = self._attribute(name, module, attribute), file
            if name == f"{file}:{attribute}":  # another path leads elsewhere from another folder
                self._known[name] = known
            return known
        if ":" in name:
            if name not in self._by_path:
                home, _, attribute = name.partition(":")
                with user_file.no_bytecode():
                    self._by_path[name] = self._attribute(name, self._module(name, home), attribute)
            return name
        self._load_promised()  # it may be one that they leave out
        if name in self._left_out:
            raise ValueError(f"{self.kind} {name!r} is left out: {self._left_out[name]}")
        if name.endswith(".py"):
            file = self._file(name, user_file.place_of(f"{name}:"))
            classes = [f"{name}:{one}" for one in _own_names(self._module(name, file), self.kind)]
            inside = suggest("", classes) if classes else "it has no class or function"
            raise ValueError(
                f"{self.kind} {name!r}: which class of the file is not said; write FILE.py:CLASS; {inside}"
            )
        raise UnknownName(f"unknown {self.kind} {name!r}; {beside(self.kind, name)}{suggest(name, self._order)}")

    def _load_promised(self, module: str = "") -> None:
        for one in [module] if module else list(dict.fromkeys(self._promised.values())):
            importlib.import_module(one)
            kept = [name for name, of in self._promised.items() if of == one]
            if missing := [name for name in kept if name not in self._factories]:
                raise ValueError(f"{one} was to register {self.kind} {', '.join(missing)}, and did not")
            for name in kept:
                self._promised.pop(name, None)

    def _load_outside(self) -> None:
        if self._outside_loaded:
            return
        self._outside_loaded = True
        for point in entry_points(group=self.group):
            before = set(self._order)
            try:
                from calibench.core.own_state import loaded_apart

                entry = loaded_apart(point.load, point.module)
                if point.name in before or point.name not in self._factories:  # or it entered itself as it was loaded
                    self.register(point.name)(entry)
            except Exception as error:  # another package's fault must not take our names away
                reason = f"{point.value}, which announces it, cannot be loaded: {error}"
                self._left_out.setdefault(point.name, reason)

    def _file(self, path: str, file: Path) -> Path:
        if not file.is_file():
            beside = sorted(p.name for p in file.parent.glob("*.py"))
            none = "its folder has no file of Python" if file.parent.is_dir() else "nor is its folder there"
            way = suggest(file.name, beside) if beside else f"{none}; give its path from here, or from the root"
            raise MissingFile(f"{self.kind} {path!r}: there is no file {file}; {way}")
        return file

    def _module(self, path: str, place: Path | str) -> ModuleType:
        """Return the module in a file or of a name, whose digest is that of what was loaded."""
        from calibench.core.own_state import loaded_apart

        try:
            if isinstance(place, Path):
                module = user_file.load(place)
            else:
                module = loaded_apart(lambda: importlib.import_module(place))
        except Exception as error:  # whatever a user's module raises as it is loaded
            words = " ".join(str(error).split())
            words = words if isinstance(error, ImportError) else f"{type(error).__name__}: {words}"
            raise ValueError(f"cannot import {self.kind} {path!r}: {words}") from error
        sources.module_digest(module.__name__)  # before the file is edited again
        return module

    def _attribute(self, path: str, module: ModuleType, attribute: str) -> Callable[..., T]:
        factory: Callable[..., T] | None = getattr(module, attribute, None) if attribute else None
        if factory is None:
            theirs = _own_names(module, self.kind)
            many = len(theirs) > _LISTED
            near = difflib.get_close_matches(attribute, theirs, n=_LISTED, cutoff=0.3) if many else theirs
            where = path.rpartition(":")[0]
            raise ValueError(
                f"cannot find {self.kind} {path!r}: {where} has no {attribute!r}; {suggest(attribute, near)}"
            )
        if not isinstance(factory, type) and any(hasattr(factory, name) for name in ("lower", "minimize")):
            raise ValueError(
                f"{self.kind} {path!r} is an object, and what makes one is needed: its class, or a function that "
                "returns it"
            )
        if not callable(factory):
            raise ValueError(f"{self.kind} {path!r} is not a class or function")
        return factory


def _copied(value: Any, depth: int = 0) -> Any:
    """Return `value` with lists, mappings, sets and arrays of its own; what stands in them is the same."""
    if depth > _DEPTH:
        return value
    if type(value).__module__ == "numpy" and type(value).__name__ == "ndarray":  # a registry needs no NumPy
        return value.copy()
    if type(value) is dict:
        return {key: _copied(item, depth + 1) for key, item in value.items()}
    if type(value) in (list, tuple):
        items = [_copied(item, depth + 1) for item in value]
        return items if type(value) is list else value if all(map(operator.is_, items, value)) else tuple(items)
    return set(value) if type(value) is set else value


def _own_names(module: ModuleType, kind: str) -> list[str]:
    """Return the names of the classes of a module that can be of a kind; if none can, of all that it defines."""
    own = {
        name: value
        for name, value in vars(module).items()
        if callable(value) and not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    }
    needed = _DOES.get(kind, "")
    serving = [name for name, value in own.items() if any(needed in vars(c) for c in getattr(value, "__mro__", ()))]
    return serving if needed and serving else list(own)


def beside(kind: str, name: str) -> str:
    """Return how the classes of a file ``NAME.py`` in the working folder are named, before other ways out; or ""."""
    file = Path(f"{name}.py")
    try:  # it is parsed, not run
        body = ast.parse(file.read_bytes()).body if name.isidentifier() and file.is_file() else []
    except (OSError, SyntaxError, ValueError):
        body = []
    public = [node.name for node in body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    classes = [f"{kind}={file}:{one}" for one in public[:_LISTED]]
    return f"of the file here: {' or '.join(classes)}; " if classes else ""


def about(factory: Callable[..., Any]) -> str:
    """Return the first line of `factory`'s docstring."""
    described = "__doc__" in getattr(factory, "__dict__", {})  # a partial tells of itself, or of what it calls
    target = factory.func if hasattr(factory, "func") and not described else factory
    return (target.__doc__ or "").strip().partition("\n")[0]
