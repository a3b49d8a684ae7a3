"""From the command line to a list of runs: Hydra composes, the registries check; nothing runs before all is correct.

Each problem and each optimiser of a sweep is a `Member`: a registered name, a preset of ``conf/``, a user's class, or
what a glob matches, composed with its own options and built once, not once for each pair: composing takes a tenth of a
second. Cells are called on the terminal as tables call their problems and methods.
"""

from __future__ import annotations

import difflib
import inspect
import itertools
import json
import math
import signal
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from json import dumps
from pathlib import Path
from typing import Any, final

from calibench import problems
from calibench.bench.execution import request as asking
from calibench.bench.execution.costly import ReplayFolder, check_costly
from calibench.bench.execution.request import is_stochastic
from calibench.bench.execution.run import Spec
from calibench.bench.gate.endings import text_of
from calibench.bench.gate.processes import Lost
from calibench.bench.provenance import run_id as ids
from calibench.bench.provenance.code_digest import code_digest
from calibench.bench.statistics.cells import SETTING
from calibench.bench.statistics.names import setting_text, several, titles_of_problems
from calibench.bench.statistics.summary import method_name, names_of_methods, problem_name
from calibench.bench.sweep import composition as hydra
from calibench.bench.sweep.composition import is_study_file, study_names, study_preset
from calibench.bench.sweep.remarks import Asked, remarks_of
from calibench.bench.sweep.words import PlainOverride, check_runs, read_budget, read_execution, read_once, read_seeds
from calibench.bench.words import RequestError, check_study
from calibench.core.options import as_typed, coerce, shown, suggest, unquoted
from calibench.core.own_state import kept
from calibench.core.registry import UnknownName, beside
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
    overrides = hydra.parse(arguments)
    study = hydra.last_value(overrides, "study", "adhoc")
    preset = study_preset(study)
    if is_study_file(study):
        study = Path(study).stem
    check_study(study)

    # the sweeps of the study, as overrides
    if preset is None:
        sweeps = [overrides]
        if not multirun:
            hydra.refuse_lists(overrides)
    else:
        given = {o.key_or_group for o in overrides}
        shared = {key: value for key, value in preset.items() if key not in {"description", "sweeps", *given}}
        sweeps = []
        for sweep in preset["sweeps"]:
            own = {word.partition("=")[0] for word in sweep}
            words = [*(f"{key}={value}" for key, value in shared.items() if key not in own), *sweep]
            sweeps.append([*(o for o in hydra.parse(words) if o.key_or_group not in given), *overrides])

    # those overrides that are the same for all runs
    of_all = [{o.input_line: o for o in sweep if o.key_or_group.partition(".")[0] in hydra.ONCE} for sweep in sweeps]
    for line in (line for lines in of_all for line in lines if any(line not in others for others in of_all)):
        raise RequestError(f"{line}: stands in one sweep and is for all of the study; write it beside sweeps:")
    once = list(of_all[0].values())
    for o in once:
        if o.is_sweep_override():
            raise RequestError(f"{o.input_line}: one value is needed, it is the same for all runs")
    try:
        return _request_of(study, sweeps, once)
    except RequestError as error:
        message = str(error)
        for o in (o for sweep in sweeps for o in sweep if not o.is_sweep_override()):
            value = getattr(o.value(), "text", o.value())
            message = as_typed(message, o.key_or_group, value, o.input_line.partition("=")[2])
        raise RequestError(message) from error


def _request_of(study: str, sweeps: list[list[Any]], once: list[Any]) -> Request:
    settings = hydra.compose([f"{o.key_or_group}={hydra.values_of(o)[0]}" for o in once])
    of_all, inner = read_once(settings), read_execution(settings["execution"]).inner
    folder = Path(str(settings["results"])) / study
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
        for spec_id, spec, label, members in _expand(sweep, skipped, inner, of_all.time_limit):
            problem, method = members
            lost = problem.broken or method.broken
            if labels.setdefault(spec_id, label) != label:
                raise RequestError(f"two cells have one run id, {spec_id}: {labels[spec_id]}; and {label}")
            if label not in cells:
                cells[label] = Cell(problem.key, method.key, spec.budget, spec.start, spec.target)
                if lost is None:
                    asked.append((problem.asked, problem.built, method.asked, method.built, spec.budget, spec.target))
            if int(spec_id, 16) % of_all.shards != of_all.shard - 1:
                continue
            if of_all.time_limit is not None:
                spec = replace(spec, time_limit=of_all.time_limit)
            specs.setdefault(spec_id, spec)
            pair = id(problem), id(method)
            if pair not in digests:
                digests[pair] = code_digest(problem.built, method.built)
                every += members
                files |= {m.name: m.place.rpartition(":")[0] for m in members if m.place != m.name}
                if lost is None:
                    check_costly(problem.built, method.built, inner, ReplayFolder(folder, of_all.replay is True))
            codes[spec_id] = digests[pair]
            if lost is not None:
                broken[spec_id] = lost.error_type, lost.error
    # what was skipped as lines: methods, what they need, and where that is not so of all problems, of which
    lacking = dict[str, list[str]]()
    for skipped_on, needed in skipped.items():
        for needs, names in needed.items():
            methods = ", ".join(names)
            if len(names) > _NAMED:
                methods = f"{len(names)} methods that the glob matches (`bench list optimizers` has the traits of each)"
            lacking.setdefault(f"{methods} {'needs' if len(names) == 1 else 'need'} {needs}", []).append(skipped_on)
    on = {lack: "" if set(where) == set(skipped) else f" on {', '.join(where)}" for lack, where in lacking.items()}
    left_out = tuple(f"{lack}: skipped{where}" for lack, where in on.items())
    if not labels:
        if not left_out:
            raise RequestError("nothing to run: a list or range of this sweep is empty")
        why = "; ".join(left_out)
        raise RequestError(f"nothing to run: no optimizer that glob(...) matches can run these problems; {why}")
    # the most repetitions of a cell that are asked for
    words = [[f"seeds={v}"] for sweep in sweeps for o in sweep if o.key_or_group == "seeds" for v in hydra.values_of(o)]
    usual: list[list[str]] = [[] for sweep in sweeps if all(o.key_or_group != "seeds" for o in sweep)]
    return Request(
        specs=specs, labels={spec_id: labels[spec_id] for spec_id in specs}, folder=folder,
        execution=settings["execution"], codes=codes, files=files, left_out=left_out, stop_after=of_all.stop_after,
        replay=of_all.replay, broken=broken, called=called(cells), remarks=remarks_of(asked),
        copies=tuple(copies(cells.values())), other_shards=frozenset(labels.keys() - specs.keys()),
        seeds=max(len(read_seeds(hydra.compose(word)["seeds"])) for word in (*words, *usual)),
        budgets={label: cell.budget for label, cell in cells.items()},
    )  # fmt: skip


def _expand(
    overrides: list[Any], skipped: _Skipped, inner: int, time_limit: float | None
) -> Iterator[tuple[str, Spec, str, tuple[Member, Member]]]:
    """Yield (run id, spec, label, problem and optimiser) of one sweep; note in `skipped` what a glob's methods lack."""
    for o in overrides:
        head = o.key_or_group.partition(".")[0]
        if o.key_or_group in hydra.KEYS or head in ("problem", "optimizer", "execution"):
            continue
        if head in ("prob", "opt") and o.key_or_group.count(".") >= 2:
            continue
        if head in ("prob", "opt"):  # as the tables call it, with the name of whose option it is between
            group = "problem" if head == "prob" else "optimizer"
            option = o.key_or_group.partition(".")[2] or "OPTION"
            both = f"{group}.{option}= is that of every {group}, {head}.NAME.{option}= of one"
            raise RequestError(f"unknown argument {o.key_or_group!r}; {both}")
        if head in ("n_jobs", "inner", "address"):
            raise RequestError(f"unknown argument {o.key_or_group!r}; did you mean 'execution.{head}'?")
        raise RequestError(
            f"unknown argument {o.key_or_group!r}; {suggest(head, [*hydra.KEYS, 'prob.NAME', 'opt.NAME'])}"
        )
    pairs = members_of("problem", overrides, time_limit), members_of("optimizer", overrides, time_limit)
    rest = [o for o in overrides if o.key_or_group in ("budget", "seeds", "start", "target")]
    check_runs(math.prod(map(len, pairs)) * math.prod(len(hydra.values_of(o)) for o in rest))
    cells, planned = list(itertools.product(*pairs)), 0
    for values in itertools.product(*(hydra.values_of(o) for o in rest)):
        settings = hydra.compose([f"{o.key_or_group}={value}" for o, value in zip(rest, values, strict=True)])
        start, target = settings["start"], settings["target"]  # None: what the problem prefers; None: no target
        if start not in (None, "nominal", "random"):
            raise RequestError(f"start={shown(start)}: {suggest(shown(start), ['nominal', 'random'])}")
        try:
            target = None if target is None else coerce("target", target, float)
        except ValueError:
            raise RequestError(f"target={shown(target)}: a number is needed") from None
        for problem, optimizer in cells:
            built = None if problem.broken else problem.built
            says = {} if built is None else extra_of(built, "budgets", {})
            # of a problem that cannot be built nobody knows what the word means
            worded = built is None and isinstance(settings["budget"], str)
            budget = 0 if worded else read_budget(settings["budget"], problem.name, says)
            repetitions, chosen = read_seeds(settings["seeds"]), asking.preferred_start(built, start)
            if not (problem.broken or optimizer.broken):
                needs = _unmet_need(problem, optimizer, inner, time_limit is not None)
                lacking = skipped.setdefault(problem.label, {})
                if needs:  # a glob means all methods that can run; a method that is named must run
                    names = lacking.setdefault(needs, [])
                    names += [optimizer.name] if optimizer.name not in names else []
                    continue
                try:
                    asking.check_pair(built, optimizer.built)
                    asking.check_numbers(budget, 0, target, problem=built)
                except ValueError as error:
                    given = [member.asked for member in (problem, optimizer) if member.options]
                    raise RequestError(f"{error} ({'; '.join(given)})" if given else str(error)) from error
                repetitions = asking.repetitions_of(optimizer.built, chosen, repetitions, is_stochastic(built))
                planned += repetitions.stop - repetitions.start
                check_runs(planned)
            ends = "" if target is None else f", target {target!r}"
            # what a manifest calls a cell: all that its runs share
            label = f"{problem.label} x {optimizer.label}, budget {budget}, {chosen} start{ends}"
            for repetition in repetitions:
                spec = Spec(
                    problem=problem.place, problem_options=problem.options, optimizer=optimizer.place,
                    optimizer_options=optimizer.options, budget=budget, repetition=repetition, start=chosen,
                    target=target,
                )  # fmt: skip
                known = ids.run_id(problem.key, optimizer.key, budget, repetition, chosen, target)
                yield known, spec, label, (problem, optimizer)


def _unmet_need(problem: Member, optimizer: Member, inner: int, limited: bool) -> str:
    """Return what an optimiser that a glob matched needs, or the problem of it does; '' where both were named."""
    if not (problem.globbed or optimizer.globbed):
        return ""
    traits = getattr(optimizer.built, "traits", None)
    if inner > 1 and optimizer.globbed and not getattr(traits, "batches", False):
        return "batches (execution.inner)"
    if optimizer.globbed and not limited and getattr(traits, "may_hang", False):
        return "time_limit=SECONDS, as it may loop for ever"
    package = getattr(traits, "package", "")
    if optimizer.globbed and package:
        try:
            is_there = find_spec(package) is not None  # without importing it
        except (ImportError, ValueError):  # hidden
            is_there = False
        if not is_there:
            return f"the package {package}, which is not installed here"
    return asking.unmet_need(problem.built, optimizer.built)


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


def members_of(kind: str, overrides: list[Any], time_limit: float | None = None) -> list[Member]:
    """Return the problems or optimisers of a sweep, each composed with its own options and built in its time."""
    registry = hydra.registry_of(kind)
    own = {"problem": "prob", "optimizer": "opt"}[kind]
    named = [choice for o in overrides if o.key_or_group == kind for choice in _choices(kind, o)]
    globbed = dict(named[::-1])  # the first of a name that comes twice counts
    choices = list(dict.fromkeys(name for name, _ in named)) if any(globbed.values()) else [name for name, _ in named]
    if not choices:
        # the message for a request without a problem or an optimiser; a study that is not one may be why
        study = hydra.last_value(overrides, "study", "")
        files = {path.name: path for path in sorted(Path().glob("*.y*ml"))} if study else {}
        close = difflib.get_close_matches(study, [*files, *(path.stem for path in files.values())], n=1)
        file = next((file for file, path in files.items() if close and close[0] in (file, path.stem)), "")
        near = f"did you mean study={file}?" if file else suggest(study, study_names())
        prepared = f" (study={study} is not a prepared one; {near})" if study else ""
        every = _group(kind)
        raise RequestError(
            f"{kind}=NAME is missing{prepared}, such as {', '.join(every[:_SHOWN])}; `bench list {kind}s` lists all "
            f"{len(every)}, and FILE.py:CLASS is yours"
        )
    # the name of its class, of choices in files, where no other choice is called so
    names = {choice: choice.rpartition(":")[2] for choice in choices if ":" in choice}
    counts = Counter([*choices, *names.values()])
    classes = {choice: name for choice, name in names.items() if counts[name] == 1}
    known = {*choices, *classes.values()}
    addressed = [o.key_or_group.partition(".")[2] for o in overrides if o.key_or_group.startswith(f"{own}.")]
    for name in (a.rpartition(".")[0] for a in addressed if not any(a.startswith(f"{name}.") for name in known)):
        raise RequestError(f"{own}.{name}: {name} is not in this sweep; {suggest(name, choices)}")
    members: list[Member] = []
    for choice in choices:
        with _ended_after(max(asking.PATIENCE, time_limit or 0.0)):
            name = _registered_name(kind, choice)
        options = [
            (o.key_or_group.removeprefix(prefix), o)
            for o in overrides
            for prefix in (f"{kind}.", *(f"{own}.{name}." for name in {choice, classes.get(choice, choice)}))
            if o.key_or_group.startswith(prefix)
        ]
        annotated = ((o, registry.option(name, option).annotation) for option, o in options)
        lists = [hydra.values_of(hydra.as_annotated(o, annotation)) for o, annotation in annotated]
        if len(members) + math.prod(map(len, lists)) > hydra.MOST_VALUES:
            raise RequestError(
                f"these are more than {hydra.MOST_VALUES} settings of {kind}s; ask for part of them at a time"
            )
        for values in itertools.product(*lists):
            typed = [(option, value) for (option, _), value in zip(options, values, strict=True)]
            given = [f"{kind}.{option}={value}" for option, value in _gathered(kind, typed).items()]
            composed = dict(hydra.compose([f"{kind}={hydra.entered(choice)}", *given])[kind])
            composed.pop(hydra.REGISTERED)
            asked = {option.partition(".")[0] for option, _ in typed}
            written = {option: o.input_line.partition("=")[2] for option, o in options if not o.is_sweep_override()}
            chosen = _chosen_options(kind, choice, name, composed, asked, written)
            members.append(_member(kind, name, chosen, globbed[choice], time_limit))
    return members


def _chosen_options(
    kind: str, choice: str, name: str, composed: Mapping[str, Any], asked: set[str], written: Mapping[str, str]
) -> dict[str, Any]:
    """Return the options that a member is built with: those required, and those that differ from their defaults."""
    registry = hydra.registry_of(kind)
    declared = registry.options(name)
    missing = [k for k, v in composed.items() if declared[k].required and v == hydra.NOT_GIVEN]
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
    return {k: v for k, v in composed.items() if declared[k].required or v != hydra.plain(declared[k].default)}


def _member(kind: str, name: str, chosen: dict[str, Any], globbed: bool, time_limit: float | None) -> Member:
    """Return a problem or an optimiser, built, with its key; or the one that could not be built, with the reason."""
    registry = hydra.registry_of(kind)
    row_name = registry.told_name(name)
    lost = asking.probe(registry, name, chosen, time_limit)
    if lost is not None:
        options = ids.chosen_options(registry, row_name, ids.options_as_asked(registry, name, chosen))
        key: list[Any] = [row_name, options, *([""] if kind == "problem" else [])]
        return Member(row_name, registry.place(name), chosen, registry.factory(name), key, globbed, lost)
    try:
        place = registry.place(name)  # found in any working folder
        with kept(*asking.foreign_modules(registry, place)):
            built = registry.make(place, **chosen)
        key = ids.key_of_problem(built, row_name) if kind == "problem" else ids.key_of_optimizer(built, row_name)
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
    if not inspect.isfunction(hydra.registry_of(kind).factory(name)):
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
        gathered = _gathered(f"{kind}.{first}", parts)
        found[first] = "{" + ",".join(f"{hydra.in_ascii(k)}: {v}" for k, v in gathered.items()) + "}"
    return found


def _choices(kind: str, override: Any) -> list[tuple[str, bool]]:
    """Return the names an override chooses and whether a glob did; lm,glob(nlopt_*) is lm and all that match."""
    if isinstance(override, PlainOverride):
        return [(text, False) for text in hydra.values_of(override)]
    from hydra.core.override_parser.types import ChoiceSweep, Glob

    value = override.value()
    parts = value.list if isinstance(value, ChoiceSweep) else [value] if isinstance(value, Glob) else []
    if not any(isinstance(part, Glob) for part in parts):
        return [(unquoted(text).replace("\\", ""), False) for text in hydra.values_of(override)]
    chosen: list[tuple[str, bool]] = []
    registered = hydra.registry_of(kind).names()
    for part in parts:
        names = part.filter(registered) if isinstance(part, Glob) else [str(getattr(part, "text", part))]
        if not names:
            raise RequestError(f"{override.input_line}: matches no {kind}; {suggest('', _group(kind))}")
        chosen += [(unquoted(name), isinstance(part, Glob)) for name in names]
    return chosen


@contextmanager
def _ended_after(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` in a block that imports a user's module and does not end, where a timer can end it."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        raise TimeoutError(f"it did not end within {seconds:g} s; a longer time_limit= gives it more")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _registered_name(kind: str, choice: str) -> str:
    """Return the registry's name of a choice: itself, or what a preset of ``conf/<kind>/`` is made from."""
    registry = hydra.registry_of(kind)
    if choice in registry or ":" in choice:
        hydra.enter(kind, choice, registry)
        return choice
    if any(path.stem == choice for path in (hydra.CONF / kind).glob("*.yaml")):
        return str(hydra.compose([f"{kind}={choice}"])[kind][hydra.REGISTERED])
    try:
        registry.options(choice)
    except UnknownName:
        advice = suggest(choice, _group(kind))
        own = "" if advice.startswith("did you mean") else "a class of your own is FILE.py:CLASS or MODULE:CLASS; "
        raise RequestError(f"unknown {kind} {choice!r}; {beside(kind, choice)}{own}{advice}") from None
    raise AssertionError(choice)


def _group(kind: str) -> list[str]:
    registry = hydra.registry_of(kind)
    return [*registry.names(), *sorted(path.stem for path in (hydra.CONF / kind).glob("*.yaml"))]


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
    """Return label -> what its cell is called beside the others of the sweep; the label where two would be the same."""
    settings = {name: [getattr(cell, name) for cell in cells.values()] for name in SETTING}
    swept = several(settings)
    problems_of = [_problem(cell) for cell in cells.values()]
    methods_of = [(str(cell.optimizer[0]), ids.canonical(cell.optimizer[1])) for cell in cells.values()]
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
    return name, ids.canonical(options), str(data[0]) if data else ""


def copies(cells: Iterable[Cell]) -> list[str]:
    """Return a line for each problem that is asked for with several seeds of its data, which are the same with all."""
    found: dict[str, set[str]] = {}
    for cell in cells:
        name, options, data = _problem(cell)
        chosen = json.loads(options)
        seed = {key: chosen.pop(key) for key in ("data_seed", "seed") if key in chosen}
        if data and name in problems.registry:
            found.setdefault(ids.canonical({"problem": name, "data": data, **chosen}), set()).add(ids.canonical(seed))
    why = "draw nothing (no noise, a fixed plan): they are one problem, not several"
    names = [(json.loads(key)["problem"], len(seeds)) for key, seeds in found.items() if len(seeds) > 1]
    return list(dict.fromkeys(f"{name}: its {count} data seeds {why}" for name, count in names))
