"""From the command line to a list of runs: Hydra composes, the registries check; nothing runs before all is correct.

Each problem and each optimiser of a sweep is a `Member`: a registered name, a preset of ``conf/``, a user's class, or
what a glob matches, composed with its own options and built once, not once for each pair: composing takes a tenth of a
second. Cells are called on the terminal as tables call their problems and methods.
"""

from __future__ import annotations

import inspect
import itertools
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from json import dumps
from pathlib import Path
from typing import Any, final

from calibench import problems
from calibench.bench.execution.costly import ReplayFolder, check_inner, check_replay
from calibench.bench.execution.request import (
    Start,
    check_request,
    foreign_modules,
    preferred_start,
    probe,
    repetitions_of,
    unmet_need,
)
from calibench.bench.execution.run import Spec
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.gate.endings import text_of
from calibench.bench.gate.processes import Lost
from calibench.bench.provenance.code_digest import code_digest
from calibench.bench.provenance.run_id import (
    canonical,
    chosen_options,
    key_of_optimizer,
    key_of_problem,
    options_as_asked,
    run_id,
)
from calibench.bench.statistics.cells import SETTING
from calibench.bench.statistics.names import setting_text, several, titles_of_problems
from calibench.bench.statistics.summary import method_name, names_of_methods, problem_name
from calibench.bench.sweep.composition import (
    CONF,
    MOST_VALUES,
    NOT_GIVEN,
    ONCE,
    REGISTERED,
    as_annotated,
    check_keys,
    compose,
    compose_texts,
    enter,
    entered,
    in_ascii,
    last_value,
    parse,
    plain,
    products,
    refuse_lists,
    registry_of,
    values_of,
)
from calibench.bench.sweep.execution import read_execution
from calibench.bench.sweep.remarks import Asked, remarks_of
from calibench.bench.sweep.studies import is_study_file, near_study, study_names, study_preset
from calibench.bench.sweep.words import (
    PlainOverride,
    RequestError,
    check_runs,
    check_study,
    read_budget,
    read_replay,
    read_seeds,
    read_shard,
    read_start,
    read_stop_after,
    read_target,
    read_time_limit,
)
from calibench.core.options import as_typed, shown, suggest
from calibench.core.own_state import kept
from calibench.core.registry import UnknownName, beside, suggest_or_own
from calibench.problems.base import extra_of


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
    remarks: tuple[str, ...] = ()  # goals out of reach and budgets that a first sample uses up, a line each
    copies: tuple[str, ...] = ()  # problems that are one problem under several seeds of their data, a line each
    seeds: int = 1  # the most repetitions that are asked for of a cell
    other_shards: frozenset[str] = frozenset()  # ids of the runs that other shards do
    budgets: Mapping[str, int] = field(default_factory=dict)  # label -> budget of the cell


_NAMED = 8  # methods that a line on what a glob skips still names
_Skipped = dict[str, dict[str, list[str]]]  # problem -> what is needed -> who needs it, for every problem of a sweep


def read_request(arguments: Sequence[str], multirun: bool) -> Request:
    """Return the runs that `arguments` (Hydra overrides) ask for. Raises `RequestError` or `ValueError`."""
    study, sweeps, once = _sweeps(arguments, multirun)
    try:
        return _request_of(study, sweeps, once)
    except RequestError as error:
        message = str(error)
        for o in (o for sweep in sweeps for o in sweep if not o.is_sweep_override()):
            message = as_typed(
                message, o.key_or_group, getattr(o.value(), "text", o.value()), o.input_line.partition("=")[2]
            )
        raise RequestError(message) from error


def _request_of(study: str, sweeps: list[list[Any]], once: list[Any]) -> Request:
    """Return the runs of all sweeps."""
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
    asked: list[Asked] = []
    every: list[Member] = []  # kept alive, so that no new object gets the id of an old one
    for sweep in sweeps:
        for spec_id, spec, label, members in _expand(sweep, skipped, inner, time_limit is not None):
            if labels.setdefault(spec_id, label) != label:
                raise RequestError(f"two cells have one run id, {spec_id}: {labels[spec_id]}; and {label}")
            if label not in cells:
                cells[label] = Cell(members[0].key, members[1].key, spec.budget, spec.start, spec.target)
                if all(member.broken is None for member in members):
                    problem, method = members
                    asked.append((problem.asked, problem.built, method.asked, method.built, spec.budget, spec.target))
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
    other_shards = frozenset(labels.keys() - specs.keys())
    labels = {spec_id: labels[spec_id] for spec_id in specs}
    execution = settings["execution"]
    return Request(
        specs=specs,
        labels=labels,
        folder=folder,
        execution=execution,
        codes=codes,
        files=files,
        left_out=left_out,
        stop_after=stop_after,
        replay=replay,
        broken=broken,
        called=called(cells),
        remarks=remarks_of(asked),
        copies=tuple(copies(cells.values())),
        seeds=max(_seeds_asked(sweep) for sweep in sweeps),
        other_shards=other_shards,
        budgets={label: cell.budget for label, cell in cells.items()},
    )


def _sweeps(arguments: Sequence[str], multirun: bool) -> tuple[str, list[list[Any]], list[Any]]:
    """Return the name of the study, its sweeps as overrides, and those overrides that are the same for all runs."""
    overrides = parse(arguments)
    study = last_value(overrides, "study", "adhoc")
    preset = study_preset(study)
    if is_study_file(study):
        study = Path(study).stem
    check_study(study)
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
    of_all = [{o.input_line: o for o in sweep if o.key_or_group.partition(".")[0] in ONCE} for sweep in sweeps]
    for line in (line for words in of_all for line in words if any(line not in others for others in of_all)):
        raise RequestError(f"{line}: stands in one sweep and is for all of the study; write it beside sweeps:")
    once = list(of_all[0].values())
    for o in once:
        if o.is_sweep_override():
            raise RequestError(f"{o.input_line}: one value is needed, it is the same for all runs")
    return study, sweeps, once


def _besides(shared: Mapping[str, Any], sweep: Sequence[str]) -> list[str]:
    """Return what the sweeps of a study share as words, without those that a sweep says itself."""
    own = {word.partition("=")[0] for word in sweep}
    return [f"{key}={value}" for key, value in shared.items() if key not in own]


def _seeds_asked(overrides: Sequence[Any]) -> int:
    """Return the most repetitions of a cell that a sweep asks for."""
    words = [[f"seeds={value}"] for o in overrides if o.key_or_group == "seeds" for value in values_of(o)]
    return max(len(read_seeds(compose(word)["seeds"])) for word in words or [[]])


def build_member(kind: str, arguments: Sequence[str]) -> Any:
    """Return the one problem or optimiser (`kind`) that `arguments` name, with its options."""
    overrides = parse(arguments)
    refuse_lists(overrides)
    member = members_of(kind, overrides)[0]
    if member.broken is not None:
        raise RequestError(f"{kind} {member.name} cannot be built: {member.broken.error}")
    return member.built


def _left_out(skipped: _Skipped) -> tuple[str, ...]:
    """Return what was skipped as lines: methods, what they need, and where that is not so of all problems, of which."""
    every, lacking = set(skipped), dict[str, list[str]]()
    for problem, needed in skipped.items():
        for needs, names in needed.items():
            lack = f"{_methods(names)} {'needs' if len(names) == 1 else 'need'} {needs}"
            lacking.setdefault(lack, []).append(problem)
    return tuple(
        f"{lack}: skipped" if set(where) == every else f"{lack}: skipped on {', '.join(where)}"
        for lack, where in lacking.items()
    )


def _methods(names: Sequence[str]) -> str:
    """Return the names of methods; of many, their number and where their traits are told."""
    if len(names) <= _NAMED:
        return ", ".join(names)
    return f"{len(names)} methods that the glob matches (`bench list optimizers` has the traits of each)"


def _expand(
    overrides: list[Any], skipped: _Skipped, inner: int, limited: bool
) -> Iterator[tuple[str, Spec, str, tuple[Member, Member]]]:
    """Yield (run id, spec, label, problem and optimiser) of one sweep; note in `skipped` what a glob's methods lack."""
    check_keys(overrides)
    pairs = members_of("problem", overrides), members_of("optimizer", overrides)
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
            budget = read_budget(settings["budget"], problem.name, extra_of(problem.built, "budgets", {}))
            wanted = read_seeds(settings["seeds"])
            needs = _unmet_need(problem, optimizer, inner, limited)
            if needs:  # a glob means all methods that can run; a method that is named must run
                names = skipped.setdefault(problem.label, {}).setdefault(needs, [])
                names += [optimizer.name] if optimizer.name not in names else []
                continue
            skipped.setdefault(problem.label, {})
            try:
                check_request(problem.built, optimizer.built, budget, 0, target)
            except ValueError as error:
                given = [member.asked for member in (problem, optimizer) if member.options]
                raise RequestError(f"{error} ({'; '.join(given)})" if given else str(error)) from error
            chosen = preferred_start(problem.built, start)
            label = _label(problem, optimizer, budget, chosen, target)
            repetitions = repetitions_of(optimizer.built, chosen, wanted, is_stochastic(problem.built))
            planned += repetitions.stop - repetitions.start
            check_runs(planned)
            for repetition in repetitions:
                spec = Spec(
                    problem=problem.place,
                    problem_options=problem.options,
                    optimizer=optimizer.place,
                    optimizer_options=optimizer.options,
                    budget=budget,
                    repetition=repetition,
                    start=chosen,
                    target=target,
                )
                known = run_id(problem.key, optimizer.key, budget, repetition, chosen, target)
                yield known, spec, label, (problem, optimizer)


def _label(problem: Member, optimizer: Member, budget: int, start: Start, target: float | None) -> str:
    """Return what a manifest calls a cell: all that its runs share."""
    ends = "" if target is None else f", target {target!r}"
    return f"{problem.label} x {optimizer.label}, budget {budget}, {start} start{ends}"


def _broken_cell(
    problem: Member, optimizer: Member, settings: Mapping[str, Any], start: Start | None, target: float | None
) -> Iterator[tuple[str, Spec, str, tuple[Member, Member]]]:
    """Yield the runs of a problem or optimiser that cannot be built, which become failed rows: as many as could be."""
    says = {} if problem.broken else extra_of(problem.built, "budgets", {})
    # only the problem, which cannot be built, could tell what the word means
    worded = problem.broken and isinstance(settings["budget"], str)
    budget = 0 if worded else read_budget(settings["budget"], problem.name, says)
    chosen = preferred_start(None if problem.broken else problem.built, start)
    label = _label(problem, optimizer, budget, chosen, target)
    for repetition in read_seeds(settings["seeds"]):
        spec = Spec(
            problem=problem.place,
            problem_options=problem.options,
            optimizer=optimizer.place,
            optimizer_options=optimizer.options,
            budget=budget,
            repetition=repetition,
            start=chosen,
            target=target,
        )
        known = run_id(problem.key, optimizer.key, budget, repetition, chosen, target)
        yield known, spec, label, (problem, optimizer)


def _unmet_need(problem: Member, optimizer: Member, inner: int, limited: bool) -> str:
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
        texts = [f"{key}={value if isinstance(value, str) else dumps(value)}" for key, value in options]
        return f"{self.name} ({', '.join(texts)})" if texts else self.name


def members_of(kind: str, overrides: list[Any]) -> list[Member]:
    """Return the problems or optimisers of a sweep, each composed with its own options and built."""
    registry = registry_of(kind)
    own = {"problem": "prob", "optimizer": "opt"}[kind]
    named = [choice for o in overrides if o.key_or_group == kind for choice in _choices(kind, o)]
    globbed = dict(named[::-1])  # the first of a name that comes twice counts
    choices = list(dict.fromkeys(name for name, _ in named)) if any(globbed.values()) else [name for name, _ in named]
    if not choices:
        # the message for a request without a problem or an optimiser; a study that is not one may be why
        study = last_value(overrides, "study", "")
        file = near_study(study) if study else ""
        near = f"did you mean study={file}?" if file else suggest(study, study_names())
        prepared = f" (study={study} is not a prepared one; {near})" if study else ""
        names = _group(kind)
        raise RequestError(
            f"{kind}=NAME is missing{prepared}, such as {', '.join(names[:_SHOWN])}; `bench list {kind}s` lists all "
            f"{len(names)}, and FILE.py:CLASS is yours"
        )
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
        remedy = way if way and kind == "optimizer" else f" (no default); add {ways}{way}"
        raise RequestError(f"{choice} needs {', '.join(missing)}{remedy}")
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
    row_name = registry.told_name(name)
    lost = probe(registry, name, chosen)
    if lost is not None:
        return _unbuilt(kind, name, chosen, globbed, lost)
    try:
        place = registry.place(name)  # found in any working folder
        with kept(*foreign_modules(registry, place)):
            built = registry.make(place, **chosen)
        key = key_of_problem(built, row_name) if kind == "problem" else key_of_optimizer(built, row_name)
    except ValueError:
        raise
    except (Exception, SystemExit) as error:
        way = _way(kind, name)
        given = ", ".join(f"{option}={shown(value)}" for option, value in chosen.items())
        message = f"{kind} {name} cannot be built: {type(error).__name__}: {text_of(error)}{way}"
        raise RequestError(f"{message}{given and f' (it was given {given})'}") from error
    return Member(row_name, registry.place(name), chosen, built, key, globbed)


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
    row_name = registry.told_name(name)
    key: list[Any] = [row_name, chosen_options(registry, row_name, options_as_asked(registry, name, options))]
    key += [""] if kind == "problem" else []
    return Member(row_name, registry.place(name), options, registry.factory(name), key, globbed, why)


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


_BESIDE = 200  # problems or methods: up to so many, each is named by the options in which it differs from the others


@final
@dataclass(frozen=True, eq=False)
class Cell:
    """One cell as it is asked for: the keys of its problem and its method (name, options, ...), and its setting."""

    problem: Sequence[Any]
    optimizer: Sequence[Any]
    budget: int
    start: Any
    target: float | None


def called(cells: Mapping[str, Cell]) -> dict[str, str]:
    """Return label -> what its cell is called beside the others of the sweep; the label where two would be the same.

    A start, a budget and a target are told where the sweep has several.
    """
    settings = {name: [getattr(cell, name) for cell in cells.values()] for name in SETTING}
    swept = several(settings)
    problems_of = [_problem(cell) for cell in cells.values()]
    methods_of = [(str(cell.optimizer[0]), canonical(cell.optimizer[1])) for cell in cells.values()]
    few = len({(name, options) for name, options, _ in problems_of}) <= _BESIDE
    titles = titles_of_problems(problems_of) if few else [problem_name(name, given) for name, given, _ in problems_of]
    few = len(set(methods_of)) <= _BESIDE
    methods = names_of_methods(methods_of) if few else [method_name(*pair) for pair in methods_of]
    names = {}
    for label, problem, method, *values in zip(cells, titles, methods, *settings.values(), strict=True):
        of_cell = dict(zip(SETTING, values, strict=True))
        names[label] = ", ".join([f"{method} on {problem}", *(setting_text(name, of_cell[name]) for name in swept)])
    count = Counter(names.values())
    return {label: name if count[name] == 1 else label for label, name in names.items()}


def _problem(cell: Cell) -> tuple[str, str, str]:
    name, options, *data = cell.problem
    return name, canonical(options), str(data[0]) if data else ""


def copies(cells: Iterable[Cell]) -> list[str]:
    """Return a line for each problem that a sweep asks for with several seeds of its data, which are the same with all.

    Without noise, and on a plan that is not random, a seed changes nothing. A test would count such problems as several
    blocks, and they are one.
    """
    found: dict[str, set[str]] = {}
    for cell in cells:
        name, options, data = _problem(cell)
        chosen = json.loads(options)
        seed = {key: chosen.pop(key) for key in ("data_seed", "seed") if key in chosen}
        if data and name in problems.registry:
            found.setdefault(canonical({"problem": name, "data": data, **chosen}), set()).add(canonical(seed))
    lines = {
        f"{json.loads(key)['problem']}: its {len(seeds)} data seeds draw nothing (no noise, a fixed plan): they are "
        "one problem, not several": None
        for key, seeds in found.items()
        if len(seeds) > 1
    }
    return list(lines)
