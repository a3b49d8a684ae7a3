"""`bench discover` and `bench design`, and `discover` from Python: the requests, and the searches, a folder a set.

A set that was searched before with the same data, options and code is not searched again. What cannot be read, or
fails, is a report with an `error`; the others go on. To each finding with rivals comes the measurement that separates
them, further poses or a second sensor: their distance follows from the data themselves
(`discrepancy.design.next_poses`). `designed` says what data or a plan can show before anything is fitted.
"""

import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic, process_time
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np

from calibench import discrepancy
from calibench.bench.discovery.store import FindingStore, SearchRecord
from calibench.bench.gate.endings import place_of, text_of
from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.measured.files import pairs_of, read_measured
from calibench.bench.measured.sources import Source, sets, sources
from calibench.bench.provenance.code_digest import digest_of
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical
from calibench.bench.verbs import DesignWords, DiscoverWords
from calibench.bench.words import RequestError, check_study, keys_of, read, read_workers
from calibench.core.kept import cache_root
from calibench.core.notes import Code, Note
from calibench.core.options import coerce, declared_options, read_word, suggest
from calibench.core.process import meanwhile
from calibench.core.seeds import digest
from calibench.core.sources import module_digest
from calibench.core.tables.columns import is_table
from calibench.core.words import one_line, print_plain
from calibench.discrepancy.checks.validate import refuse_no_machine
from calibench.discrepancy.design.detectability import Design, design
from calibench.discrepancy.design.next_poses import NextPoses, NoPoses, next_poses
from calibench.discrepancy.fitting.journal import keeping_steps
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.model.machine import Completed, Machine
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import description_of, descriptions, families, machines
from calibench.discrepancy.report import Report

if TYPE_CHECKING:
    from calibench.bench.discovery.page.page import Draw

Pages = Literal["auto", "all", "none"]


@final
@dataclass(frozen=True)
class DiscoverRequest:
    """A search in one or more sets of data; `stated` overrides the files' own metadata.

    `across` names further sets of the machine, as `data` does, in which the findings of one set are looked for.
    """

    machine: str
    machine_options: Mapping[str, Any]
    data: str
    stated: Mapping[str, Any]
    across: str = ""
    folder: Path = field(default=Path("results/discover"))
    pages: Pages = "auto"
    workers: int = 1
    command: str = ""

    @property
    def options(self) -> str:
        """Return all that decides the verdict besides the data, as canonical JSON."""
        across = {"across": self.across} if self.across else {}
        machine = {"name": self.machine, **self.machine_options}
        return canonical({"machine": machine, "stated": dict(self.stated), **across})

    def build_machine(self) -> Machine:
        return _built(self.machine, self.machine_options)


def read_discover(words: Sequence[str]) -> DiscoverRequest:
    """Return the search that `words` ask for. Raises `RequestError` or `ValueError`."""
    given = read(DiscoverWords, "discover", words)
    stated, options = _of_the_machine(given)
    if not given.data:
        raise RequestError("data= is missing: a file, a glob, a folder or a name, such as data=run7.parquet")
    check_study(given.study)
    n_jobs = read_workers(-1 if given.n_jobs is None else given.n_jobs)
    if given.execution == "serial" and given.n_jobs is not None:
        raise RequestError("execution.n_jobs: execution=serial is one process; add execution=processes")
    return DiscoverRequest(
        machine=given.machine, machine_options=options, data=given.data, stated=stated, pages=given.pages,
        across=given.across.removeprefix("[").removesuffix("]"), folder=Path(given.results).expanduser() / given.study,
        workers=1 if given.execution == "serial" else (os.cpu_count() or 1) if n_jobs == -1 else n_jobs,
        command=shlex.join(["bench", "discover", *words]),
    )  # fmt: skip


def _built(name: str, options: Mapping[str, Any]) -> Machine:
    """Return the machine with its options; raise `DataError` for a class that is none."""
    machine = machines.make(name, **options)
    refuse_no_machine(machine, f"machine={name}")
    return machine


def _of_the_machine(given: DiscoverWords | DesignWords) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what is stated of the data, and the machine's options. Raises `ValueError` for what the machine lacks."""
    machine = given.machine
    known = {one.key: one for each in descriptions().values() for one in each.stated or ()}
    own = description_of(machine).stated
    read_here = known if own is None else {one.key: one for one in own}  # one that declares nothing may read any
    for key in given.stated:
        if key not in known:
            choices = [*keys_of(type(given)), *(read_here or known)]
            is_option = machine in machines.names() and key in machines.options(machine)
            way_out = f"machine.{key}= is its option" if is_option else suggest(key, [*choices, "machine.OPTION"])
            raise RequestError(f"unknown argument {key!r}; {way_out}")
    if not machine:
        raise RequestError(f"machine= is missing: a machine; {suggest('', machines.names())}")
    declared = machines.options(machine)
    options = {k: read_word(v, declared[k].annotation if k in declared else Any) for k, v in given.options.items()}
    machines.check(machine, options)
    stated: dict[str, Any] = {key: read_word(text) for key, text in (given.of_data | given.stated).items()}
    stated |= {key: pairs_of(key, text) for key in ("columns", "units") if (text := getattr(given, key))}
    for key, value in stated.items():
        if key in known and key not in read_here:
            is_option = machine in machines.names() and key in machines.options(machine)
            way_out = f"machine.{key}= is its option" if is_option else suggest(key, read_here)
            raise RequestError(f"{key}= is nothing that {machine} reads; {way_out}")
        rule, example = (read_here[key].rule, read_here[key].example) if key in read_here else ("", "")
        if rule == "positive" and not coerce(key, value, float) > 0:
            raise RequestError(f"{key}={value}: a number above 0 is needed")
        if rule == "list" and isinstance(value, str):
            raise RequestError(f"{key}={value}: a number for each joint is needed, such as {example}")
        if rule == "names" and not isinstance(value, dict):
            raise RequestError(f"{key}={value}: a JSON object is needed, such as {example}")
    return stated, options


_MOST_CLASSES = 6  # that are tried for one that further readings split at all


@final
@dataclass(frozen=True, eq=False)
class Designed:
    """What can be detected, and the readings that best split `further.rivals` (None: not asked, or for this reason).

    `machine` is what was asked for, `label` the name of its kind.
    """

    machine: str
    label: str
    design: Design
    further: NextPoses | None = None
    reason: str = ""

    def to_dict(self) -> dict[str, Any]:
        said = {"schema_version": 1, "machine": self.machine, **self.design.to_dict()}
        return said | {"next": None if self.further is None else self.further.to_dict()}


def designed(words: Sequence[str]) -> Designed:
    """Return what data or a plan could show, as `words` ask. Raises `RequestError`, `DataError` or `ValueError`."""
    given = read(DesignWords, "design", words)
    stated, options = _of_the_machine(given)
    if bool(given.data) == bool(given.plan):
        raise RequestError("one of data=FILE and plan=NAME is needed")
    chosen = tuple(part.strip() for part in given.rivals.split(",") if part.strip())
    if len(chosen) == 1:
        raise RequestError(f"rivals={chosen[0]}: two or more names are needed, with a comma between them")
    machine = partial(_built, given.machine, options)
    data = _data_of(given, machine().name, stated)
    answer = Designed(given.machine, machine().name, design(machine(), data, size=given.size))
    if not given.further:
        return answer
    if chosen:
        return replace(answer, further=next_poses(machine(), data, chosen, given.further, given.size))
    best, reason = None, "no two names look alike in these data"
    for rivals in [names[:_MOST_RIVALS] for names in answer.design.classes if len(names) > 1][:_MOST_CLASSES]:
        try:
            best = next_poses(machine(), data, rivals, given.further, given.size)
        except ValueError as error:
            reason = str(error)
            continue
        if best.helps:
            break
    return replace(answer, further=best, reason="" if best else reason)


def _data_of(given: DesignWords, machine: str, stated: Mapping[str, Any]) -> MeasuredData:
    if given.data:
        listed = sets(given.data, machine, stated)
        if len(listed) > 1:
            raise RequestError(f"data={given.data}: names {len(listed)} sets; design looks at one")
        return listed[0].read(stated)
    make = description_of(given.machine).plan
    if make is None:
        raise RequestError(f"plan=: {given.machine} has no named plans; give data=FILE with the plan's readings")
    declared = declared_options(make)
    names = [str(choice) for choice in declared["plan"].type.__args__]
    if given.plan not in names:
        raise RequestError(f"plan={given.plan}: {suggest(given.plan, names)}")
    for key in ("columns", "units"):
        if key in stated:
            raise RequestError(f"{key}=: goes with data=FILE, and plan={given.plan} has its own names")
    chosen = {k: v for k, v in stated.items() if k in declared}
    chosen |= {k: read_word(v, declared[k].annotation if k in declared else Any) for k, v in given.plan_options.items()}
    for key in chosen:
        if key not in declared or key == "plan":
            raise RequestError(f"plan.{key}: {suggest(key, [k for k in declared if k != 'plan'])}")
    made = make(given.plan, **{k: coerce(f"plan.{k}", value, declared[k].type) for k, value in chosen.items()})
    return MeasuredData(made.columns, made.machine, {**made.metadata, **stated}, made.name, made.notes)


_MANY = 24  # sets of data above which pages are not drawn unless asked for: a page takes longer than its search
_POSES = 4
_MOST_RIVALS = 4  # names of a class or a set that further readings are asked to split
_MANY_READINGS = 200  # readings above which it is no advice to take more
_LEAST = 0.01  # sigma of a finding's visible size
_APART = 4.0  # sigma: separation at which data distinguish two rivals
_UNIT = "standard deviations of the noise"


@final
@dataclass(frozen=True)
class Outcome:
    """The result for one set of data: its record, whether it was there before, and its page if it has one."""

    record: SearchRecord
    before: bool
    page: Path | None


def search_all(request: DiscoverRequest, retry: bool = False) -> Iterator[Outcome]:
    """Yield the result for each set of data, in order, as soon as it is there; the tables are written at the end.

    Raises `DataError` with nothing written where `data=` names nothing, or one set that cannot be used.
    """
    listed = sets(request.data, request.build_machine().name, request.stated)
    alone = len(listed) == 1
    others = sources(request.across, request.build_machine().name, "across") if request.across else []
    if others and not alone:
        raise DataError(f"across= goes with one set in data=, and data={request.data:.40} names {len(listed)}")
    if same := [one.case for one in others if one.data_id and one.data_id == listed[0].data_id]:
        raise DataError(f"across={same[0]}: it is the set of data= itself; name other sets of the machine")
    pages = request.pages == "all" or (request.pages == "auto" and len(listed) <= _MANY)
    search = partial(_search, request, others=others, pages=pages, retry=retry, alone=alone)
    store = FindingStore(request.folder)
    store.check()
    if not alone:
        store.open(request.command)
    try:
        if request.workers == 1 or alone or not CAN_FORK:
            for one in listed:
                with meanwhile(partial(_tell, one.case, monotonic()), _SOON, _EVERY):
                    outcome = search(one)
                yield outcome
        else:
            with WorkerPool(partial(search, sent=True), min(request.workers, len(listed))) as pool:
                pool.begin(listed)
                for _ in listed:
                    yield pool.take()
    finally:
        if request.folder.is_dir():
            store.collect()


_SOON, _EVERY = 5.0, 30.0  # s of a search after which its first line, and each further one, is told


def _tell(case: str, began: float) -> None:
    print_plain(f"  searching {case}, {monotonic() - began:.0f} s so far", file=sys.stderr, flush=True)


def search_digest(machine: Machine) -> str:
    """Return the digest of the code that searches a machine's data: the machine's, its effects', the procedure's."""
    of_effects = {
        digest_of(getattr(part, "func", part))
        for family in families(machine.name)
        for part in (family.build, getattr(family.build, "__wrapped__", None), family.targets_in)
        if part is not None
    }
    # by its function, which loads the module: one that is not loaded has no digest
    of_search = digest_of(machine), sorted(of_effects), module_digest(discrepancy.carried.__module__)
    code = getattr(machine, "code", None)  # of the simulator that a machine calls
    return digest(*of_search) if code is None else digest(*of_search, code())


def _search(
    request: DiscoverRequest, source: Source, *, others: Sequence[Source], pages: bool, retry: bool, alone: bool,
    sent: bool = False,
) -> Outcome:  # fmt: skip
    """Search one set and write what came of it; one that is `alone` and unusable raises an error and gets no report.

    What is `sent` from another process is as if it were read back: the model of a search has functions in it.
    """
    data_id = source.data_id
    of_others = [other.data_id for other in others]
    case_id = digest(source.case, data_id, request.options, search_digest(request.build_machine()), *of_others)
    store, page = FindingStore(request.folder), request.folder / source.case / "report.html"
    known = None if retry or not data_id else store.done(source.case, case_id)
    if known is not None and (page.exists() or not pages):
        return Outcome(known, True, page if page.exists() else None)
    origin = {**provenance(), "started_at": datetime.now(UTC).isoformat()}
    record = SearchRecord(source.case, source.machine, case_id, data_id, request.options, origin)
    drawn: AbstractContextManager[Draw | None] = nullcontext()
    if pages:
        from calibench.bench.discovery.page.page import drawing

        drawn = drawing(beside=alone)
    with drawn as draw:
        record = _searched(record, request, source, others, retry, alone, draw)
    store.write(record)
    if sent and record.report is not None:
        record = replace(record, report=replace(record.report, candidates=(), fitted=None))
    return Outcome(record, False, page if page.exists() else None)


def _searched(
    record: SearchRecord, request: DiscoverRequest, source: Source, others: Sequence[Source], retry: bool, alone: bool,
    draw: "Draw | None",
) -> SearchRecord:  # fmt: skip
    """Return the record with what the search found, or its error; the page of a report stands already."""
    cpu, page = process_time(), request.folder / source.case / "report.html"
    report: Report | None = None
    try:
        data = source.read(request.stated)
        if source.data_id != record.data_id:
            raise DataError(f"{source.path}: changed while it was read; wait until it is written, then ask again")
        machine = request.build_machine()
        steps = cache_root() / "searches" / digest(record.case_id, record.provenance["versions"])
        with keeping_steps(steps, anew=retry):
            report = with_advice(discrepancy.explain(machine, data), data, machine)
        if others:
            report = discrepancy.carried(report, [replace(o.read(request.stated), name=o.case) for o in others])
        report = replace(report, case=source.case)
        record = replace(record, machine=report.machine, report=report, seconds=report.seconds)
    except Exception as error:
        if alone and isinstance(error, DataError):
            raise
        record = replace(record, error=_in_a_line(error), seconds=process_time() - cpu)
    FindingStore(request.folder).open(request.command)
    page.unlink(missing_ok=True)
    if draw is not None and report is not None:
        from calibench.bench.discovery.page.page import write_report

        try:
            write_report(record, report, data, page.parent, draw)
        except Exception as error:  # the verdict stands without its page
            note = Note(Code.NO_PAGE, f"the page could not be drawn: {_in_a_line(error)}")
            record = replace(record, report=replace(report, notes=(*report.notes, note)))
    return record


def _in_a_line(error: Exception) -> str:
    """Return a line for an error: what is wrong with the data, or a failure's type and place in the user's code."""
    text = one_line(text_of(error))
    if isinstance(error, DataError):
        return text
    place = place_of(error)
    return f"{type(error).__name__}: {text}{f' ({place})' if place else ''}"


def with_advice(report: Report, data: MeasuredData, machine: Machine) -> Report:
    """Return the report with computed proposals added to `separated_by` of findings that have rivals.

    `machine` is the very object that was searched, because the report lacks its options, such as an arm's URDF.
    """
    # the data as a further sensor would complete them; None where the machine knows of none
    make, there = description_of(data.machine).completed, report.before.model
    values = dict(zip(there.names, report.before.best.tolist()))
    findings = []
    for finding in report.findings:
        if len(finding.set) <= 1:
            findings.append(finding)
            continue
        first, *others = finding.set[:_MOST_RIVALS]
        size = max(_LEAST, finding.visible or 1.0)
        completed = make(there.formulation, data, values) if make else None
        by_kind: dict[str, list[str]] = {}
        details: dict[str, str] = {}
        for other in others:
            means = _between(machine, data, completed, [first.effect, other.effect], size)
            if means is not None:
                kind, detail = means
                name = effect_label(report.machine, other.family, other.target, again=True)
                by_kind.setdefault(kind, []).append(name)
                details.setdefault(kind, detail)
        name = effect_label(report.machine, first.family, first.target, again=True)  # the headline has their full words
        advice = [f"{kind} {name} from {' and '.join(names)}{details[kind]}" for kind, names in by_kind.items()]
        if advice and (more := len(finding.set) - _MOST_RIVALS) > 0:
            advice.append(f"the {more} least likely {'one was' if more == 1 else 'ones were'} not looked at")
        before = [finding.separated_by] if finding.separated_by else []
        findings.append(replace(finding, separated_by="; ".join([*before, *advice]) or None))
    return replace(report, findings=tuple(findings))


def _between(
    machine: Machine, data: MeasuredData, completed: Completed | None, rivals: list[str], size: float
) -> tuple[str, str] | None:
    """Return what would separate two rivals: the means, and a remark on it."""
    try:
        here = next_poses(machine, data, rivals, _POSES, size)
    except NoPoses:
        return None
    except DataError as error:
        return "no further readings could be planned that tell", f" ({error})"
    now, there = here.separation[0], 0.0
    if completed is not None:
        with suppress(NoPoses):
            there = next_poses(machine, completed.data, rivals, _POSES, size).separation[0]
        if there > max(_APART, 1.5 * now):
            return f"{completed.words} would tell", f" (from {now:.1f} to {there:.1f} {_UNIT} apart)"
    if not here.helps:
        return None
    gained = (here.separation[-1] ** 2 - now**2) / _POSES  # sigma^2 a reading
    needed = max(_POSES, int(np.ceil((_APART**2 - now**2) / gained)))
    if needed > _MANY_READINGS:
        return "more poses of this kind hardly help to tell", ""
    places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in here.positions)
    means = f"about {needed} more readings, at places such as {places} mm, would tell"
    return means, f" (now {now:.1f} {_UNIT} apart)"


Readings = str | Path | MeasuredData | Mapping[str, Any]  # of columns by name, as a DataFrame has them


def discover(
    machine: str | Machine, data: Readings, *, across: Readings | Sequence[Readings] = (), **words: Any
) -> Report:
    """Return what is missing from the model of `machine`, a registered name, ``FILE.py:Class`` or an object.

    `data` is what ``data=`` names on the command line (a file, or a set that ships), columns by name with the heads of
    a file (a DataFrame, a mapping), or data that are read already.
    `across` are other sets of the same machine, in the same forms: `report.across` says which findings they carry.
    `words` are options of the machine (``call="sim.py:run"``), and what the file should state and does not
    (``sigma_enc=5e-5``, in the units of docs/discover.md). Raises `DataError` in one line for data that cannot be used,
    and for a word that is neither.
    """
    made, stated = _made_with(machine, words)
    if isinstance(data, str | Path):
        found = sets(str(data), made.name, stated)
        if len(found) > 1:
            raise DataError(f"discover: {data} names {len(found)} sets of data; one is needed")
        data = found[0].read(stated)
    elif not isinstance(data, MeasuredData):
        data = read_measured(data, made, stated)
    elif stated:
        raise TypeError(f"discover: {', '.join(stated)} goes with a file; data that are read already have their own")
    others: list[MeasuredData] = []
    for one in [across] if isinstance(across, str | Path | MeasuredData) or is_table(across) else across:
        if isinstance(one, MeasuredData):
            others.append(one)
        elif is_table(one):
            others.append(replace(read_measured(one, made, stated), name=f"across_{len(others) + 1}"))
        else:
            others += [replace(o.read(stated), name=o.case) for o in sources(str(one), made.name, "across")]
    report = discrepancy.explain(made, data)
    return discrepancy.carried(report, others) if others else report


def _made_with(machine: str | Machine, words: Mapping[str, Any]) -> tuple[Machine, dict[str, Any]]:
    """Return the machine with its options among `words`, and what the others state; refuse a word that is neither."""
    if isinstance(machine, str):
        known, name = machines.options(machine), machine
    else:
        refuse_no_machine(machine)
        known, name = {}, machine.name
    own = description_of(name).stated
    read_here = ["columns", "units", *(one.key for one in own or ())]
    # machine.urdf is the option, also where urdf may be stated
    options = {key.removeprefix("machine."): value for key, value in words.items() if key not in read_here}
    stated = {key: value for key, value in words.items() if key.removeprefix("machine.") not in {*options} & {*known}}
    for key in stated:
        if key not in read_here and (own is not None or key.startswith("machine.")):
            way_out = suggest(key.removeprefix("machine").lstrip("._"), [*known, *read_here])
            raise DataError(f"discover: {key}= is no option of {name}, nor stated of its data; {way_out}")
    if isinstance(machine, str):
        machine = _built(machine, {key: options[key] for key in options if key in known})
    return machine, stated
