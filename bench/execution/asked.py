"""A run as it is asked for: checked, with all that its id and its seeds follow from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from calibench.bench.execution.request import Array, Start, check_request, starting_point
from calibench.bench.provenance.run_id import key_of_optimizer, key_of_problem, name_of, options_of, run_id


@final
@dataclass(frozen=True, eq=False)
class Asked:
    """Problem and optimiser with their names, options and keys (what tells them in ids and seeds), and the request.

    `start` is what the start is called, `first` the point, shape (dim,); `targets` are the problem's and the run's own.
    """

    problem: Any
    problem_name: str
    problem_options: dict[str, Any]
    problem_key: list[Any]
    optimizer: Any
    optimizer_name: str
    optimizer_options: dict[str, Any]
    optimizer_key: list[Any]
    budget: int
    repetition: int
    start: str
    first: Array
    target: float | None
    targets: list[float]

    @property
    def run_id(self) -> str:
        """Return the content id of the run."""
        start = self.first if self.start == "given" else self.start
        return run_id(self.problem_key, self.optimizer_key, self.budget, self.repetition, start, self.target)


def read_asked(
    problem: Any,
    optimizer: Any,
    budget: int,
    repetition: int,
    *,
    start: Start | Array | None,
    target: float | None,
    problem_name: str | None,
    optimizer_name: str | None,
    time_limit: float | None,
) -> Asked:
    """Return the request as it is run. Raises `ValueError` where it makes no sense."""
    check_request(problem, optimizer, budget, repetition, target, time_limit)
    budget, repetition, target = int(budget), int(repetition), None if target is None else float(target)
    who = name_of(problem) if problem_name is None else problem_name
    method = name_of(optimizer) if optimizer_name is None else optimizer_name
    problem_options, optimizer_options = options_of(problem), options_of(optimizer)
    problem_key, optimizer_key = key_of_problem(problem, who), key_of_optimizer(optimizer, method)
    label, first = starting_point(problem, start, problem_key, repetition)
    targets = [*getattr(problem, "targets", ())]
    if target is not None and target not in targets:
        targets.append(target)
    return Asked(
        problem, who, problem_options, problem_key, optimizer, method, optimizer_options, optimizer_key, budget,
        repetition, label, first, target, targets,
    )  # fmt: skip
