"""A problem and an optimiser that fit each other, with all that is the same in all their runs: found once.

Two thirds of the time of a short run went into finding it again. The pairs of our own classes are kept in a process; a
user's object is made anew for every run, as it may remember what it was asked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from calibench import optimizers, problems
from calibench.bench.execution.request.checks import check_pair
from calibench.bench.execution.request.own_problem import group_of, minimum_of, unit_of
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.provenance.code_digest import Library, code_digest, library_of
from calibench.bench.provenance.run_id import (
    canonical,
    digest,
    key_of_optimizer,
    key_of_problem,
    name_of,
    options_of,
)
from calibench.core.registry import Registry
from calibench.core.sources import is_foreign, is_foreign_module
from calibench.problems.base import Array, Parameter, coordinates_of, extra_of, parameters_of

_MADE: dict[str, Pair] = {}
_MOST = 64  # pairs that a process remembers; a pack is of few


@final
@dataclass(eq=False)
class Pair:
    """Problem and optimiser, their names, options as JSON and keys (what tells them in ids and seeds).

    `problem_word` and `optimizer_word` are digests of the keys as numbers, for seeds; `compiled` says that what is done
    before the first run of the pair has been done.
    """

    problem: Any
    problem_name: str
    problem_options: str
    problem_key: list[Any]
    problem_word: int
    optimizer: Any
    optimizer_name: str
    optimizer_options: str
    optimizer_key: list[Any]
    optimizer_word: int
    targets: tuple[float, ...]
    data_id: str
    unit: str
    problem_group: str
    minimum: float | None
    library: Library
    code: str
    foreign_problem: bool
    foreign_optimizer: bool
    compiled: bool = False

    @property
    def may_hang(self) -> bool:
        """Tell whether the optimiser may loop for ever in foreign code."""
        return bool(getattr(getattr(self.optimizer, "traits", None), "may_hang", False))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the physical parameters."""
        return parameters_of(self.problem)

    @cached_property
    def box(self) -> tuple[Array, Array, Array, Array]:
        """Return the lower and upper bounds of x, and from where on it is at them: four arrays of shape (dim,)."""
        lower, upper = np.array(self.problem.lower, float), np.array(self.problem.upper, float)
        near = 1e-9 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
        return lower, upper, lower + near, upper - near

    @cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        """Return the names of what x holds."""
        return tuple(coordinate.name for coordinate in coordinates_of(self.problem))


def pair_of(problem: Any, optimizer: Any, problem_name: str | None = None, optimizer_name: str | None = None) -> Pair:
    """Return the pair. Raises `ValueError` where it cannot be run."""
    check_pair(problem, optimizer)
    who = name_of(problem) if problem_name is None else problem_name
    method = name_of(optimizer) if optimizer_name is None else optimizer_name
    problem_key, optimizer_key = key_of_problem(problem, who), key_of_optimizer(optimizer, method)
    return Pair(
        problem, who, canonical(options_of(problem)), problem_key, int(digest(problem_key), 16),
        optimizer, method, canonical(options_of(optimizer)), optimizer_key, int(digest(optimizer_key), 16),
        tuple(extra_of(problem, "targets", ())), extra_of(problem, "data_id", ""), unit_of(problem),
        group_of(problem), minimum_of(problem), library_of(optimizer), code_digest(problem, optimizer),
        is_foreign(problem), is_foreign(optimizer),
    )  # fmt: skip


def foreign_modules(registry: Registry[Any], name: str) -> list[str]:
    """Return the module, loaded, that builds the entry `name`, where it is not ours."""
    factory = registry.factory(name)
    module = getattr(factory, "func", factory).__module__
    return [module] if is_foreign_module(module) else []


def built_by_foreign(problem: str, optimizer: str) -> list[str]:
    """Return the modules that build these two, of those that are not ours."""
    return foreign_modules(problems.registry, problem) + foreign_modules(optimizers.registry, optimizer)


def made_pair(
    problem: str, problem_options: Mapping[str, Any], optimizer: str, optimizer_options: Mapping[str, Any]
) -> Pair:
    """Return the pair of these names and options; where all its code is ours, the one that was made before."""
    key = repr((problem, sorted(problem_options.items()), optimizer, sorted(optimizer_options.items())))
    if key in _MADE:
        return _MADE[key]
    pair = pair_of(problems.make(problem, **problem_options), optimizers.make(optimizer, **optimizer_options))
    if not (
        pair.foreign_problem
        or pair.foreign_optimizer
        or is_stochastic(pair.problem)
        or built_by_foreign(problem, optimizer)
    ):
        if len(_MADE) >= _MOST:
            _MADE.clear()
        _MADE[key] = pair
    return pair
