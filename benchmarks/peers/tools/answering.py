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
from itertools import count
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

Line = Callable[[Mapping[str, Any]], Mapping[str, Any]]
ROOT = Path(__file__).resolve().parents[3]
CHUNK = 500  # calls between two looks at the clock
SECONDS, LEAST, MOST = 2.0, 21, 400  # how long chunks take turns, and how many there are at least and at most
MACHINES = (1, 2, 4, 5, 7)  # the first instances of the planar robot whose readings have noise
_SEEDS = count()


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


class Missed(Exception):
    """No search has reached the level."""


class Ended(Exception):
    """The level is reached, or there may be no further evaluation."""


class Level:
    """The objective of an instance; `Ended` once a value is as low as the noise of its readings allows, or after `most`
    evaluations."""

    def __init__(self, instance: int, most: int) -> None:
        full12()
        from calibench import problems

        self.problem = problems.make("full12", error="J2", instance=instance)
        self.problem.compile()
        self.lower, self.upper, self.start = self.problem.lower, self.problem.upper, self.problem.start
        self.level, self.most, self.count, self.reached = self.problem.as_good_as_noise, most, 0, False

    def __call__(self, x: Any) -> float:
        value = float(self.problem(x))
        self.seen(value, 1)
        return value

    def batch(self, points: Any) -> Any:
        values = self.problem.batch(points)
        self.seen(values.min(), len(values))
        return values

    def seen(self, lowest: float, evaluations: int) -> None:
        """Count evaluations of which this is the lowest value."""
        self.count += evaluations
        self.reached = self.reached or bool(lowest <= self.level)
        if self.reached or self.count >= self.most:
            raise Ended


def reaching(search: Callable[[Level, Any, int], object], most: int = 100_000) -> dict[str, Any]:
    """Return what ``search(level, start, seed)`` takes until the level is reached, on each of `MACHINES`.

    It begins at the nominal parameters; where it ends by itself it begins again at random, until it has had `most`
    evaluations. All time counts, that of machines where the level was not reached too; it is told for one where it was.
    """
    import numpy as np

    levels = [Level(instance, most) for instance in MACHINES]

    def searched() -> int:
        for level in levels:
            start = level.start.copy()
            try:
                while True:
                    seed = next(_SEEDS)
                    search(level, start, seed)
                    start = level.lower + np.random.default_rng(seed).random(len(start)) * (level.upper - level.lower)
            except Ended:
                pass
        return sum(level.reached for level in levels)

    taken = timed(searched)
    if not taken["count"]:
        raise Missed(f"on none of {len(levels)} machines within {most:,} evaluations".replace(",", " "))
    median = statistics.median(level.count for level in levels if level.reached)
    return {**taken, "note": f"{taken['count']} of {len(levels)} machines, {median:.0f} evaluations in the median"}


def timed(work: Callable[[], int]) -> dict[str, Any]:
    """Return what one call of `work` took, its processes too; it returns how many evaluations (runs, ...) it made."""
    wall, cpu, before = perf_counter(), process_time(), os.times()
    made = work()
    cpu, after = process_time() - cpu, os.times()
    cpu += after.children_user + after.children_system - before.children_user - before.children_system
    return {"cpu_s": cpu, "wall_s": perf_counter() - wall, "count": made}


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
