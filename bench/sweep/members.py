"""The members of a sweep: each problem and each optimiser that is named, composed with its own options and built.

A name may be a registered one, a preset of ``conf/``, a user's class, or a glob over the registry.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from json import dumps
from typing import Any, final

from calibench.bench.execution.request.pair import foreign_modules
from calibench.bench.execution.request.probe import probe
from calibench.bench.gate.processes.forked_worker import Lost
from calibench.bench.gate.time_limit import text_of
from calibench.bench.provenance.run_id import (
    chosen_options,
    key_of_optimizer,
    key_of_problem,
    options_as_asked,
)
from calibench.bench.sweep.studies import near_study, study_names
from calibench.bench.sweep.words.composition import (
    CONF,
    NOT_GIVEN,
    REGISTERED,
    compose_texts,
    enter,
    entered,
    plain,
    registry_of,
)
from calibench.bench.sweep.words.hydra_overrides import MOST_VALUES, as_annotated, in_ascii, last_value, values_of
from calibench.bench.sweep.words.plain_words import PlainOverride
from calibench.bench.sweep.words.values import RequestError
from calibench.core.annotated import as_typed
from calibench.core.options import shown, suggest
from calibench.core.own_state import kept
from calibench.core.registry import UnknownName, beside, suggest_or_own

_SHOWN = 8  # names of a long list where none was given
_YES_OR_NO = {"yes", "no", "on", "off", "y", "n"}
_FUNCTION = {
    "problem": "; a function is called with the options and returns a problem: an object with lower, upper, start "
    "and a call",
    "optimizer": "; a function is called with the options and returns an optimiser: an object with "
    "minimize(objective, rng), such as one of class Search: minimize = staticmethod(NAME)",
}


@final
@dataclass(frozen=True)
class Member:
    """A problem or optimiser of the sweep: its name in rows, where it is found, options given, the thing, its key."""

    name: str
    place: str
    options: Mapping[str, Any]
    built: Any = field(repr=False)
    key: list[Any] = field(repr=False)
    globbed: bool = False  # matched, not named
    broken: Lost | None = None  # `built` is then what would build it

    @property
    def asked(self) -> str:
        """Return the name with the options that it is built with, but for those that have their defaults."""
        return " ".join([self.name, *(f"{option}={shown(value)}" for option, value in self.options.items())])

    @property
    def label(self) -> str:
        options = sorted(self.key[1].items())
        told = [f"{key}={value if isinstance(value, str) else dumps(value)}" for key, value in options]
        return f"{self.name} ({', '.join(told)})" if told else self.name


def members_of(kind: str, overrides: list[Any]) -> list[Member]:
    """Return the problems or optimisers of a sweep, each composed with its own options and built."""
    registry = registry_of(kind)
    own = {"problem": "prob", "optimizer": "opt"}[kind]
    named = [choice for o in overrides if o.key_or_group == kind for choice in _choices(kind, o)]
    globbed = dict(named[::-1])  # the first of a name that comes twice counts
    choices = list(dict.fromkeys(name for name, _ in named)) if any(globbed.values()) else [name for name, _ in named]
    if not choices:
        raise RequestError(_nothing_named(kind, overrides))
    classes = _class_names(choices)
    known = {*choices, *classes.values()}
    addressed = [o.key_or_group.partition(".")[2] for o in overrides if o.key_or_group.startswith(f"{own}.")]
    for name in (a.rpartition(".")[0] for a in addressed if not any(a.startswith(f"{name}.") for name in known)):
        raise RequestError(f"{own}.{name}: {name} is not in this sweep; {suggest(name, choices)}")
    members: list[Member] = []
    for choice in choices:
        name = _registered_name(kind, choice)
        options = [
            (o.key_or_group.removeprefix(prefix), o)
            for o in overrides
            for prefix in (f"{kind}.", *(f"{own}.{name}." for name in {choice, classes.get(choice, choice)}))
            if o.key_or_group.startswith(prefix)
        ]
        lists = [values_of(as_annotated(o, registry.option(name, option).annotation)) for option, o in options]
        if len(members) + math.prod(map(len, lists)) > MOST_VALUES:
            raise RequestError(f"these are more than {MOST_VALUES} settings of {kind}s; ask for part of them at a time")
        for values in itertools.product(*lists):
            typed = [(option, value) for (option, _), value in zip(options, values, strict=True)]
            given = [f"{kind}.{option}={value}" for option, value in _gathered(kind, typed).items()]
            composed = dict(compose_texts([f"{kind}={entered(choice)}", *given])[kind])
            composed.pop(REGISTERED)
            asked = {option.partition(".")[0] for option, _ in typed}
            written = {option: o.input_line.partition("=")[2] for option, o in options if not o.is_sweep_override()}
            chosen = _chosen_options(kind, choice, name, composed, asked, written)
            members.append(_member(kind, name, chosen, globbed[choice]))
    return members


def _nothing_named(kind: str, overrides: list[Any]) -> str:
    """Return the message for a request without a problem or an optimiser; a study that is not one may be why."""
    study = last_value(overrides, "study", "")
    file = near_study(study) if study else ""
    near = f"did you mean study={file}?" if file else suggest(study, study_names())
    prepared = f" (study={study} is not a prepared one; {near})" if study else ""
    names = _group(kind)
    some = (
        f"such as {', '.join(names[:_SHOWN])}; `bench list {kind}s` lists all {len(names)}, and FILE.py:CLASS is yours"
    )
    return f"{kind}=NAME is missing{prepared}, {some}"


def _chosen_options(
    kind: str, choice: str, name: str, composed: Mapping[str, Any], asked: set[str], written: Mapping[str, str]
) -> dict[str, Any]:
    """Return the options that a member is built with: those required, and those that differ from their defaults.

    `written` has those of one value as they were typed, for messages.
    Raises `RequestError` where a required one is missing, `ValueError` for a value that its option does not take.
    """
    registry = registry_of(kind)
    declared = registry.options(name)
    missing = [k for k, v in composed.items() if declared[k].required and v == NOT_GIVEN]
    if missing:
        ways = " ".join(f"{kind}.{k}=..." for k in missing)
        way = _way(kind, name)
        told = way if way and kind == "optimizer" else f" (no default); add {ways}{way}"
        raise RequestError(f"{choice} needs {', '.join(missing)}{told}")
    for option in asked:
        untyped = declared[option].type is Any and isinstance(declared[option].default, bool)
        if untyped and str(composed[option]).lower() in _YES_OR_NO:
            said = f"{choice}.{option}={composed[option]}"
            raise RequestError(f"{said}: true or false is needed; a word, whatever it says, counts as true")
    needed = {k: v for k, v in composed.items() if k in asked or declared[k].required}
    try:
        registry.check(name, needed)  # also what equals the default, as true does 1.0
    except ValueError as error:
        message = str(error)
        for option, text in written.items():
            message = as_typed(message, f"{registry.told_name(name)}.{option}", composed.get(option), text)
        raise RequestError(message) from error
    return {k: v for k, v in composed.items() if declared[k].required or v != plain(declared[k].default)}


def _member(kind: str, name: str, chosen: dict[str, Any], globbed: bool) -> Member:
    """Return a problem or an optimiser, built, with its key; or the one that could not be built, with the reason."""
    registry = registry_of(kind)
    told = registry.told_name(name)
    lost = probe(registry, name, chosen)
    if lost is not None:
        return _unbuilt(kind, name, chosen, globbed, lost)
    try:
        place = registry.place(name)  # found in any working folder
        with kept(*foreign_modules(registry, place)):
            built = registry.make(place, **chosen)
        key = key_of_problem(built, told) if kind == "problem" else key_of_optimizer(built, told)
    except ValueError:
        raise
    except (Exception, SystemExit) as error:
        way = _way(kind, name)
        given = ", ".join(f"{option}={shown(value)}" for option, value in chosen.items())
        told = f"{kind} {name} cannot be built: {type(error).__name__}: {text_of(error)}{way}"
        raise RequestError(f"{told}{given and f' (it was given {given})'}") from error
    return Member(told, registry.place(name), chosen, built, key, globbed)


def _way(kind: str, name: str) -> str:
    """Return what a function in the place of a class is for; '' where it is a class."""
    if not inspect.isfunction(registry_of(kind).factory(name)):
        return ""
    return _FUNCTION[kind].replace("NAME", name.rpartition(":")[2])


def _gathered(kind: str, typed: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Return options with those inside another as one value: ``noise.sigma=0.1`` is ``noise={sigma: 0.1}``."""
    found: dict[str, str] = {}
    inside: dict[str, list[tuple[str, str]]] = {}
    for option, value in typed:
        first, dot, rest = option.partition(".")
        if first in (found if dot else inside):
            raise RequestError(f"{kind}.{first} is given as a whole and in part; give its parts, or the whole")
        if dot:
            inside.setdefault(first, []).append((rest, value))
        else:
            found[first] = value
    for first, parts in inside.items():
        found[first] = (
            "{" + ",".join(f"{in_ascii(k)}: {v}" for k, v in _gathered(f"{kind}.{first}", parts).items()) + "}"
        )
    return found


def _class_names(choices: Sequence[str]) -> dict[str, str]:
    """Return choice -> the name of its class, of those in files, where no other choice is called so."""
    names = {choice: choice.rpartition(":")[2] for choice in choices if ":" in choice}
    counts = Counter([*choices, *names.values()])
    return {choice: name for choice, name in names.items() if counts[name] == 1}


def _unbuilt(kind: str, name: str, options: Mapping[str, Any], globbed: bool, why: Lost) -> Member:
    """Return the member whose class cannot be built, with the name that it would have; `built` is the class."""
    registry = registry_of(kind)
    told = registry.told_name(name)
    key: list[Any] = [told, chosen_options(registry, told, options_as_asked(registry, name, options))]
    key += [""] if kind == "problem" else []
    return Member(told, registry.place(name), options, registry.factory(name), key, globbed, why)


def _choices(kind: str, override: Any) -> list[tuple[str, bool]]:
    """Return the names an override chooses and whether a glob did; lm,glob(nlopt_*) is lm and all that match."""
    if isinstance(override, PlainOverride):
        return [(text, False) for text in values_of(override)]
    from hydra.core.override_parser.types import ChoiceSweep, Glob

    value = override.value()
    parts = value.list if isinstance(value, ChoiceSweep) else [value] if isinstance(value, Glob) else []
    if not any(isinstance(part, Glob) for part in parts):
        return [(_unquoted(text).replace("\\", ""), False) for text in values_of(override)]
    chosen = []
    for part in parts:
        names = part.filter(registry_of(kind).names()) if isinstance(part, Glob) else [str(getattr(part, "text", part))]
        if not names:
            raise RequestError(f"{override.input_line}: matches no {kind}; {suggest('', _group(kind))}")
        chosen += [(_unquoted(name), isinstance(part, Glob)) for name in names]
    return chosen


def _unquoted(text: str) -> str:
    """Return a name without the quotes that let it hold spaces and brackets: a path may."""
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def _registered_name(kind: str, choice: str) -> str:
    """Return the registry's name of a choice: itself, or what a preset of ``conf/<kind>/`` is made from."""
    registry = registry_of(kind)
    if choice in registry or ":" in choice:
        enter(kind, choice, registry)
        return choice
    if (CONF / kind / f"{choice}.yaml").is_file():
        return str(compose_texts([f"{kind}={choice}"])[kind][REGISTERED])
    try:
        registry.options(choice)
    except UnknownName:
        way = f"{beside(kind, choice)}{suggest_or_own(choice, _group(kind))}"
        raise RequestError(f"unknown {kind} {choice!r}; {way}") from None
    raise AssertionError(choice)


def _group(kind: str) -> list[str]:
    registry = registry_of(kind)
    return [*registry.names(), *sorted(path.stem for path in (CONF / kind).glob("*.yaml"))]
