"""The words of a sweep, turned into values or refused in one line: budget=, seeds=, execution= and the others.

Then overrides of plain words and numbers, read and composed without Hydra, which is loaded for what needs its grammar:
lists, globs, quotes, presets. ``problem=full12 budget=100`` does not, and composing it by Hydra costs as much processor
time as a small run. A test holds both to the same result.
"""

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, final

from calibench.bench.execution.request import LONGEST_TIME, MOST_EVALUATIONS
from calibench.bench.words import MOST_WORKERS, RequestError, read_workers
from calibench.core.options import LARGEST_WHOLE, coerce, shown, suggest

MOST_RUNS = 1_000_000  # of one command: planning them takes .6 GB and a minute
_REPETITIONS = {"ci": 5, "paper": 10}


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
    if count > MOST_RUNS:
        raise RequestError(
            f"these are {count} runs or more, and one command plans at most {MOST_RUNS}; ask for part of the seeds "
            "at a time (seeds=A:B), into the same study"
        )


@final
@dataclass(frozen=True)
class Once:
    """The settings that are the same for all runs of a sweep.

    `time_limit` [s] of a run; `shard` of `shards`: which of how many parts of the sweep; the failed runs to
    `stop_after`; whether the values of runs are kept as they go (`replay`; None: of costly problems).
    """

    time_limit: float | None
    shard: int
    shards: int
    stop_after: int | None
    replay: bool | None


def read_once(settings: Mapping[str, Any]) -> Once:
    limit: float | None = settings["time_limit"]
    if limit is not None:
        try:
            limit = coerce("time_limit", limit, float)
        except ValueError:
            limit = 0.0
        if limit is None or not 0 < limit <= LONGEST_TIME:
            given = shown(settings["time_limit"])
            raise RequestError(
                f"time_limit={given}: seconds above 0, at most {LONGEST_TIME:g}, are needed, or null for no limit"
            )
    shard, shards = 1, 1
    if settings["shard"] is not None:
        parts = re.fullmatch(r"(\d{1,9})/(\d{1,9})", str(settings["shard"]))
        if parts is None or not 1 <= int(parts[1]) <= int(parts[2]):
            raise RequestError(f"shard={settings['shard']}: I/N is needed, 1 <= I <= N, such as shard=1/4 to shard=4/4")
        shard, shards = int(parts[1]), int(parts[2])
    after, replay = settings["stop_after"], settings["replay"]
    if after is not None and (isinstance(after, bool) or not isinstance(after, int) or after < 1):
        raise RequestError(f"stop_after={shown(after)}: a number of failed runs, 1 or more, is needed, or null")
    if replay is not None and not isinstance(replay, bool):
        raise RequestError(f"replay={replay}: true, false or null is needed")
    return Once(limit, shard, shards, after, replay)


_OPTIONS = {"serial": ("inner",), "processes": ("n_jobs", "inner"), "dask": ("n_jobs", "address", "inner")}
_BY_SHARDS = ("slurm", "ray", "kubernetes", "submitit", "pbs", "sge", "lsf", "htcondor")


@final
@dataclass(frozen=True)
class Execution:
    """The back end (serial, processes or dask), how many workers, and how many evaluate the batches of one run.

    `address` names a Dask scheduler that stands already; `workers` are then those that it has.
    """

    name: str
    workers: int
    inner: int = 1
    address: str | None = None


def check_execution(name: str, options: Iterable[str] = ()) -> str:
    """Return the name of a back end. Raises `RequestError` for another, and for an option that it has not."""
    if name in _BY_SHARDS:
        raise RequestError(
            f"execution={name}: a cluster is used in two ways: shard=I/N, a part of the runs in each job of an array, "
            "then `bench merge`; or execution=dask execution.address=tcp://HOST:PORT, workers that the site starts "
            "(docs/clusters.md)"
        )
    if name not in _OPTIONS:
        raise RequestError(f"execution={name}: {suggest(name, _OPTIONS)}")
    for option in options:
        if option in _OPTIONS[name]:
            continue
        every = {each: None for known in _OPTIONS.values() for each in known}
        meant = next(iter(get_close_matches(option, every, n=1)), option)
        who = [other for other, known in _OPTIONS.items() if meant in known]
        near = f"; did you mean execution.{meant}?" if meant != option else ""
        has = f"{near or ';'} add execution={' or execution='.join(who)}, which has it" if who else near
        raise RequestError(
            f"execution.{option}: execution={name} has no such option{near if name in who else has}; choices: "
            f"{', '.join(_OPTIONS[name])}"
        )
    return name


def read_execution(given: Mapping[str, Any]) -> Execution:
    """Return the settings. Raises `RequestError` for an option that is none, or a value that makes no sense."""
    name = check_execution(str(given["name"]), given.keys() - {"name"})
    n_jobs, address = given.get("n_jobs", 1), given.get("address")
    n_jobs, inner = read_workers(n_jobs), given.get("inner", 1)
    if isinstance(inner, bool) or not isinstance(inner, int) or not 1 <= inner <= MOST_WORKERS:
        raise RequestError(f"execution.inner={shown(inner)}: a number of processes, 1 to {MOST_WORKERS}, is needed")
    if address is not None and (not isinstance(address, str) or "://" not in address):
        raise RequestError(f"execution.address={address}: where the scheduler is, such as tcp://HOST:8786, is needed")
    workers = 1 if name == "serial" else (os.cpu_count() or 1) if n_jobs == -1 else n_jobs
    return Execution(name, workers, inner, address)


_KEY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?", re.ASCII)
_WORD = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_CLASS = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)  # MODULE:CLASS
_MEMBERS = ("problem", "optimizer")
_WHOLE = re.compile(r"-?(?:0|[1-9]\d{0,17})", re.ASCII)
_DECIMAL = re.compile(r"-?(?:0|[1-9]\d{0,17})(?:\.\d+)?(?:e[+-]?\d{1,2})?", re.ASCII)
_TEXT = re.compile(r"[\w.:/ +-]*", re.ASCII)
_RESERVED = {"null": None, "true": True, "false": False}
_NONE = object()


@final
@dataclass(frozen=True)
class PlainOverride:
    """One value for one key: what this program asks of Hydra's ``Override``, by the same names."""

    key_or_group: str
    input_line: str
    written: str  # as Hydra would write the value

    def value(self) -> Any:
        return _value_of(self.written)

    def is_sweep_override(self) -> bool:
        return False


def plain_override(argument: str, as_text: bool) -> PlainOverride | None:
    """Return ``key=value`` as an override, its value as text to the letter or as it looks; None: Hydra must read it."""
    key, _, value = argument.partition("=")
    if _KEY.fullmatch(key) is None:
        return None
    if as_text:
        return PlainOverride(key, argument, f"'{value}'") if _TEXT.fullmatch(value) else None
    found = _value_of(value) if not value.startswith("'") else _NONE
    written = "null" if found is None else str(found)  # as Hydra does: 1e5 is 100000.0, true is True
    return None if found is _NONE else PlainOverride(key, argument, written)


def compose_plainly(
    overrides: Sequence[str],
    settings: Callable[[str], Mapping[str, Any]],
    member: Callable[[str, str], Mapping[str, Any] | None],
) -> dict[str, Any] | None:
    """Return the composition of ``key=value`` texts; None where Hydra must make it, or refuse it.

    `settings` returns the composition without overrides but the named execution; ``member(kind, name)`` the options of
    a problem or optimizer with their defaults, or None for a preset. An option is set where it is declared.
    """
    given = dict(text.partition("=")[::2] for text in overrides)
    classes = {key: text for key, text in given.items() if key in _MEMBERS and _CLASS.fullmatch(text)}
    values: dict[str, Any] = {key: _value_of(text) for key, text in given.items()} | classes
    if len(given) < len(overrides) or _NONE in values.values():
        return None
    execution = values.pop("execution", "serial")
    composed: dict[str, Any] = {}
    for kind in _MEMBERS:
        if kind in values:
            options = member(kind, given[kind])
            if options is None or type(values.pop(kind)) is not str or not _is_plain(options):
                return None
            composed[kind] = dict(options)
    composed |= settings(str(execution))
    for key, value in values.items():
        group, dot, option = key.partition(".")
        inside = composed.get(group) if dot else composed
        name = option if dot else group
        if not isinstance(inside, dict) or name not in inside or isinstance(inside[name], dict):
            return None
        if key == "execution.name" or name == "study":  # what a member is, and a group of Hydra's
            return None
        inside[name] = value
    return composed


def _value_of(text: str) -> Any:
    """Return the value that Hydra reads from `text`; `_NONE` where that takes its grammar."""
    if _WHOLE.fullmatch(text):
        return int(text)
    if _DECIMAL.fullmatch(text):
        return float(text)
    if text.lower() in _RESERVED:
        return _RESERVED[text.lower()]
    if text[:1] == text[-1:] == "'" and len(text) > 1 and _TEXT.fullmatch(text[1:-1]):
        return text[1:-1]
    return text if _WORD.fullmatch(text) and text.lower() not in ("inf", "nan") else _NONE


def _is_plain(value: Any) -> bool:
    """Tell whether a default stands for itself: OmegaConf resolves ``${...}``, and changes other types."""
    if isinstance(value, dict | list):
        return all(_is_plain(item) for item in (value.values() if isinstance(value, dict) else value))
    return value is None or (type(value) in (str, int, float, bool) and "${" not in str(value))
