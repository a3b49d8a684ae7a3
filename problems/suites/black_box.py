"""`BlackBox`: a function of a foreign library as a problem, whose calls the library counts too.

What such a library builds lives in C: it belongs to one process and takes one call at a time. So it is built where it
is first called, once more in a process that was forked from there, and a pickle holds the options alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from threading import Lock
from typing import Any, ClassVar, Literal, Protocol, final

import numpy as np

from calibench.problems.base import Array, line_of, registry, table_of
from calibench.problems.candidates import vector, vectors


class Counted(Protocol):
    """What a library built: a call, x of shape (dim,) -> the value to be minimised, and its own count of calls."""

    def __call__(self, x: Array, /) -> float: ...
    @property
    def evaluations(self) -> int: ...


@final
@dataclass(frozen=True, eq=False)
class BlackBox:
    """Minimise a function of which only values can be had. `build` makes it; all else was read once from the library.

    `library` is the package that is called. `minimum` and `truth`, shape (dim,), are None where it does not know them.
    `targets` are levels of f whose first crossing is recorded; `group` is the suite's. `data_id` is how the suite calls
    this very function.
    """

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    name: str
    library: str
    options: Mapping[str, Any]
    build: Callable[[], Counted] = field(repr=False)
    lower: Array
    upper: Array
    start: Array
    default_start: Literal["nominal", "random"]
    truth: Array | None
    minimum: float | None
    targets: tuple[float, ...]
    group: str
    data_id: str
    _built: dict[int, tuple[Counted, Lock]] = field(default_factory=dict, init=False, repr=False)

    side_effect_free: ClassVar[bool] = True
    splits_batches: ClassVar[bool] = True

    __repr__ = line_of
    _repr_html_ = table_of

    def __call__(self, x: Array) -> float:
        """Return the value of the candidate x, shape (dim,): one call of the library."""
        point = vector(self.name, x, len(self.lower))
        function, lock = self._here()
        with lock:
            return float(function(point))

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of candidates of shape (k, dim): a call each."""
        return np.array([self(x) for x in vectors(self.name, points, len(self.lower))], dtype=float)

    @property
    def evaluations(self) -> int:
        """Return the library's own count of calls in this process."""
        return int(self._here()[0].evaluations)

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 1_000 * len(self.lower), "paper": 10_000 * len(self.lower)}

    def compile(self) -> None:
        """Build the function, so that no clock sees it."""
        self._here()

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (self.name, dict(self.options))

    def _here(self) -> tuple[Counted, Lock]:
        """Return the function of this process and its lock."""
        me = os.getpid()
        if me not in self._built:
            self._built[me] = self.build(), Lock()
        return self._built[me]


def package(module: str, distribution: str, problem: str) -> Any:
    """Return the imported `module`; raise `ValueError` that says what to install where it is not there."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ValueError(
            f"problem {problem} needs the package {distribution}, which cannot be imported here ({error}); "
            f"pip install 'calibench[{problem}]' brings it"
        ) from None


def _made_again(name: str, options: dict[str, Any]) -> Any:
    return registry.make(name, **options)
