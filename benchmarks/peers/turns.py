"""Lines of a table take turns, round after round: what the machine does meanwhile hits all of them alike.

Ratios are of CPU time and taken within a round, to the first line. A line that fails stays, with its error; one that
has used up its patience is not asked again, and its number of rounds tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.peers.asking import Taken, ToolError

COLUMNS = (
    "benchmark", "line", "version", "rounds", "count", "cpu_ns", "cpu_q1", "cpu_q3", "wall_ns",
    "ratio", "ratio_q1", "ratio_q3", "note", "error",
)  # fmt: skip


@dataclass(frozen=True)
class Contestant:
    """A line of a table: who does it, and how it is done once; `error` where it cannot be."""

    version: str
    take: Callable[[], Taken] | None = None
    error: str = ""


def take_turns(
    benchmark: str,
    contestants: Mapping[str, Contestant],
    rounds: int,
    patience_s: float = 60.0,
    warm: bool = True,
    tell: Callable[[str], None] = lambda line: None,
) -> pd.DataFrame:
    """Return a row for each line with the `COLUMNS`; times are of one of what it counts.

    A time can be a difference that came out as nothing or less: it has no ratio, and none is taken to it.

    With `warm` a first round is not counted: it compiles and loads.
    """
    order = list(contestants)
    errors = {name: one.error for name, one in contestants.items()}
    taken: dict[str, list[Taken | None]] = {name: [] for name in order}
    spent = dict.fromkeys(order, 0.0)
    for r in range(-1 if warm else 0, rounds):
        for i in np.roll(np.arange(len(order)), r):  # nobody is always the one after the slowest
            name = order[i]
            take = contestants[name].take
            done = None
            if take is not None and not errors[name] and (spent[name] < patience_s or not any(taken[name])):
                try:
                    done = take()
                    spent[name] += done.wall_s
                except (ToolError, KeyError) as error:
                    errors[name] = str(error)
            if r >= 0:
                taken[name].append(done)
        tell(f"{benchmark}: round {r + 1} of {rounds}")
    first = taken[order[0]] if order else []
    rows = [_row(benchmark, n, contestants[n].version, taken[n], first, errors[n]) for n in order]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _row(
    benchmark: str, name: str, version: str, taken: list[Taken | None], first: list[Taken | None], error: str
) -> tuple[Any, ...]:
    there = [one for one in taken if one is not None]
    if error or not there:
        return (benchmark, name, version, 0, 0, *[np.nan] * 7, "", error or "never asked")
    cpu = [one.cpu_s / one.count * 1e9 for one in there]
    wall = float(np.median([one.wall_s / one.count for one in there])) * 1e9
    pairs = [(one, other) for one, other in zip(taken, first, strict=True) if one is not None and other is not None]
    ratios = [one.cpu_s / one.count / (other.cpu_s / other.count) for one, other in pairs if other.cpu_s > 0]
    if np.median(cpu) <= 0 or not ratios:  # a difference of two times can be too small to be seen
        ratios = [np.nan]
    low, middle, high = (float(q) for q in np.quantile(cpu, [0.25, 0.5, 0.75]))
    ratio_low, ratio, ratio_high = (float(q) for q in np.quantile(ratios, [0.25, 0.5, 0.75]))
    told = (middle, low, high, wall, ratio, ratio_low, ratio_high)
    return (benchmark, name, version, len(there), there[-1].count, *told, there[-1].note, "")
