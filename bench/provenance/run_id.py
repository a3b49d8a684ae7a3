"""The identity of a run: canonical names and options, the digest that names it, and the seeds that follow from names.

Nothing here depends on the order of jobs, on the machine, or on Python's `hash`. Options are JSON in which every
difference between two runs is kept: numbers, texts, lists and mappings stay as they are, a dataclass becomes its
fields; a large array, another object or a nameless function is a digest of its content. What has none is refused.
"""

import inspect
import json
import types
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from hashlib import blake2b
from pathlib import PurePath
from sys import modules
from typing import Any

import numpy as np

from calibench import optimizers, problems
from calibench.core.options import CLASS, Option, declared_options
from calibench.core.registry import Made, Registry
from calibench.core.seeds import digest
from calibench.problems.base import extra_of

OPTIONS = "options"  # the attribute by which an object may tell what it is
UNSEEN = "unseen, box"  # stands, with a digest of the box, for a parameter that no attribute of an object tells
_ANY = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def name_of(thing: Any) -> str:
    """Return the registered name of a problem or optimiser, its `name`, or the place of its class without one."""
    made = made_as(thing)
    if made is not None:
        return made.name
    name = getattr(thing, "name", None)
    if isinstance(name, str):
        return name
    kind = thing if isinstance(thing, type) or hasattr(thing, "__qualname__") else type(thing)
    return f"{kind.__module__}:{kind.__qualname__}"


def options_of(thing: Any) -> dict[str, Any]:
    """Return the options of a problem or optimiser as JSON can hold them; `ValueError` for one that cannot be told.

    For an entry of a registry: the arguments it was given, then its own `options`, then the defaults; an option of its
    `said_if_chosen` only where it was given. For another object: its `options`, or its dataclass fields, or its
    attributes named as the parameters of its `__init__` (``self.n`` or ``self._n``). Where `options` is one parameter
    beside others, it says nothing of them, but for a class with ``options_tell_all = True``.
    """
    made = made_as(thing)
    if made is None:
        return _as_plain(thing, seen_options(thing))
    return _of_made(thing, made, _said(thing, made.arguments, made.arguments.get(OPTIONS)) or {})


def seen_options(thing: Any) -> Mapping[Any, Any]:
    """Return the options of an object that no registry made; 10 and 10.0 of a float are one run."""
    said = _said(thing, _parameters(type(thing)))
    if said is not None:
        return said
    if isinstance(thing, type):
        return {}
    found: dict[str, Any] = {}
    if is_dataclass(thing):
        found = {field.name: getattr(thing, field.name) for field in fields(thing) if field.init}
    else:
        hidden = []
        for name in _parameters(type(thing)):
            attribute = next((each for each in (name, f"_{name}") if hasattr(thing, each)), None)
            if attribute is None:
                hidden.append(name)
            else:
                found[name] = getattr(thing, attribute)
        if hidden:
            box = [np.asarray(getattr(thing, side, ()), dtype=float).tolist() for side in ("lower", "upper", "start")]
            found |= dict.fromkeys(hidden, f"{UNSEEN} {digest(box)}")
    kind: Any = type(thing)
    declared = _declared(kind)
    for name, value in found.items():
        if isinstance(value, str | float | bool):  # rows tell these in one way
            continue
        with suppress(KeyError, ValueError, TypeError):  # no such parameter; an attribute of another type
            taken = declared[name].taken(name, value)
            found[name] = taken if plain(taken) == plain(value) else value
    return found


def _said(thing: Any, parameters: Collection[str], argument: Any = None) -> Mapping[Any, Any] | None:
    """Return the `options` by which an object tells what it is; None without, or where they are one of its parameters.

    As a parameter (given `argument`) beside others they would hide these.
    """
    own = getattr(thing, OPTIONS, None)
    if not isinstance(own, Mapping):
        return None
    others = {*parameters} - {OPTIONS}
    if OPTIONS not in parameters or not others or getattr(type(thing), "options_tell_all", False):
        return own
    tells_all = others <= {*own} and not (isinstance(argument, Mapping) and {*own} == {*argument})
    return own if tells_all else None


def options_as_asked(registry: Registry[Any], name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what `options_of` returns of the entry `name` made with `options`, without building it."""
    given = registry.check(name, options)
    defaults = {key: option.default for key, option in registry.options(name).items()}
    factory = registry.factory(name)
    return _of_made(factory, Made(registry.told_name(name), given, defaults | given, factory), {})


def made_as(thing: Any) -> Made | None:
    """Return the name and options with which the registry of problems or of optimisers made `thing`; None otherwise."""
    return problems.registry.made(thing) or optimizers.registry.made(thing)


def canonical(options: Any) -> str:
    """Return options, or any JSON, as text with sorted keys: equal options, equal text."""
    return json.dumps(options, sort_keys=True, separators=(",", ":"), default=list)


def chosen_options(registry: Registry[Any], name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that differ from what `name` declares, so that a new option with a default changes no id."""
    if name not in registry:  # a class by its path, or an object: all its options count
        return dict(options)
    declared = {key: option for key, option in registry.options(name).items() if not option.required}
    return {
        key: value
        for key, value in options.items()
        if key not in declared or canonical({"": value}) != canonical({"": declared[key].default})
    }


def given_options(registry: Registry[Any], name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a row as `make` takes them.

    None may mean an option that a registered name leaves out; the word for a default that is an object is left out.
    """
    if name in registry:
        declared = registry.options(name)
        return {k: v for k, v in options.items() if v is not None or (k in declared and declared[k].takes_none)}
    try:
        declared = registry.options(name)
    except ValueError:  # it is elsewhere
        return dict(options)
    given = {}
    for key, value in options.items():  # of somebody's own None is what was given
        is_word = False
        with suppress(NotPlain):
            option = declared.get(key)
            if option is not None and not option.required and isinstance(value, str):
                is_word = value == plain(option.default) != option.default
        if not is_word:
            given[key] = value
    return given


def key_of_problem(problem: Any, name: str) -> list[Any]:
    """Return what names a problem: its name, the options that differ from the declared ones, and its data."""
    return [name, chosen_options(problems.registry, name, options_of(problem)), extra_of(problem, "data_id", "")]


def key_of_optimizer(optimizer: Any, name: str) -> list[Any]:
    """Return what names an optimiser: its name and the options that differ from the declared ones."""
    return [name, chosen_options(optimizers.registry, name, options_of(optimizer))]


def run_id(problem_key: Any, optimizer_key: Any, budget: int, repetition: int, start: Any, target: Any) -> str:
    """Return the content id of a run: what it is, not when or where it was done."""
    if isinstance(start, np.ndarray):
        start = (start + 0.0).tolist()  # -0.0 is 0.0
    return digest(problem_key, optimizer_key, budget, repetition, start, target)


def _of_made(thing: Any, made: Made, said: Mapping[str, Any]) -> dict[str, Any]:
    quiet = getattr(thing, "said_if_chosen", ())
    given = {key: value for key, value in made.given.items() if value is not None or key not in {*said, *quiet}}
    rest = {key: value for key, value in made.arguments.items() if key not in {*said, *given, *quiet}}
    held = _as_plain(thing, {**said, **given})
    for key, value in rest.items():
        try:
            held[str(key)] = plain(value)
        except NotPlain:  # a default as the class declares it: it changes with the code alone, whose digest tells
            held[str(key)] = "default"
    return held


def _as_plain(thing: Any, options: Mapping[Any, Any]) -> dict[str, Any]:
    held = {}
    for key, value in options.items():
        try:
            held[str(key)] = plain(value)
        except NotPlain as error:
            raise ValueError(
                f"{name_of(thing)}: its option {key} cannot be written into results: {error}; give the object "
                "`options`, a mapping that says what tells it from others"
            ) from None
    return held


@lru_cache(maxsize=64)
def _declared(kind: type) -> Mapping[str, Option]:
    try:
        return declared_options(kind)
    except (TypeError, ValueError):  # no signature
        return {}


def _parameters(kind: type) -> list[str]:
    """Return the names of the parameters of a class: of one that hands ``*args, **options`` on, its base's too."""
    found: list[str] = []
    for at, base in enumerate(kind.__mro__):
        begin: Any = vars(base).get("__init__")
        if begin is None or getattr(begin, "__module__", "") == "typing":  # which a Protocol has
            continue
        if not inspect.isroutine(begin) or isinstance(begin, types.WrapperDescriptorType):  # of C, such as object's
            break
        declared = list(inspect.signature(begin).parameters.values())[1:]
        found += [p.name for p in declared if p.kind not in _ANY and p.name not in found]
        collecting = [p.name for p in declared if p.kind in _ANY]
        if not collecting:
            break
        if not any("__init__" in vars(one) for one in kind.__mro__[at + 1 : -1]):  # nobody takes them: it keeps them
            found += [name for name in collecting if name not in found]
    return found


_WHOLE = 256  # numbers of an array that are still written out
_DEPTH = 12  # of objects in objects; deeper is taken for a circle


class NotPlain(ValueError):
    """A value that cannot be told from others of its kind."""


def plain(value: Any, depth: int = 0) -> Any:
    """Return `value` as JSON; equal values give equal JSON. Raises `NotPlain` for indistinguishable values."""
    if isinstance(value, Enum):
        return f"{_path_of(type(value))}.{value.name}"
    if isinstance(value, np.ndarray) and (value.size > _WHOLE or value.dtype.kind not in "biuf"):
        return _array(value, depth)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if depth > _DEPTH:
        raise NotPlain("an object that contains itself")
    if isinstance(value, Mapping):
        named = {k if isinstance(k, str) else str(plain(k, depth + 1)): plain(v, depth + 1) for k, v in value.items()}
        if len(named) < len(value):
            raise NotPlain("two keys of a mapping that are written alike, such as 1 and '1'")
        return named
    if isinstance(value, list | tuple):
        return [plain(item, depth + 1) for item in value]
    if isinstance(value, set | frozenset):
        return sorted((plain(item, depth + 1) for item in value), key=canonical)
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, complex | range | slice):
        return repr(value)
    if isinstance(value, bytes | bytearray):
        return f"bytes {_digest(bytes(value).hex())}"
    # a function or class is its module and name, another object its class and attributes
    there: Any = modules.get(getattr(value, "__module__", None) or "")
    for part in str(getattr(value, "__qualname__", "")).split("."):
        there = getattr(there, part, None)
    if isinstance(value, type | types.BuiltinFunctionType | np.ufunc) or (there is value and callable(value)):
        return _path_of(value)
    if isinstance(value, types.FunctionType):
        return f"{_path_of(value)} {_digest(code_of(value, depth + 1))}"
    if isinstance(value, types.MethodType):
        return [plain(value.__self__, depth + 1), value.__func__.__qualname__]
    if callable(getattr(value, "func", None)) and isinstance(getattr(value, "keywords", None), Mapping):  # a partial
        return [plain(part, depth + 1) for part in (value.func, value.args, value.keywords)]
    options = getattr(value, "options", None)
    if isinstance(options, Mapping):
        return {"class": _path_of(type(value)), **plain(options, depth + 1)}
    if hasattr(value, "__array__"):
        columns = [str(name) for name in getattr(value, "columns", ())]
        return f"{_path_of(type(value))} {_digest([columns, _array(np.asarray(value), depth + 1)])}"
    held = _held(value)
    if held is None:
        raise NotPlain(f"a {type(value).__name__} has nothing to tell it from another")
    if is_dataclass(value) and {*held} == {f.name for f in fields(value) if f.init}:  # they are all that it is
        return {CLASS: _path_of(type(value)), **plain(held, depth + 1)}
    return f"{_path_of(type(value))} {_digest(plain(held, depth + 1))}" if held else _path_of(type(value))


def code_of(value: Any, depth: int = 0) -> Any:
    """Return the code of the function `value` as JSON: its bytecode, constants, defaults, and its closure."""
    closed = [cell.cell_contents for cell in value.__closure__ or ()]
    bound = [value.__defaults__ or (), value.__kwdefaults__ or {}, closed]
    return [_code(value.__code__, value.__doc__), plain(bound, depth + 1)]


def _held(value: Any) -> dict[str, Any] | None:
    """Return the attributes of an object; None where Python gives no access to its content."""
    slots = [
        name
        for kind in type(value).__mro__
        for name in ((kind.__dict__["__slots__"],) if isinstance(kind.__dict__.get("__slots__"), str)
                     else kind.__dict__.get("__slots__", ()))
        if name not in ("__dict__", "__weakref__")
    ]  # fmt: skip
    if not hasattr(value, "__dict__") and not slots:
        return None
    if isinstance(value, types.ModuleType):
        return {"module": value.__name__}
    return {**getattr(value, "__dict__", {}), **{name: getattr(value, name, None) for name in slots}}


def _array(array: np.ndarray[Any, Any], depth: int) -> str:
    if array.dtype.hasobject:
        content = _digest(plain(array.tolist(), depth + 1))
    else:
        content = blake2b(np.ascontiguousarray(array).tobytes(), digest_size=8).hexdigest()
    return f"array {array.dtype.str}{list(array.shape)} {content}"


def _code(code: types.CodeType, doc: str | None) -> list[Any]:
    constants = code.co_consts[1:] if doc is not None and code.co_consts[:1] == (doc,) else code.co_consts
    held: list[Any] = []
    for value in constants:
        if isinstance(value, types.CodeType):
            held.append(_code(value, None))
        elif isinstance(value, frozenset):  # in an order that Python draws anew for each process
            held.append(f"set {sorted(map(repr, value))}")
        else:
            held.append(repr(value))
    return [code.co_code.hex(), list(code.co_names), held]


def _path_of(value: Any) -> str:
    return f"{value.__module__}:{value.__qualname__}" if hasattr(value, "__qualname__") else f"numpy:{value.__name__}"


def _digest(value: Any) -> str:
    return blake2b(canonical(value).encode(), digest_size=8).hexdigest()
