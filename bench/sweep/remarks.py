"""What is told of a sweep, on a terminal as lines and in Python as warnings.

Before its runs: goals that no run can reach, and budgets that a first sample uses up. After them: values below a
declared minimum, what was not finite, or changed the process. What is found as a problem is first called,
`bench.sweep.carry_out` tells.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from math import isclose
from typing import Any

import numpy as np

from calibench.bench.execution.request import minimum_of
from calibench.bench.statistics.cells import PROBLEM, by_cell
from calibench.bench.statistics.summary import lowest_below
from calibench.bench.store.columns import Columns, floats, plain, true
from calibench.core.words import counted, listed

ONE_RUN = "1 run: a deterministic method gives one answer from one start, whatever the seed"
_REASONS = 3  # methods of one remark that are named
_ROUNDING = 1e-9  # part of a least value: a target closer below it is the same number
_NAMED = 8  # methods that a line still names

Asked = tuple[str, Any, str, Any, int, float | None]  # problem's label, problem, method's, method, budget, target


def remarks_of(cells: Iterable[Asked]) -> tuple[str, ...]:
    """Return a line for each target below the least value that a problem declares, and one for each budget in vain."""
    lines: dict[str, None] = {}
    vain: dict[int, dict[str, int]] = {}
    for problem_label, problem, method_label, method, budget, target in cells:
        least = minimum_of(problem)
        if (
            target is not None
            and least is not None
            and target < least
            and not isclose(target, least, rel_tol=_ROUNDING)
        ):
            line = f"target={target:g}: no run can reach it, {problem_label} says that its least value is {least:g}"
            lines[line] = None
        traits = getattr(method, "traits", None)
        if traits is not None:
            first = traits.minimum_budget + traits.minimum_budget_per_dimension * int(np.size(problem.lower))
            if 1 < first >= budget:
                vain.setdefault(budget, {})[method_label] = first
    for budget, sizes in sorted(vain.items()):
        named = listed([f"{name} ({size})" for name, size in sizes.items()], _NAMED)
        they, their = ("they propose", "their") if len(sizes) > 1 else ("it proposes", "its")
        line = f"budget={budget}: it ends within the first sample of {named}, before {they} a point of {their} own"
        lines[line] = None
    return tuple(lines)


def remarks_on_rows(rows: Columns) -> Iterator[str]:
    """Yield a line for what fell below a minimum, was not finite, what methods tried, and what changed the process."""
    evaluations = sum(int(count or 0) for count in plain(rows["evaluations"]))
    yield from _false_minima(rows)
    for column, what in (
        ("non_finite", f"of {evaluations} values were not finite (NaN or infinite)"),
        ("non_finite_slopes", "entries of gradients and Jacobians were not finite (NaN or infinite), and read as 0"),
    ):
        where = Counter[str]()
        named = zip(*(plain(rows[key]) for key in (column, "problem", "optimizer")), strict=True)
        for count, problem, optimizer in named:
            where[f"{optimizer} on {problem}"] += int(count or 0)
        if where.total():
            names = [f"{count} of {name}" for name, count in where.most_common(_REASONS) if count]
            more = f" and {len(+where) - len(names)} more" if len(+where) > len(names) else ""
            yield f"{where.total()} {what}: {', '.join(names)}{more}"

    both = zip(plain(rows["optimizer"]), plain(rows["tampering"]), strict=True)
    for (name, tampering), count in Counter((name, tried) for name, tried in both if tried).most_common(_REASONS):
        runs = counted(count, "run")
        yield f"{name} tried in {runs} what no method may: {tampering}; the counts are true all the same"

    changed = Counter[str]()
    named = zip(*(plain(rows[key]) for key in ("problem", "optimizer", "process_changes")), strict=True)
    for problem, optimizer, changes in named:
        if changes is not None and len(changes):
            changed[f"{', '.join(changes)} by {optimizer} on {problem}"] += 1
    if changed:
        names = [name for name, _ in changed.most_common(_REASONS)]
        more = f"; and {len(changed) - len(names)} more (column process_changes)" if len(changed) > len(names) else ""
        runs = counted(changed.total(), "run")
        yield f"{runs} changed the state of the process, which was put back: {'; '.join(names)}{more}"


def _false_minima(rows: Columns) -> Iterator[str]:
    if "minimum" not in rows:
        return
    cells = by_cell(rows, PROBLEM)
    declared = floats(rows["minimum"])[cells.last]
    inside = np.where(true(rows["inside_box"]), floats(rows["best_value"]), np.nan)
    for cell in np.flatnonzero(cells.over(np.fmin, inside) < declared).tolist():
        minimum = float(declared[cell])
        below = lowest_below(rows, minimum, cells.rows(cell))
        if below is not None:
            problem = rows["problem"][int(cells.first[cell])]
            yield f"{problem}: a run found {below:.10g}, below the minimum={minimum:.10g} that it declares"


def points_outside(rows: Columns) -> str:
    """Return how many points lay outside the box, and of which methods; "" where none: those without bounds do that."""
    outside = Counter[str]()
    for name, count in zip(plain(rows["optimizer"]), plain(rows["outside_evaluations"]), strict=True):
        outside[name] += int(count or 0)
    names = [f"{count} of {name}" for name, count in outside.most_common(_REASONS) if count]
    more = f" and those of {len(+outside) - len(names)} more" if len(+outside) > len(names) else ""
    return f"{outside.total()} points lay outside the box or were not finite: {', '.join(names)}{more}" if names else ""
