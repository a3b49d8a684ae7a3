"""The reader of verbs that Hydra does not compose: KEY=VALUE words become a dataclass that declares each of them.

A field's `Word` says how it is written, what it means and what it may be. `read` makes the values, defaults and
refusals of that one declaration, `help_of` the help. `bench.verbs` has the declarations.
"""

import math
from collections.abc import Iterable
from dataclasses import KW_ONLY, MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Literal, TypeVar, final, get_args, get_origin, get_type_hints

from calibench.core.options import as_typed, coerce, read_word, shown, suggest

T = TypeVar("T")
LONGEST_NAME = 200  # bytes: file systems take 255, and files beside a folder add to its name
MOST_WORKERS = 1024  # processes on one machine: each has its own Python


class RequestError(ValueError):
    """A request that makes no sense, in one line."""


@final
@dataclass(frozen=True)
class Word:
    """Metadata of a field: the word ``key=example``, what it means, and what it may be. A `key` that ends in a dot
    begins many words, whose texts the field holds by the rest of their names; the empty key holds all others."""

    key: str
    example: str
    meaning: str
    _: KW_ONLY
    form: str = ""  # in the help, in place of the example or of the choices
    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf
    needed: str = ""  # what a wrong value is answered


def read(cls: type[T], verb: str, words: Iterable[str]) -> T:
    """Return the request that KEY=VALUE words ask for: a dataclass whose fields are annotated with their `Word`.

    Raises `ValueError`, one line: at a key that is not known, has no value or is given twice, at a word without a
    default that is missing, and at a value of another type, of no choice, or out of bounds.
    """
    declared = _declared(cls)
    examples = {one.key: one.example for _, one, _ in declared.values()}
    known = keys_of(cls)
    begins = sorted((one.key for _, one, _ in declared.values() if one.key not in known), key=len, reverse=True)
    given: dict[str, str] = {}
    of_many: dict[str, dict[str, str]] = {begin: {} for begin in begins}
    for word in words:
        key, equals, text = word.partition("=")
        place = key if key in known else next((each for each in begins if key.startswith(each) and key != each), None)
        if place is None:
            raise ValueError(f"{verb}: unknown argument {key!r}; {suggest(key, known)}")
        if not place and not equals:
            such = " ".join(f"{each}={examples[each]}" for each in known[:2])
            raise RequestError(f"{word!r} is no argument; write KEY=VALUE, such as {such}")
        if not text:
            raise ValueError(f"{verb}: {key} needs a value, such as {key}={examples[place]}")
        if key in given:
            raise ValueError(f"{verb}: {key} is given twice ({given[key]} and {text}); give it once")
        given[key] = text
        if place != key:
            of_many[place][key.removeprefix(place)] = text

    values: dict[str, Any] = {}
    for name, (kind, one, default) in declared.items():
        if one.key in of_many:
            values[name] = of_many[one.key]
        elif one.key in given:
            values[name] = _value_of(one, given[one.key], kind)
        elif default is MISSING:
            raise RequestError(f"{one.key}= is missing: {one.meaning}, such as {one.key}={one.example}")
    return cls(**values)


def help_of(cls: type) -> dict[str, str]:
    """Return the words of a request for ``--help``: how each is written -> what it means, and its default."""
    lines = {}
    for kind, one, default in _declared(cls).values():
        choices = "true|false" if kind is bool else "|".join(get_args(kind)) if get_origin(kind) is Literal else ""
        form = one.form or choices or one.example
        if isinstance(default, str | int | float) and default != "":
            usual = f" ({default:g})" if isinstance(default, float) else f" ({shown(default)})"
        else:
            usual = ""
        if one.key:
            lines[f"{one.key}{'' if one.key.endswith('.') else '='}{form}"] = one.meaning + usual
    return lines


def keys_of(cls: type) -> list[str]:
    """Return the keys of a request that are written out, each of which stands for one word."""
    return [one.key for _, one, _ in _declared(cls).values() if one.key and not one.key.endswith(".")]


def _declared(cls: type) -> dict[str, tuple[Any, Word, Any]]:
    """Return of each field its type, without the None of one that is not given, its word and its default."""
    hints = get_type_hints(cls, include_extras=True)
    declared = {}
    for one in fields(cls):
        kind, word = get_args(hints[one.name])[:2]
        if one.default is None:
            [kind] = [each for each in get_args(kind) if each is not type(None)]
        declared[one.name] = (kind, word, one.default)
    return declared


def _value_of(one: Word, text: str, kind: Any) -> Any:
    """Return the value of a word; a path and what is text are taken to the letter."""
    if kind is str:
        return text
    if kind is Path:
        return Path(text).expanduser()
    bounded = max(one.least, one.above) > -math.inf or one.most < math.inf
    try:
        value = read_word(text, kind)
        try:
            value = coerce(one.key, value, kind)
        except ValueError as error:  # which is to quote the word
            raise ValueError(as_typed(str(error), one.key, value, text)) from None
        is_inside = not bounded or (one.least <= value <= one.most and value > one.above)
    except ValueError:
        if not bounded and not one.needed:
            raise
        is_inside = False
    if not is_inside:
        reach = f"above {one.above:g}" if one.above > -math.inf else f"from {one.least:g}"
        reach += f" to {one.most:g}" if one.most < math.inf else ""
        said = f"{'a whole' if kind is int else 'a'} number {reach} is needed: {one.meaning} [{one.form or one.key}]"
        raise RequestError(f"{one.key}={text:.40}: {one.needed or said}")
    return value


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


def split_word(argv: list[str], key: str) -> tuple[list[str], list[str]]:
    """Return what follows the word `key` (one word, or none), and all other words."""
    at = argv.index(key) if key in argv else len(argv)
    return argv[at + 1 : at + 2], argv[:at] + argv[at + 2 :]


def split_flags(argv: list[str], known: Iterable[str]) -> tuple[set[str], list[str]]:
    """Return the flags and the other words; an unknown flag is an error."""
    flags = {word for word in argv if word.startswith("-")}
    for flag in flags - set(known):
        raise ValueError(f"unknown flag {flag!r}; {suggest(flag, known)}")
    return flags, [word for word in argv if not word.startswith("-")]
