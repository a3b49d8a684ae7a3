"""How far a sweep is: planned, done, what failed and why, what is left, how fast it goes."""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from calibench.bench.execution.in_progress import hosts_at_work
from calibench.bench.store.manifest import in_other_shards
from calibench.bench.store.runs import ResultStore

_LONG = 100  # letters of a reason
_NUMBER = re.compile(r"[-+]?\b\d[\d.]*(?:[eE][-+]?\d+)?")


@final
@dataclass(frozen=True)
class Reason:
    """Why runs did not end well: how many of them say so, and one of them."""

    status: str
    text: str
    count: int
    run_id: str


@final
@dataclass(frozen=True, kw_only=True)
class SweepProgress:
    """Counts of runs: `left` by what a cell is called, `mixed` cells hold two codes, `pace` is in runs a second.

    `in_other_shards` are neither planned nor done here; `hosts` are at work; `command` is the last that added runs.
    """

    planned: int
    done: int
    failed: int
    timeouts: int
    left: dict[str, int]
    reasons: tuple[Reason, ...]
    pace: float
    mixed: int
    damaged: tuple[Path, ...]
    in_other_shards: int = 0
    hosts: frozenset[str] = frozenset()
    command: str = ""

    @property
    def to_do(self) -> int:
        """Return how many planned runs are left."""
        return sum(self.left.values())

    @property
    def eta_s(self) -> float | None:
        """Return the seconds that the rest takes at this pace; None where there is no pace."""
        return self.to_do / self.pace if self.pace > 0 and self.to_do else None


def sweep_progress(store: ResultStore) -> SweepProgress:
    """Return how far the sweep of a store is; nothing in its folder is changed."""
    manifest = store.manifest()
    planned: dict[str, str] = manifest["planned"]
    survey = store.survey()
    states = survey.states
    left = Counter(label for run_id, label in planned.items() if run_id not in states)
    codes: dict[str, set[str]] = {}
    for run_id, state in states.items():
        codes.setdefault(planned.get(run_id, ""), set()).add(state.code_digest)
    ended = Counter(state.status for state in states.values())
    names = manifest.get("called") or {}
    count = Counter(names.get(label, label) for label in set(planned.values()))

    rows: list[dict[Any, Any]] = []
    if len(states) > ended["ok"]:
        columns = ["run_id", "status", "problem", "optimizer", "repetition", "error_type", "error"]
        rows = store.rows_not_ok(columns).to_dict("records")
    groups: dict[tuple[str, str], list[tuple[str, str]]] = {}  # (run_id, text) by status and what texts have in common
    for row in rows:
        text = " ".join(f"{row['error_type'] or ''}: {row['error'] or 'no reason is known'}".split()).removeprefix(": ")
        text = text if len(text) <= _LONG else f"{text[: _LONG - 1]}…"
        groups.setdefault((str(row["status"]), without_numbers(text)), []).append((str(row["run_id"]), text))
    frequent = sorted(groups.items(), key=lambda item: (-len(item[1]), item[0]))
    firsts = [(status, min(runs), len(runs)) for (status, _), runs in frequent]
    return SweepProgress(
        planned=len(planned),
        done=len(states),
        failed=ended["failed"],
        timeouts=ended["timeout"],
        # by its label where another sweep of the study took the same name
        left={n if count[n] == 1 else label: k for label, k in left.items() for n in [names.get(label, label)]},
        reasons=tuple(Reason(status, text, number, run_id) for status, (run_id, text), number in firsts),
        pace=survey.pace,
        mixed=sum(len(digests) > 1 for label, digests in codes.items() if label),
        damaged=survey.damaged,
        in_other_shards=len(in_other_shards(manifest, states)),
        hosts=survey.hosts | hosts_at_work(store.folder),
        command=(manifest.get("commands") or [""])[-1],
    )


def without_numbers(text: str) -> str:
    """Return a text with its numbers replaced: errors that differ in numbers only have one reason.

    >>> without_numbers("no convergence at -0.137, step 2e-05")
    'no convergence at #, step #'
    """
    return _NUMBER.sub("#", text)
