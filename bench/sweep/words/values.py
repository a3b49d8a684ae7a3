"""What budget=, seeds=, start=, target= and time_limit= may be: a value is read or refused."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from calibench.bench.execution.request.checks import LONGEST_TIME, MOST_EVALUATIONS, Start
from calibench.core.options import LARGEST_WHOLE, coerce, shown, suggest

MOST_RUNS = 1_000_000  # of one command: planning them takes .6 GB and a minute
MOST_WORKERS = 1024  # processes on one machine: each has its own Python
LONGEST_NAME = 200  # bytes: file systems take 255, and files beside a folder add to its name
_REPETITIONS = {"ci": 5, "paper": 10}


class RequestError(ValueError):
    """A request that makes no sense, in one line."""


def read_budget(value: Any, problem: str, numbers: Mapping[str, int]) -> int:
    """Return the number of evaluations; a word is looked up in the `numbers` of the problem."""
    if isinstance(value, str):
        if value not in ("ci", "paper"):
            raise RequestError(
                f"budget={shown(value)}: a whole number of evaluations, or the word ci or paper, is needed"
            )
        if value not in numbers:
            said = f"budget={value}{' (the default)' if value == 'ci' else ''}"
            raise RequestError(
                f"{said}: problem {problem} does not say what {value} means; give a number, such as budget=2000"
            )
        return numbers[value]
    try:
        budget: int = coerce("budget", value, int)
    except ValueError:
        raise RequestError(
            f"budget={shown(value)}: a whole number of evaluations, at most {MOST_EVALUATIONS:.0e}, or the word ci or "
            "paper, is needed"
        ) from None
    if budget < 1:
        raise RequestError(f"budget={value}: must be 1 or more")
    if budget > MOST_EVALUATIONS:
        raise RequestError(f"budget={budget}: at most {MOST_EVALUATIONS:.0e} evaluations can be counted")
    return budget


def read_seeds(value: Any) -> range:
    """Return the repetitions that N, A:B, ci or paper stand for."""
    text = str(value)
    if text in _REPETITIONS:
        return range(_REPETITIONS[text])
    first, colon, last = text.partition(":")
    try:
        wanted = range(int(first), int(last)) if colon else range(int(first))
    except ValueError:
        raise RequestError(f"seeds={text}: N, A:B, ci or paper is needed, such as seeds=10 or seeds=10:20") from None
    if not wanted or wanted.start < 0:
        raise RequestError(f"seeds={text}: holds no repetition from 0 on; write N >= 1, or A:B with 0 <= A < B")
    if wanted.stop > LARGEST_WHOLE:
        raise RequestError(f"seeds={text}: at most {LARGEST_WHOLE} is a repetition")
    return wanted


def check_runs(count: int) -> None:
    """Raise `RequestError` for more runs than one command plans."""
    if count > MOST_RUNS:
        raise RequestError(
            f"these are {count} runs or more, and one command plans at most {MOST_RUNS}; ask for part of the seeds "
            "at a time (seeds=A:B), into the same study"
        )


def check_study(name: str) -> None:
    """Raise `RequestError` for a `study=` that names no folder inside another."""
    plain = name.isprintable() and "/" not in name and name not in ("", ".", "..")
    if not plain or len(name.encode(errors="replace")) > LONGEST_NAME:
        raise RequestError(
            f"study={name:.40}: the name of one folder inside results=, of at most {LONGEST_NAME} bytes, is needed"
        )


def read_workers(value: Any) -> int:
    """Return the number of processes, -1 for one a core."""
    try:
        workers: int = coerce("execution.n_jobs", value, int)
    except ValueError:
        workers = 0
    if workers == 0 or not -1 <= workers <= MOST_WORKERS:
        raise RequestError(
            f"execution.n_jobs={shown(value)}: a number of processes, at most {MOST_WORKERS}, or -1 for one a core, is "
            "needed"
        )
    return workers


def read_inner(value: Any) -> int:
    """Return the number of processes that evaluate the batches of one run."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= MOST_WORKERS:
        raise RequestError(f"execution.inner={shown(value)}: a number of processes, 1 to {MOST_WORKERS}, is needed")
    return value


def read_start(value: Any) -> Start | None:
    """Return the start, or None for what the problem prefers."""
    if value not in (None, "nominal", "random"):
        raise RequestError(f"start={shown(value)}: {suggest(shown(value), ['nominal', 'random'])}")
    start: Start | None = value
    return start


def read_target(value: Any) -> float | None:
    """Return the value that ends a run, or None."""
    if value is None:
        return None
    try:
        target: float = coerce("target", value, float)
    except ValueError:
        raise RequestError(f"target={shown(value)}: a number is needed") from None
    return target


def read_shard(value: Any) -> tuple[int, int]:
    """Return I and N of the text I/N: which of how many parts of a sweep; 1 and 1 for None, all of it."""
    if value is None:
        return 1, 1
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", str(value))
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise RequestError(f"shard={value}: I/N is needed, 1 <= I <= N, such as shard=1/4 to shard=4/4")
    return int(found[1]), int(found[2])


def read_stop_after(value: Any) -> int | None:
    """Return the number of failed runs after which no other is begun, or None."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise RequestError(f"stop_after={shown(value)}: a number of failed runs, 1 or more, is needed, or null")
    return value


def read_replay(value: Any) -> bool | None:
    """Return whether the values of runs are kept as they go; None: of costly problems."""
    if value is not None and not isinstance(value, bool):
        raise RequestError(f"replay={value}: true, false or null is needed")
    return value


def read_time_limit(value: Any) -> float | None:
    """Return the seconds after which a run is ended, or None."""
    if value is None:
        return None
    try:
        limit: float = coerce("time_limit", value, float)
    except ValueError:
        limit = 0.0
    if not 0 < limit <= LONGEST_TIME:
        raise RequestError(
            f"time_limit={shown(value)}: seconds above 0, at most {LONGEST_TIME:g}, are needed, or null for no limit"
        )
    return limit
