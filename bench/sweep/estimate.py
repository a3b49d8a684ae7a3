"""How long the remaining runs take, from the finished runs of their cell, or from the cost of a call."""

from __future__ import annotations

from collections.abc import Set
from statistics import mean

from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import costs
from calibench.bench.sweep.execution import read_execution
from calibench.bench.sweep.request import Request

_OVERHEAD = 0.002  # seconds a run takes besides its evaluations


def seconds_left(request: Request, done: Set[str]) -> float | None:
    """Return the wall time in seconds of the runs of `request` that are not `done`; None where nothing tells.

    Of a cell without a finished run it is the budget times what a call of the problem takes, measured now where the
    study does not know it yet. An optimiser's own time is not in that, so it is a lower limit.
    """
    store = ResultStore(request.folder)
    known = store.manifest().get("costs", []) if store.folder.is_dir() else []
    took: dict[str, list[float]] = {}
    if done:
        rows = store.runs(["run_id", "wall_s"])
        for run_id, wall in zip(rows["run_id"], rows["wall_s"], strict=True):
            if run_id in request.labels:
                took.setdefault(request.labels[run_id], []).append(float(wall))
    usual = {label: mean(walls) + _OVERHEAD for label, walls in took.items()}
    left = {run_id: spec for run_id, spec in request.specs.items() if run_id not in done}
    unknown = [spec for run_id, spec in left.items() if request.labels[run_id] not in usual]
    calls = costs.seconds_a_call(unknown, known) if unknown else {}
    seconds = 0.0
    for run_id, spec in left.items():
        label = request.labels[run_id]
        if label in usual:
            seconds += usual[label]
            continue
        cost = calls.get(costs.problem_of(spec))
        if cost is None:
            return None
        seconds += spec.budget * cost + _OVERHEAD
    return seconds / read_execution(request.execution).workers
