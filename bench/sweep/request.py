"""From the command line to a list of runs: Hydra composes, the registries check; nothing runs before all is correct.

Each problem and each optimiser is composed once, not once for each pair: composing takes a tenth of a second.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, final

from calibench.bench.execution.costly import ReplayFolder, check_inner, check_replay
from calibench.bench.execution.request.checks import Start, check_request, preferred_start, repetitions_of, unmet_need
from calibench.bench.execution.run import Spec
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.provenance.code_digest import code_digest
from calibench.bench.provenance.run_id import (
    run_id,
)
from calibench.bench.sweep.called import Cell, called, copies
from calibench.bench.sweep.execution import read_execution
from calibench.bench.sweep.members import Member, members_of
from calibench.bench.sweep.remarks import Asked, remarks_of
from calibench.bench.sweep.studies import is_study_file, study_preset
from calibench.bench.sweep.words.composition import (
    compose,
)
from calibench.bench.sweep.words.hydra_overrides import (
    ONCE,
    check_keys,
    last_value,
    parse,
    products,
    refuse_lists,
    values_of,
)
from calibench.bench.sweep.words.values import (
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
from calibench.core.annotated import as_typed
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
        specs, labels, folder, execution, codes, files, left_out, stop_after, replay, broken, called(cells),
        remarks_of(asked), tuple(copies(cells.values())), max(_seeds_asked(sweep) for sweep in sweeps), other_shards,
        {label: cell.budget for label, cell in cells.items()},
    )  # fmt: skip


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
    member = members_of(kind, overrides)[0]
    if member.broken is not None:
        raise RequestError(f"{kind} {member.name} cannot be built: {member.broken.error}")
    return member.built


def _left_out(skipped: _Skipped) -> tuple[str, ...]:
    """Return what was skipped as lines: methods, what they need, and where that is not so of all problems, of which."""
    every, lacking = set(skipped), dict[str, list[str]]()
    for problem, needed in skipped.items():
        for needs, names in needed.items():
            told = f"{_methods(names)} {'needs' if len(names) == 1 else 'need'} {needs}"
            lacking.setdefault(told, []).append(problem)
    return tuple(
        f"{told}: skipped" if set(where) == every else f"{told}: skipped on {', '.join(where)}"
        for told, where in lacking.items()
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
            _check_cell(problem, optimizer, budget, target)
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


def _check_cell(problem: Member, optimizer: Member, budget: int, target: float | None) -> None:
    """Raise `ValueError` where a method cannot be run on a problem, with the options that were given."""
    try:
        check_request(problem.built, optimizer.built, budget, 0, target)
    except ValueError as error:
        given = [member.asked for member in (problem, optimizer) if member.options]
        raise RequestError(f"{error} ({'; '.join(given)})" if given else str(error)) from error


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
            problem.place, problem.options, optimizer.place, optimizer.options, budget, repetition, chosen, target
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
