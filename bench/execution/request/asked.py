"""A checked request of a run, with all that determines its id and its seeds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import final

from calibench.bench.execution.request.checks import (
    Array,
    Start,
    check_numbers,
    check_target,
    repetitions_of,
    starting_point,
)
from calibench.bench.execution.request.pair import Pair
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.provenance.run_id import run_id


@final
@dataclass(frozen=True, eq=False)
class Asked:
    """Problem and optimiser, and the request.

    `start` is the name of the start, `first` the point, shape (dim,); `targets` are the problem's and the run's own.
    """

    pair: Pair
    budget: int
    repetition: int
    start: str
    first: Array
    target: float | None
    targets: list[float]

    @cached_property
    def run_id(self) -> str:
        """Return the content id of the run."""
        start = self.first if self.start == "given" else self.start
        pair = self.pair
        return run_id(pair.problem_key, pair.optimizer_key, self.budget, self.repetition, start, self.target)

    @property
    def can_differ(self) -> bool:
        """Tell whether another repetition can differ from this one."""
        start: Start = "random" if self.start == "random" else "nominal"
        noisy = is_stochastic(self.pair.problem)
        return len(repetitions_of(self.pair.optimizer, start, range(2), noisy)) > 1


def read_asked(
    pair: Pair,
    budget: int,
    repetition: int,
    *,
    start: Start | Array | None = None,
    target: float | None = None,
    time_limit: float | None = None,
) -> Asked:
    """Return the request of a run. Raises `ValueError` for a request without meaning."""
    check_numbers(budget, repetition, target, time_limit)
    check_target(pair.problem, target)
    budget, repetition, target = int(budget), int(repetition), None if target is None else float(target)
    label, first = starting_point(pair.problem, start, pair.problem_word, repetition)
    targets = [*pair.targets]
    if target is not None and target not in targets:
        targets.append(target)
    return Asked(pair, budget, repetition, label, first, target, targets)
