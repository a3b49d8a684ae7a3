"""What the operators of our GA and PSO do, seen from outside: candidates as they pass a gate that only looks on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibench import bench, optimizers
from calibench.bench.papers.evidence import Array

_BITS, _DIMENSION = 10, 4


class _Recorder:
    """A function on a box whose points are the integers that strings stand for; it never improves."""

    def __init__(self) -> None:
        self.lower, self.upper = np.zeros(_DIMENSION), np.full(_DIMENSION, 2.0**_BITS - 1)
        self.start = self.lower.copy()
        self.seen: list[Array] = []

    def __call__(self, x: Array) -> float:
        return 1.0

    def batch(self, points: Array) -> Array:
        self.seen.append(np.array(points))
        return np.ones(len(points))


def measured_operators() -> tuple[float, float]:
    """Return (bits that a mutation flips, points at which a crossing changes parent), medians over one generation."""
    flipped = _generation(PMutation=1.0, PCrossover=0.0)
    crossed = _generation(PMutation=0.0, PCrossover=1.0)
    distance = [int((flipped[0] != child).sum(axis=1).min()) for child in flipped[1]]
    return float(np.median(distance)), float(np.median([_switches(crossed[0], child) for child in crossed[1]]))


def renewed_fraction(method: str) -> float:
    """Return the share of the population that begins again when nothing improves."""
    still = {"C1": 0.0, "C2": 0.0, "w_first": 0.0, "w_last": 0.0, "initial_velocity": "zero"} if method == "pso" else {}
    recorder = _Recorder()
    bench.execute(recorder, optimizers.make(method, population=100, NR=1, **still), budget=1000)
    rounds = recorder.seen[:-1]  # the budget may have cut the last
    if method == "ga":  # evaluates only who is new
        return min(len(points) for points in rounds) / len(rounds[0])
    pairs = pairwise(rounds)
    return max(float((after != before).any(axis=1).mean()) for before, after in pairs)


def _generation(**options: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the strings of the first population and of its children, shapes (N, bits) and (N - 1, bits)."""
    recorder = _Recorder()
    ga = optimizers.make("ga", population=60, precision=1.0, tournament=1, **options)
    bench.execute(recorder, ga, budget=60 + 59)
    return _strings(recorder.seen[0]), _strings(recorder.seen[1])


def _strings(points: Array) -> NDArray[np.int64]:
    whole = np.rint(points).astype(np.int64)
    bits = (whole[:, :, None] >> np.arange(_BITS - 1, -1, -1)) & 1
    return np.asarray(bits.reshape(len(points), -1))


def _switches(parents: NDArray[np.int64], child: NDArray[np.int64]) -> int:
    """Return at how many points, at least, the child changes from one parent to another; 0 for a copy."""
    at, count = 0, -1
    while at < len(child):
        same = parents[:, at:] == child[at:]
        run = int(np.where(same.all(axis=1), same.shape[1], same.argmin(axis=1)).max())
        if not run:
            return len(child)  # of no parent
        at, count = at + run, count + 1
    return count
