"""From the command line to a list of runs: Hydra composes, the registries check, and nothing runs before all is right.

A problem and an optimiser are composed once each, not once a pair: composing takes a tenth of a second.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from json import dumps
from pathlib import Path
from typing import Any, final

from calibench.bench.execution.costly import ReplayFolder, check_inner, check_replay
from calibench.bench.execution.request.checks import Start, check_request, preferred_start, repetitions_of, unmet_need
from calibench.bench.execution.request.probe import probe
from calibench.bench.execution.run import Spec
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.gate.processes.forked_worker import Lost
from calibench.bench.gate.time_limit import text_of
from calibench.bench.provenance.code_digest import code_digest
from calibench.bench.provenance.run_id import (
    chosen_options,
    key_of_optimizer,
    key_of_problem,
    options_as_asked,
    run_id,
)
from calibench.bench.sweep.called import Cell, called, copies
from calibench.bench.sweep.execution import read_execution
from calibench.bench.sweep.studies import is_study_file, study_names, study_preset
from calibench.bench.sweep.words.composition import (
    CONF,
    NOT_GIVEN,
    REGISTERED,
    compose,
    compose_texts,
    enter,
    entered,
    plain,
    registry_of,
)
from calibench.bench.sweep.words.hydra_overrides import (
    MOST_VALUES,
    ONCE,
    check_keys,
    in_ascii,
    last_value,
    parse,
    products,
    refuse_lists,
    values_of,
)
from calibench.bench.sweep.words.plain_words import PlainOverride
from calibench.bench.sweep.words.values import (
    RequestError,
    check_runs,
    read_budget,
    read_replay,
    read_seeds,
    read_shard,
    read_start,
    read_stop_after,
    read_target,
    read_time_limit,
)
from calibench.core.options import suggest
from calibench.core.registry import suggest_or_own

_FUNCTION = {
    "problem": "; a function is called with the options and returns a problem: an object with lower, upper, start "
    "and a call",
    "optimizer": "; a function is called with the options and returns an optimiser: an object with "
    "minimize(objective, rng), such as one of class Search: minimize = staticmethod(NAME)",
}


@final
@dataclass(frozen=True)
class Request:
    """What was asked for: runs by id in order, where they go, and how they are carried out."""

    specs: Mapping[str, Spec]
    labels: Mapping[str, str]  # run id -> its cell with all options: a key of the manifest
    folder: Path
    execution: Mapping[str, Any]
    codes: Mapping[str, str] = field(default_factory=dict)  # run id -> digest of the code that would run it now
    files: Mapping[str, str] = field(default_factory=dict)  # a user's own classes: name in the rows -> absolute path
    left_out: tuple[str, ...] = ()  # what a glob matched and cannot run, a line a reason
    stop_after: int | None = None  # failed runs
    replay: bool | None = None
    broken: Mapping[str, tuple[str, str]] = field(default_factory=dict)  # run id -> error_type, error: cannot be built
    called: Mapping[str, str] = field(default_factory=dict)  # label -> what its cell is called beside the others
    copies: tuple[str, ...] = ()  # problems that are one problem under several seeds of their data, a line each
    seeds: int = 1  # the most repetitions that are asked for of a cell


_Skipped = dict[str, dict[str, list[str]]]  # problem -> what is needed -> who needs it, for every problem of a sweep


@final
@dataclass(frozen=True)
class _Member:
    """A problem or optimiser of the sweep: its name in rows, where it is found, options given, the thing, its key."""

    name: str
    place: str
    options: Mapping[str, Any]
    built: Any = field(repr=False)
    key: list[Any] = field(repr=False)
    globbed: bool = False  # matched, not named
    broken: Lost | None = None  # `built` is then what would build it

    @property
    def label(self) -> str:
        options = sorted(self.key[1].items())
        told = [f"{key}={value if isinstance(value, str) else dumps(value)}" for key, value in options]
        return f"{self.name} ({', '.join(told)})" if told else self.name


def read_request(arguments: Sequence[str], multirun: bool) -> Request:
    """Return the runs that `arguments` (Hydra overrides) ask for. Raises `RequestError` or `ValueError`."""
    study, sweeps, once = _sweeps(arguments, multirun)
    settings = compose(once)
    time_limit = read_time_limit(settings["time_limit"])
    inner = read_execution(settings["execution"]).inner
    folder = Path(str(settings["results"])) / study
    shard, shards = read_shard(settings["shard"])
    stop_after, replay = read_stop_after(settings["stop_after"]), read_replay(settings["replay"])
    specs: dict[str, Spec] = {}
    labels: dict[str, str] = {}
    cells: dict[str, Cell] = {}
    codes: dict[str, str] = {}
    files: dict[str, str] = {}
    broken: dict[str, tuple[str, str]] = {}
    skipped: _Skipped = {}
    digests: dict[tuple[int, int], str] = {}
    every: list[_Member] = []  # so that no other gets the id of one that is gone
    for sweep in sweeps:
        for spec_id, spec, label, members in _expand(sweep, skipped, inner, time_limit is not None):
            if labels.setdefault(spec_id, label) != label:
                raise RequestError(f"two cells have one run id, {spec_id}: {labels[spec_id]}; and {label}")
            if label not in cells:
                cells[label] = Cell(members[0].key, members[1].key, spec.budget, spec.start, spec.target)
            if int(spec_id, 16) % shards != shard - 1:
                continue
            specs.setdefault(spec_id, replace(spec, time_limit=time_limit))
            pair = id(members[0]), id(members[1])
            if pair not in digests:
                digests[pair] = code_digest(members[0].built, members[1].built)
                every += members
            codes[spec_id] = digests[pair]
            if all(member.broken is None for member in members):
                check_inner(members[0].built, members[1].built, inner)
                check_replay(members[0].built, ReplayFolder(folder, always=replay is True))
            lost = next((m.broken for m in members if m.broken is not None), None)
            if lost is not None:
                broken[spec_id] = lost.error_type, lost.error
            files |= {m.name: m.place.rpartition(":")[0] for m in members if m.place != m.name}
    left_out = _left_out(skipped)
    if not labels:
        if not left_out:
            raise RequestError("nothing to run: a list or range of this sweep is empty")
        why = "; ".join(left_out)
        raise RequestError(f"nothing to run: no optimizer that glob(...) matches can run these problems; {why}")
    labels = {spec_id: labels[spec_id] for spec_id in specs}
    execution = settings["execution"]
    return Request(
        specs, labels, folder, execution, codes, files, left_out, stop_after, replay, broken, called(cells),
        tuple(copies(cells.values())), max(_seeds_asked(sweep) for sweep in sweeps),
    )  # fmt: skip


def _sweeps(arguments: Sequence[str], multirun: bool) -> tuple[str, list[list[Any]], list[Any]]:
    """Return the name of the study, its sweeps as overrides, and those overrides that are the same for all runs."""
    overrides = parse(arguments)
    study = last_value(overrides, "study", "adhoc")
    preset = study_preset(study)
    if is_study_file(study):
        study = Path(study).stem
    if study in ("", ".", "..") or "/" in study or not study.isprintable() or len(study.encode()) > 200:
        raise RequestError(f"study={study:.40}: the name of one folder inside results= is needed")
    if preset is None:
        sweeps = [overrides]
        if not multirun:
            refuse_lists(overrides)
    else:
        given = {o.key_or_group for o in overrides}
        shared = {key: value for key, value in preset.items() if key not in {"description", "sweeps", *given}}
        sweeps = [
            [*(o for o in parse([*_besides(shared, sweep), *sweep]) if o.key_or_group not in given), *overrides]
            for sweep in preset["sweeps"]
        ]
    once = _of_all(sweeps)
    for o in once:
        if o.is_sweep_override():
            raise RequestError(f"{o.input_line}: one value is needed, it is the same for all runs")
    return study, sweeps, once


def _besides(shared: Mapping[str, Any], sweep: Sequence[str]) -> list[str]:
    """Return what the sweeps of a study share as words, without those that a sweep says itself."""
    own = {word.partition("=")[0] for word in sweep}
    return [f"{key}={value}" for key, value in shared.items() if key not in own]


def _of_all(sweeps: Sequence[Sequence[Any]]) -> list[Any]:
    """Return the words that are one for all runs. Raises `RequestError` where not all sweeps of a study have them."""
    found = [{o.input_line: o for o in sweep if o.key_or_group.partition(".")[0] in ONCE} for sweep in sweeps]
    for line in (line for words in found for line in words if any(line not in others for others in found)):
        raise RequestError(f"{line}: stands in one sweep and is for all of the study; write it beside sweeps:")
    return list(found[0].values())


def _seeds_asked(overrides: Sequence[Any]) -> int:
    """Return the most repetitions of a cell that a sweep asks for."""
    words = [[f"seeds={value}"] for o in overrides if o.key_or_group == "seeds" for value in values_of(o)]
    return max(len(read_seeds(compose(word)["seeds"])) for word in words or [[]])


def build_member(kind: str, arguments: Sequence[str]) -> Any:
    """Return the one problem or optimiser (`kind`) that `arguments` name, with its options."""
    overrides = parse(arguments)
    refuse_lists(overrides)
    member = _members(kind, overrides)[0]
    if member.broken is not None:
        raise RequestError(f"{kind} {member.name} cannot be built: {member.broken.error}")
    return member.built


def _left_out(skipped: _Skipped) -> tuple[str, ...]:
    """Return what was skipped as lines: methods, what they need, and where that is not so of all problems, of which."""
    every, lacking = set(skipped), dict[str, list[str]]()
    for problem, needed in skipped.items():
        for needs, names in needed.items():
            told = f"{', '.join(names)} {'needs' if len(names) == 1 else 'need'} {needs}"
            lacking.setdefault(told, []).append(problem)
    return tuple(
        f"{told}: skipped" if set(where) == every else f"{told}: skipped on {', '.join(where)}"
        for told, where in lacking.items()
    )


def _expand(
    overrides: list[Any], skipped: _Skipped, inner: int, limited: bool
) -> Iterator[tuple[str, Spec, str, tuple[_Member, _Member]]]:
    """Yield (run id, spec, label, problem and optimiser) of one sweep; note in `skipped` what a glob's methods lack."""
    check_keys(overrides)
    pairs = _members("problem", overrides), _members("optimizer", overrides)
    rest = [o for o in overrides if o.key_or_group in ("budget", "seeds", "start", "target")]
    check_runs(math.prod(map(len, pairs)) * math.prod(len(values_of(o)) for o in rest))
    cells, planned = list(itertools.product(*pairs)), 0
    for choice in products(rest):
        settings = compose(choice)
        start, target = read_start(settings["start"]), read_target(settings["target"])
        for problem, optimizer in cells:
            if problem.broken or optimizer.broken:
                yield from _broken_cell(problem, optimizer, settings, start, target)
                continue
            budget = read_budget(settings["budget"], problem.name, getattr(problem.built, "budgets", {}))
            wanted = read_seeds(settings["seeds"])
            needs = _unmet_need(problem, optimizer, inner, limited)
            if needs:  # a glob asks for whatever can run it; what is named must
                names = skipped.setdefault(problem.label, {}).setdefault(needs, [])
                names += [optimizer.name] if optimizer.name not in names else []
                continue
            skipped.setdefault(problem.label, {})
            check_request(problem.built, optimizer.built, budget, 0, target)
            chosen = preferred_start(problem.built, start)
            label = _label(problem, optimizer, budget, chosen, target)
            repetitions = repetitions_of(optimizer.built, chosen, wanted, is_stochastic(problem.built))
            planned += repetitions.stop - repetitions.start
            check_runs(planned)
            for repetition in repetitions:
                spec = Spec(
                    problem.place, problem.options, optimizer.place, optimizer.options,
                    budget, repetition, chosen, target,
                )  # fmt: skip
                known = run_id(problem.key, optimizer.key, budget, repetition, chosen, target)
                yield known, spec, label, (problem, optimizer)


def _label(problem: _Member, optimizer: _Member, budget: int, start: Start, target: float | None) -> str:
    """Return what a manifest calls a cell: all that its runs share."""
    ends = "" if target is None else f", target {target!r}"
    return f"{problem.label} x {optimizer.label}, budget {budget}, {start} start{ends}"


def _broken_cell(
    problem: _Member, optimizer: _Member, settings: Mapping[str, Any], start: Start | None, target: float | None
) -> Iterator[tuple[str, Spec, str, tuple[_Member, _Member]]]:
    """Yield the runs of a problem or optimiser that cannot be built, which become failed rows: as many as could be."""
    says = {} if problem.broken else getattr(problem.built, "budgets", {})
    worded = problem.broken and isinstance(settings["budget"], str)  # only the problem could tell what the word means
    budget = 0 if worded else read_budget(settings["budget"], problem.name, says)
    chosen = preferred_start(None if problem.broken else problem.built, start)
    label = _label(problem, optimizer, budget, chosen, target)
    for repetition in read_seeds(settings["seeds"]):
        spec = Spec(
            problem.place, problem.options, optimizer.place, optimizer.options, budget, repetition, chosen, target
        )
        known = run_id(problem.key, optimizer.key, budget, repetition, chosen, target)
        yield known, spec, label, (problem, optimizer)


def _unmet_need(problem: _Member, optimizer: _Member, inner: int, limited: bool) -> str:
    """Return what an optimiser that a glob matched needs, or the problem of it does; '' where both were named.

    `limited`: runs have a time limit. What may loop for ever is run without it where it is named, and only there. What
    is not installed is left out where it was matched; named, it makes rows that say so.
    """
    if not (problem.globbed or optimizer.globbed):
        return ""
    traits = getattr(optimizer.built, "traits", None)
    if inner > 1 and optimizer.globbed and not getattr(traits, "batches", False):
        return "batches (execution.inner)"
    if optimizer.globbed and not limited and getattr(traits, "may_hang", False):
        return "time_limit=SECONDS, as it may loop for ever"
    if optimizer.globbed and not _is_there(package := getattr(traits, "package", "")):
        return f"the package {package}, which is not installed here"
    return unmet_need(problem.built, optimizer.built)


def _is_there(package: str) -> bool:
    """Tell whether a package can be found, without importing it."""
    try:
        return not package or find_spec(package) is not None
    except (ImportError, ValueError):  # hidden
        return False


def _members(kind: str, overrides: list[Any]) -> list[_Member]:
    """Return the problems or optimisers of a sweep, each composed with its own options and built."""
    registry = registry_of(kind)
    own = {"problem": "prob", "optimizer": "opt"}[kind]
    named = [choice for o in overrides if o.key_or_group == kind for choice in _choices(kind, o)]
    globbed = dict(named[::-1])  # the first of a name that comes twice counts
    choices = list(dict.fromkeys(name for name, _ in named)) if any(globbed.values()) else [name for name, _ in named]
    if not choices:
        study = last_value(overrides, "study", "")
        near = f"did you mean study={study}.yaml?" if Path(f"{study}.yaml").is_file() else suggest(study, study_names())
        prepared = f" (study={study} is not a prepared one; {near})" if study else ""
        raise RequestError(f"{kind}=NAME is missing{prepared}; {suggest('', _group(kind))}")
    classes = _class_names(choices)
    known = {*choices, *classes.values()}
    addressed = [o.key_or_group.partition(".")[2] for o in overrides if o.key_or_group.startswith(f"{own}.")]
    for name in (a.rpartition(".")[0] for a in addressed if not any(a.startswith(f"{name}.") for name in known)):
        raise RequestError(f"{own}.{name}: {name} is not in this sweep; {suggest(name, choices)}")
    members: list[_Member] = []
    for choice in choices:
        name = _registered_name(kind, choice)
        options = [
            (o.key_or_group.removeprefix(prefix), o)
            for o in overrides
            for prefix in (f"{kind}.", *(f"{own}.{name}." for name in {choice, classes.get(choice, choice)}))
            if o.key_or_group.startswith(prefix)
        ]
        for option, _ in options:
            registry.option(name, option)
        lists = [values_of(o) for _, o in options]
        if len(members) + math.prod(map(len, lists)) > MOST_VALUES:
            raise RequestError(f"these are more than {MOST_VALUES} settings of {kind}s; ask for part of them at a time")
        for values in itertools.product(*lists):
            typed = [(option, value) for (option, _), value in zip(options, values, strict=True)]
            given = [f"{kind}.{option}={value}" for option, value in _gathered(kind, typed).items()]
            composed = dict(compose_texts([f"{kind}={entered(choice)}", *given])[kind])
            composed.pop(REGISTERED)
            declared = registry.options(name)
            missing = [k for k, v in composed.items() if declared[k].required and v == NOT_GIVEN]
            if missing:
                ways = " ".join(f"{kind}.{k}=..." for k in missing)
                way = _way(registry, kind, name)
                told = way if way and kind == "optimizer" else f" (no default); add {ways}{way}"
                raise RequestError(f"{choice} needs {', '.join(missing)}{told}")
            asked = {option.partition(".")[0] for option, _ in typed}
            needed = {k: v for k, v in composed.items() if k in asked or declared[k].required}
            registry.check(name, needed)  # also what equals the default, as true does 1.0
            chosen = {k: v for k, v in composed.items() if declared[k].required or v != plain(declared[k].default)}
            told = registry.told_name(name)
            lost = probe(registry, name, chosen)
            if lost is not None:
                members.append(_unbuilt(kind, name, chosen, globbed[choice], lost))
                continue
            try:
                built = registry.make(name, **chosen)
                key = key_of_problem(built, told) if kind == "problem" else key_of_optimizer(built, told)
            except ValueError:
                raise
            except (Exception, SystemExit) as error:
                way = _way(registry, kind, name)
                raise RequestError(
                    f"{kind} {name} cannot be built: {type(error).__name__}: {text_of(error)}{way}"
                ) from error
            members.append(_Member(told, registry.place(name), chosen, built, key, globbed[choice]))
    return members


def _way(registry: Any, kind: str, name: str) -> str:
    """Return what a function in the place of a class is for; '' where it is a class."""
    if not inspect.isfunction(registry.factory(name)):
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


def _unbuilt(kind: str, name: str, options: Mapping[str, Any], globbed: bool, why: Lost) -> _Member:
    """Return the member whose class cannot be built, named as if it could; `built` is the class."""
    registry = registry_of(kind)
    told = registry.told_name(name)
    key: list[Any] = [told, chosen_options(registry, told, options_as_asked(registry, name, options))]
    key += [""] if kind == "problem" else []
    return _Member(told, registry.place(name), options, registry.factory(name), key, globbed, why)


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
    if choice in registry.names() or ":" in choice:
        enter(kind, choice, registry)
        return choice
    if (CONF / kind / f"{choice}.yaml").is_file():
        return str(compose_texts([f"{kind}={choice}"])[kind][REGISTERED])
    try:
        registry.options(choice)
    except ValueError as error:
        if "unknown" in str(error):
            raise RequestError(f"unknown {kind} {choice!r}; {suggest_or_own(choice, _group(kind))}") from None
        raise
    raise AssertionError(choice)


def _group(kind: str) -> list[str]:
    registry = registry_of(kind)
    return [*registry.names(), *sorted(path.stem for path in (CONF / kind).glob("*.yaml"))]
