"""What a search answers at other thresholds, without searching again what is the same at them.

`answers` searches once, with `Watched` thresholds. Where a decision first comes out otherwise at another value, the
process forks: the child goes on at that value from there, and gives its answer to the parent. At values at which no
decision differs the answer is the plain one. Without `fork` the search starts anew for each value that differs.
"""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, final

from benchmarks.thresholds.watched import Key, Watch

T = TypeVar("T")
FORKS = hasattr(os, "fork")


@final
@dataclass(frozen=True)
class Answers(Generic[T]):
    """The answer at the plain values, and at each other value at which some decision was another one."""

    plain: T
    others: dict[Key, T]

    def at(self, name: str, value: float) -> T:
        """Return the answer with `value` for the threshold `name`."""
        return self.others.get((name, value), self.plain)


@final
@dataclass
class _Branches:
    """The children of a search: `others` has their answers. In a child, `parent` is where its own answer goes."""

    others: dict[Key, Any] = field(default_factory=dict)
    parent: int | None = None

    def split(self, key: Key) -> bool:
        """Fork: return True in the child; in the parent, wait for the child's answer and return False."""
        answer, told = os.pipe()
        with warnings.catch_warnings():  # threads of BLAS that wait are told as threads: they hold no lock of ours
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if not child:
            os.close(answer)
            self.parent = told
            return True
        os.close(told)
        with os.fdopen(answer, "rb") as pipe:
            written = pipe.read()
        os.waitpid(child, 0)
        found = pickle.loads(written) if written else RuntimeError(f"the search at {key} ended without an answer")
        if isinstance(found, Exception):
            raise found
        self.others[key] = found
        return False


def decisions(
    search: Callable[[Mapping[str, Any]], T], plain: Mapping[str, float], others: Mapping[str, tuple[float, ...]]
) -> tuple[T, tuple[Key, ...]]:
    """Return what `search` answers with the values `plain`, and the keys at which some decision is another one."""
    watch = Watch(lambda _: False)
    found = search({name: watch.value(name, plain[name], values) for name, values in others.items()})
    watch.end()
    return found, tuple(sorted(watch.told))


def answers(
    search: Callable[[Mapping[str, Any]], T], plain: Mapping[str, float], others: Mapping[str, tuple[float, ...]], *,
    forks: bool = FORKS,
) -> Answers[T]:  # fmt: skip
    """Return what `search` answers with the values `plain`, and with each of the `others` in its place.

    `search` is given what differs from the defaults, name -> value. Raises what the search raises at any value.
    """
    branches = _Branches()
    watch = Watch(branches.split if forks else lambda _: False)
    found: Any
    try:
        found = search({name: watch.value(name, plain[name], values) for name, values in others.items()})
    except Exception as error:
        if branches.parent is None:
            raise
        found = error
    except BaseException:  # an interrupt in a child ends it; the parent tells that it has no answer
        if branches.parent is None:
            raise
        os._exit(1)
    if branches.parent is not None:
        with os.fdopen(branches.parent, "wb") as pipe:
            pickle.dump(found, pipe)
        os._exit(0)
    watch.end()
    if not forks:
        branches.others = {(name, value): search({name: value}) for name, value in sorted(watch.told)}
    return Answers(found, branches.others)
