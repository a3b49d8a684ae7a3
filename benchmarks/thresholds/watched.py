"""Numbers that also know what they would be at other thresholds: every operator acts on all of them at once.

A search is given `Watched` thresholds. What it computes from one is `Watched` again; where it asks for a decision (a
comparison, a whole number, an array for a library) all values are held against the plain one. While every decision is
the same at another value, the search at that value is the same search, and nothing is to be done. At the first that is
another one, `Watch.split` says who goes on with the other value.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

Key = tuple[str, float]  # name of a threshold, and another value of it
_OVER: Key = ("", 0.0)  # followed when a search is over: what is left of it in caches is plain


class _Failed:
    """Stands for what could not be computed at another value; it equals nothing."""


@final
@dataclass(eq=False)
class Watch:
    """What one search would decide otherwise: `told` holds the keys for which some decision is another one.

    `split(key)` is called once for each of them; where it returns True, all numbers are those of that key from then on.
    """

    split: Callable[[Key], bool]
    told: set[Key] = field(default_factory=set)
    followed: Key | None = None

    def value(self, name: str, plain: float, others: tuple[float, ...]) -> Watched:
        """Return the threshold `name` as it stands, which knows its other values."""
        return Watched(self, plain, {(name, other): other for other in others})

    def end(self) -> None:
        """Tell of nothing more."""
        self.followed = _OVER

    def settle(self, plain: Any, others: Mapping[Key, Any]) -> Any:
        """Return the plain value, or that of the key which is followed; tell of every key whose value differs."""
        for key, other in others.items():
            if self.followed is None and key not in self.told and not _same(plain, other):
                self.told.add(key)
                if self.split(key):
                    self.followed = key
        return plain if self.followed is None else others.get(self.followed, plain)

    def apply(self, act: Callable[..., Any], *arguments: Any) -> Any:
        """Return what `act` makes of the arguments, at all values of those that are `Watched`."""
        if self.followed is None:
            plain = act(*_at(arguments, None))
            keys = {k: None for one in _watched(arguments) for k in one.others if k not in self.told}
            others = {key: _tried(act, _at(arguments, key)) for key in keys}
            others = {key: other for key, other in others.items() if not _same(plain, other)}
            if not others:
                return plain
            if not _decides(plain) and not any(isinstance(other, _Failed) for other in others.values()):
                return Watched(self, plain, others)
            self.settle(plain, others)
            if self.followed is None:
                return plain
        return act(*_at(arguments, self.followed))


@final
class Watched:
    """A number or an array; `others` has what it would be for each key for which it is something else."""

    __slots__ = ("others", "plain", "watch")

    def __init__(self, watch: Watch, plain: Any, others: Mapping[Key, Any]) -> None:
        self.watch, self.plain, self.others = watch, plain, others

    def settled(self) -> Any:
        """Return the one value that a library is given."""
        return self.watch.settle(self.plain, self.others)

    def _made(self, kind: Callable[[Any], Any]) -> Any:
        made = self.watch.apply(kind, self)
        return made.settled() if isinstance(made, Watched) else made

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        act = getattr(ufunc, method)
        if options or method == "at":  # what is written to is written once
            return act(*_settled(inputs), **{name: _settled(value) for name, value in options.items()})
        return self.watch.apply(act, *inputs)

    def __array_function__(self, function: Any, _: Any, arguments: Any, options: Mapping[str, Any]) -> Any:
        names = list(options)
        return self.watch.apply(
            lambda *all_: function(*all_[: len(arguments)], **dict(zip(names, all_[len(arguments) :], strict=True))),
            *arguments, *options.values(),
        )  # fmt: skip

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.settled(), dtype=dtype)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if not callable(getattr(self.plain, name)):
            return self.watch.apply(operator.attrgetter(name), self)
        return lambda *a, **options: self.watch.apply(lambda one, *b: getattr(one, name)(*b, **options), self, *a)

    def __getitem__(self, place: Any) -> Any:
        return self.watch.apply(operator.getitem, self, place)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.settled())

    def __len__(self) -> int:
        return len(self.settled())

    def __bool__(self) -> bool:
        return bool(self._made(bool))

    def __int__(self) -> int:
        return int(self._made(int))

    def __index__(self) -> int:
        return operator.index(self._made(operator.index))

    def __float__(self) -> float:
        return float(self.settled())

    def __hash__(self) -> int:
        return hash(self.settled())

    def __format__(self, how: str) -> str:
        return format(self.settled(), how)

    def __deepcopy__(self, memo: Any) -> Watched:
        return self


def _operators() -> Iterator[tuple[str, Callable[..., Any]]]:
    for name in ("lt", "le", "gt", "ge", "eq", "ne", "neg", "pos", "abs"):
        yield name, getattr(operator, name)
    yield "round", round
    for name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "matmul"):
        act = getattr(operator, name)
        yield name, act
        yield f"r{name}", lambda mine, other, act=act: act(other, mine)


def _method(act: Callable[..., Any]) -> Callable[..., Any]:
    def method(self: Watched, *others: Any) -> Any:
        return self.watch.apply(act, self, *others)

    return method


for _name, _act in _operators():
    setattr(Watched, f"__{_name}__", _method(_act))


def _watched(argument: Any) -> Iterator[Watched]:
    if isinstance(argument, Watched):
        yield argument
    elif isinstance(argument, list | tuple):
        for one in argument:
            yield from _watched(one)


def _at(argument: Any, key: Key | None) -> Any:
    if isinstance(argument, Watched):
        return argument.plain if key is None else argument.others.get(key, argument.plain)
    if type(argument) in (list, tuple):
        return type(argument)(_at(one, key) for one in argument)
    return argument


def _settled(argument: Any) -> Any:
    if isinstance(argument, Watched):
        return argument.settled()
    return type(argument)(map(_settled, argument)) if type(argument) in (list, tuple) else argument


def _tried(act: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    try:
        with np.errstate(all="ignore"):
            return act(*arguments)
    except Exception:  # the search at that value raises it, or is spared it
        return _Failed()


def _decides(value: Any) -> bool:
    return isinstance(value, bool | np.bool_) or (isinstance(value, np.ndarray) and value.dtype == bool)


def _same(one: Any, other: Any) -> bool:
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    return bool(one == other)
