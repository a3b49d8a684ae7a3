"""When a run reached a level: from the points of its trace, the declared hits of its row, and its answer.

A trace is thinned (`bench.gate.evaluator`): it holds every improvement among the first 64 evaluations, later ones that
gain more than a tenth on the point before, and 16 marks a decade. A crossing is therefore known exactly where the level
lies more than that tenth below the point before, as nothing unrecorded comes so far; else it lies between two points.
`evaluations` and `charged` of a `Crossings` are the earliest counts at which the level was surely reached, and
`evaluations_after` and `charged_after` the latest at which it surely was not: exact where they differ by one. Nothing
between is interpolated. A level that the problem declares is exact, as the gate watched it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
NEVER = -1
_ALL_UNTIL, _GAIN = 64, 0.1  # as the gate records: every improvement until, later ones that gain this share


@final
@dataclass(frozen=True)
class Points:
    """The traces of some runs, one after the other: each array of shape (points,), `counts` of shape (runs,)."""

    evaluations: Counts
    charged: Counts
    values: Array
    counts: Counts

    @property
    def first(self) -> Counts:
        """Return where each run's points begin, shape (runs,)."""
        return np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(np.int64)


@final
@dataclass(frozen=True)
class Crossings:
    """Counts of shape (runs, levels), `NEVER` where a level was not reached."""

    evaluations: Counts
    charged: Counts
    evaluations_after: Counts
    charged_after: Counts

    @classmethod
    def none(cls, runs: int, levels: int) -> Crossings:
        """Return crossings of which none happened."""
        return cls(*(np.full((runs, levels), NEVER, dtype=np.int64) for _ in range(4)))


def crossings(points: Points, levels: Array, thinned_as_ours: NDArray[np.bool_]) -> Crossings:
    """Return when each run first had a value at or below each of `levels`, shape (levels,), by its trace alone.

    `thinned_as_ours`, shape (runs,), tells whose trace was thinned by the rule above; of another nothing between two
    points is known.
    """
    found = Crossings.none(len(points.counts), len(levels))
    if not len(points.values) or not len(levels):
        return found
    order = np.argsort(-levels, kind="stable")  # the easiest first
    values = np.where(np.isnan(points.values), np.inf, points.values)
    reached = len(levels) - np.searchsorted(np.sort(levels), values, side="left")  # how many levels are at or above
    run = np.repeat(np.arange(len(points.counts)), points.counts)
    begins = np.zeros(len(run), dtype=bool)
    begins[points.first[points.counts > 0]] = True
    before = np.where(begins, 0, np.concatenate([[0], reached[:-1]]))
    new = np.maximum(reached - before, 0)
    at = np.repeat(np.arange(len(run)), new)  # the point of each crossing
    within = np.arange(len(at)) - np.repeat(np.cumsum(new) - new, new)
    level = order[before[at] + within]
    row, last = run[at], np.where(begins[at], at, at - 1)
    value_before = np.where(begins[at], np.inf, values[last])
    with np.errstate(invalid="ignore"):
        surely = levels[level] < value_before - _GAIN * np.abs(value_before)
    exact = ((points.evaluations[at] <= _ALL_UNTIL) | surely | ~np.isfinite(value_before)) & thinned_as_ours[row]
    for kind in ("evaluations", "charged"):
        count: Counts = getattr(points, kind)
        getattr(found, kind)[row, level] = count[at]
        between = np.where(begins[at], 0, count[last])
        getattr(found, f"{kind}_after")[row, level] = np.where(exact, count[at] - 1, between)
    return found


def tightened(found: Crossings, levels: Array, declared: Array, hits: Counts, hits_charged: Counts) -> Crossings:
    """Return crossings of `levels`, shape (levels,), by what the gate watched: the exact hits of `declared` levels.

    `declared` of shape (declared,), largest first; hits of shape (runs, declared), `NEVER` where there was none.
    """
    if not len(declared):
        return found
    columns = {name: getattr(found, name).copy() for name in Crossings.__annotations__}
    easier, harder = declared >= levels[:, None], declared <= levels[:, None]  # (levels, declared)
    nearest = {  # the declared level next to each, and whether there is one
        "harder": (np.argmax(harder, axis=1), harder.any(axis=1)),
        "easier": (len(declared) - 1 - np.argmax(easier[:, ::-1], axis=1), easier.any(axis=1)),
    }
    for kind, known in (("evaluations", hits), ("charged", hits_charged)):
        time, after = columns[kind], columns[f"{kind}_after"]
        of_harder, of_easier = (np.where(there, known[:, at], NEVER) for at, there in nearest.values())
        sooner = (of_harder != NEVER) & ((time == NEVER) | (of_harder < time))
        time[sooner] = of_harder[sooner]
        after[sooner] = np.minimum(np.where(after[sooner] == NEVER, 0, after[sooner]), of_harder[sooner] - 1)
        later = (of_easier != NEVER) & (time != NEVER) & (of_easier - 1 > after)
        after[later] = np.minimum(of_easier[later], time[later]) - 1
    return Crossings(**columns)


def by_the_answer(points: Points, best_evaluation: Counts, reached: NDArray[np.bool_]) -> Crossings:
    """Return crossings of what only the answer tells, such as its parameter error: where it was `reached`,
    shape (runs, levels), at the evaluation that proposed the answer; what earlier points were is not known.

    Charged are the evaluations until then and the Jacobians until the next point of the trace: at most so many.
    """
    charged = best_evaluation.copy()
    run = np.repeat(np.arange(len(points.counts)), points.counts)
    behind = np.flatnonzero(points.evaluations >= best_evaluation[run])
    rows, first = np.unique(run[behind], return_index=True)
    at = behind[first]
    charged[rows] += points.charged[at] - points.evaluations[at]

    def where(counts: Any) -> Counts:
        return np.where(reached, counts, NEVER).astype(np.int64)

    none = np.zeros((len(charged), 1), dtype=np.int64)
    return Crossings(where(best_evaluation[:, None]), where(charged[:, None]), where(none), where(none))


def joined(parts: Sequence[Crossings]) -> Crossings:
    """Return crossings of the levels of all parts, side by side."""
    return Crossings(
        **{name: np.concatenate([getattr(part, name) for part in parts], axis=1) for name in Crossings.__annotations__}
    )
