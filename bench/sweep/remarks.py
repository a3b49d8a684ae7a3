"""What is told of a sweep before its runs: goals that no run can reach, and budgets that a first sample uses up."""

from __future__ import annotations

from collections.abc import Iterable
from math import isclose
from typing import Any

import numpy as np

from calibench.bench.execution.request.own_problem import minimum_of
from calibench.core.counted import listed

_ROUNDING = 1e-9  # part of a least value: a target closer below it is the same number
_NAMED = 8  # methods that a line still names

Asked = tuple[str, Any, str, Any, int, float | None]  # problem's label, problem, method's, method, budget, target


def remarks_of(cells: Iterable[Asked]) -> tuple[str, ...]:
    """Return a line for each target below the least value that a problem declares, and one for each budget in vain.

    A budget is in vain for a method that proposes nothing of its own within it, by its `Traits`.
    """
    below: dict[str, None] = {}
    vain: dict[int, dict[str, int]] = {}
    for problem_label, problem, method_label, method, budget, target in cells:
        least = minimum_of(problem)
        if (
            target is not None
            and least is not None
            and target < least
            and not isclose(target, least, rel_tol=_ROUNDING)
        ):
            below[f"target={target:g}: no run can reach it, {problem_label} says that its least value is {least:g}"] = (
                None
            )
        traits = getattr(method, "traits", None)
        if traits is not None:
            first = traits.minimum_budget + traits.minimum_budget_per_dimension * int(np.size(problem.lower))
            if 1 < first >= budget:
                vain.setdefault(budget, {})[method_label] = first
    return (*below, *(_in_vain(budget, first) for budget, first in sorted(vain.items())))


def _in_vain(budget: int, first: dict[str, int]) -> str:
    """Return the line on methods whose first sample uses up a budget: name -> evaluations of that sample."""
    named = listed([f"{name} ({size})" for name, size in first.items()], _NAMED)
    return (
        f"budget={budget}: it ends within the first sample of {named}, before "
        f"{'they propose' if len(first) > 1 else 'it proposes'} a point of {'their' if len(first) > 1 else 'its'} own"
    )
