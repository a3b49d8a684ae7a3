"""How a tool answers inside its own environment: a request in JSON a line comes in, a line of JSON goes out.

A tool's script ends in ``answer(LINES)``: ``LINES[table][line](work)`` does a line of a table once and returns what it
took. Without arguments the script goes on answering (the tool stays warm between rounds); with one it answers that
request and ends (all that a user's process takes is then measured from outside). This file knows no tool.
"""

from __future__ import annotations

import gc
import json
import os
import statistics
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

Line = Callable[[Mapping[str, Any]], Mapping[str, Any]]
ROOT = Path(__file__).resolve().parents[3]
CHUNK = 500  # calls between two looks at the clock
SECONDS, LEAST, MOST = 2.0, 21, 400  # how long chunks take turns, and how many there are at least and at most


def answer(lines: Mapping[str, Mapping[str, Line]]) -> None:
    """Answer the request of the command line, or all that come in until the input ends."""
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what a tool prints is no answer
    requests = sys.argv[1:] or iter(sys.stdin.readline, "")
    for request in requests:
        out.write(json.dumps(_answered(lines, json.loads(request))) + "\n")


def _answered(lines: Mapping[str, Mapping[str, Line]], request: Mapping[str, Any]) -> Mapping[str, Any]:
    if request.get("table") is None:
        return {"lines": {table: list(named) for table, named in lines.items()}}
    try:
        return lines[request["table"]][request["line"]](request.get("work", {}))
    except Exception as error:
        traceback.print_exc()
        return {"error": f"{type(error).__name__}: {error}"}


def full12() -> Any:
    """Return the objective that all tools are given, compiled: 12 parameters of a planar robot from 50 readings."""
    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    from calibench import problems

    problem = problems.make("full12", error="J3")
    problem.compile()
    return problem


def timed(work: Callable[[], int]) -> dict[str, Any]:
    """Return what one call of `work` took; it returns how many evaluations (runs, ...) it made."""
    wall, cpu = perf_counter(), process_time()
    count = work()
    return {"cpu_s": process_time() - cpu, "wall_s": perf_counter() - wall, "count": count}


def cost(
    bare: Callable[[Any], Any],
    counted: Callable[[Any], Any],
    points: Sequence[Any],
    each: int = 1,
    seconds: float = SECONDS,
) -> dict[str, Any]:
    """Return what `counted` takes more than `bare`: the difference of the lower deciles of many chunks in turns.

    What disturbs a chunk only ever adds to it, so that low ones are near the truth where medians are not. A point
    stands for `each` evaluations. The note tells what the bare call takes. A difference may come out below zero: the
    counter is then less than what can be measured.
    """
    taken: dict[str, list[tuple[float, float]]] = {"bare": [], "counted": []}
    began, collects = perf_counter(), gc.isenabled()
    gc.disable()  # it would fall on the one or the other
    try:
        while len(taken["counted"]) < LEAST or (perf_counter() - began < seconds and len(taken["counted"]) < MOST):
            for name, call in (("bare", bare), ("counted", counted)):
                wall, cpu = perf_counter(), process_time()
                for point in points:
                    call(point)
                taken[name].append((process_time() - cpu, perf_counter() - wall))
    finally:
        if collects:
            gc.enable()
    (bare_cpu, bare_wall), (cpu, wall) = (_low(taken[name]) for name in ("bare", "counted"))
    count = len(points) * each
    return {
        "cpu_s": cpu - bare_cpu,
        "wall_s": wall - bare_wall,
        "count": count,
        "note": f"the call alone {bare_cpu / count * 1e9:.3g} ns",
    }


def _low(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the lower deciles of the CPU and of the wall times."""
    cpu, wall = (statistics.quantiles(times, n=10, method="inclusive")[0] for times in zip(*pairs, strict=True))
    return cpu, wall


def points_in(problem: Any, count: int = CHUNK) -> list[Any]:
    """Return `count` points of the box, arrays of shape (dim,)."""
    import numpy as np

    unit = np.random.default_rng(0).random((count, len(problem.lower)))
    return list(problem.lower + unit * (problem.upper - problem.lower))
