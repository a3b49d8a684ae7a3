"""The words of a command line, turned into values or refused in one line.

First what budget=, seeds=, start=, target= and the other words of a sweep may be. Then the words of a verb that Hydra
does not compose: its request is a dataclass that declares a `Word` for each field, `read` makes it and `help_of` its
help. Last, overrides of plain words and numbers, read and composed without Hydra, which is loaded for what needs its
grammar: lists, globs, quotes, presets. ``problem=full12 budget=100`` does not, and composing it by Hydra costs as much
processor time as a small run. A test holds both to the same result.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, Literal, TypeVar, final, get_args, get_origin, get_type_hints

from calibench.bench.execution.request import LONGEST_TIME, MOST_EVALUATIONS, Start
from calibench.core.options import LARGEST_WHOLE, coerce, read_option, shown, suggest

T = TypeVar("T")
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


def read_pairs(verb: str, words: Iterable[str], known: Mapping[str, str]) -> dict[str, str]:
    """Return KEY=VALUE words as a mapping; `known` has an example for each key.

    Raises `ValueError` at an unknown key, at one without a value, and at one that is given twice.
    """
    given: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if key not in known:
            raise ValueError(f"{verb}: unknown argument {key!r}; {suggest(key, known)}")
        if not equals or not value:
            raise ValueError(f"{verb}: {key} needs a value, such as {key}={known[key]}")
        if key in given:
            raise ValueError(f"{verb}: {key} is given twice ({given[key]} and {value}); give it once")
        given[key] = value
    return given


@final
@dataclass(frozen=True)
class Word:
    """Metadata of a field of a request: the word ``key=example``, what it means, and the bounds of a number."""

    key: str
    example: str
    meaning: str
    least: float = -math.inf
    most: float = math.inf


def read(cls: type[T], verb: str, words: Iterable[str]) -> T:
    """Return the request that KEY=VALUE words ask for: a dataclass whose fields are annotated with their `Word`.

    Raises `ValueError`, one line: as `read_pairs` does, at a word without a default that is missing, and at a value
    of another type, of no choice, or out of bounds.
    """
    declared = _declared(cls)
    given = read_pairs(verb, words, {one.key: one.example for _, one, _ in declared.values()})
    values: dict[str, Any] = {}
    for name, (kind, one, default) in declared.items():
        if one.key in given:
            values[name] = _read_word(one, given[one.key], kind)
        elif default is MISSING:
            raise RequestError(f"{one.key}= is missing: {one.meaning}, such as {one.key}={one.example}")
    return cls(**values)


def help_of(cls: type) -> dict[str, str]:
    """Return the words of a request for ``--help``: how each is written -> what it means, and its default."""
    return {
        f"{one.key}={one.example}": one.meaning if default in (MISSING, "", None) else f"{one.meaning} ({default})"
        for _, one, default in _declared(cls).values()
    }


def _declared(cls: type) -> dict[str, tuple[Any, Word, Any]]:
    """Return of each field its type, its word and its default."""
    hints = get_type_hints(cls, include_extras=True)
    return {one.name: (*get_args(hints[one.name])[:2], one.default) for one in fields(cls)}


def _read_word(one: Word, text: str, kind: Any) -> Any:
    if get_origin(kind) is Literal:
        if text not in get_args(kind):
            raise RequestError(f"{one.key}={text:.40}: {suggest(text, get_args(kind))}")
        return text
    bounded = one.least > -math.inf or one.most < math.inf
    try:
        value = read_option(one.key, text, kind)
    except ValueError:
        if not bounded:
            raise
        value = math.nan
    if bounded and not one.least <= value <= one.most:
        number = "a whole number" if kind is int else "a number"
        raise RequestError(f"{one.key}={text:.40}: {number} from {one.least} to {one.most} is needed")
    return value


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
        """Return the value."""
        return _value_of(self.written)

    def is_sweep_override(self) -> bool:
        """Tell whether there are several values."""
        return False

    def get_value_element_as_str(self) -> str:
        """Return the value as text that Hydra reads back."""
        return self.written


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
    values = {
        key: text if key in _MEMBERS and _CLASS.fullmatch(text) else _value_of(text) for key, text in given.items()
    }
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
