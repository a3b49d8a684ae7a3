"""Search sets of measured data for a missing effect: one after the other or side by side, a folder a set.

A set that was searched before with the same data, options and code is not searched again. What cannot be read, or
fails, is a report with an `error`; the others go on. To each finding with rivals comes the measurement that separates
them, further poses or a second sensor: their distance follows from the data themselves
(`discrepancy.design.next_poses`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import process_time
from typing import final

import numpy as np

from calibench import discrepancy
from calibench.bench.discovery.request import DiscoverRequest
from calibench.bench.discovery.schema import SearchRecord
from calibench.bench.discovery.store import FindingStore
from calibench.bench.gate.endings import place_of, text_of
from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.measured.sources import Source, sets, sources
from calibench.bench.provenance.code_digest import digest_of
from calibench.bench.provenance.environment import provenance
from calibench.core.notes import Code, Note
from calibench.core.seeds import digest
from calibench.core.sources import module_digest
from calibench.core.words import one_line
from calibench.discrepancy.design.next_poses import NextPoses, NoPool, UnknownRival, next_poses
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.model.machine import Completed, Machine
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import description_of, families
from calibench.discrepancy.report import Report

_MANY = 24  # sets of data above which pages are not drawn unless asked for: a page takes longer than its search
_POSES = 4
_MOST_RIVALS = 4
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


def discover(request: DiscoverRequest, retry: bool = False) -> Iterator[Outcome]:
    """Yield the result for each set of data, in order, as soon as it is there; the tables are written at the end.

    Raises `DataError` with nothing written where `data=` names nothing, or one set that cannot be used.
    """
    listed = sets(request.data, request.build_machine().name, request.stated)
    alone = len(listed) == 1
    others = others_of(request.across, request.build_machine().name) if request.across else []
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
            yield from map(search, listed)
        else:
            with WorkerPool(partial(search, sent=True), min(request.workers, len(listed))) as pool:
                pool.begin(listed)
                for _ in listed:
                    yield pool.take()
    finally:
        if request.folder.is_dir():
            store.collect()


def others_of(named: str, machine: str) -> list[Source]:
    """Return the sets that ``across=named`` stands for, as ``data=`` would. Raises `DataError` as `sources` does."""
    try:
        return sources(named, machine)
    except DataError as error:
        raise DataError(str(error).replace("data=", "across=", 1)) from None


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
    began, cpu = datetime.now(UTC), process_time()
    origin = {**provenance(), "started_at": began.isoformat()}
    record = SearchRecord(source.case, source.machine, case_id, data_id, request.options, origin)
    report: Report | None = None
    try:
        data = source.read(request.stated)
        if source.data_id != data_id:
            raise DataError(f"{source.path}: changed while it was read; wait until it is written, then ask again")
        machine = request.build_machine()
        report = with_advice(discrepancy.explain(machine, data), data, machine)
        if others:
            report = discrepancy.carried(report, [replace(o.read(request.stated), name=o.case) for o in others])
        report = replace(report, case=source.case)
        record = replace(record, machine=report.machine, report=report, seconds=report.seconds)
    except Exception as error:
        if alone and isinstance(error, DataError):
            raise
        record = replace(record, error=_in_a_line(error), seconds=process_time() - cpu)
    store.open(request.command)
    page.unlink(missing_ok=True)
    if pages and report is not None:
        from calibench.bench.discovery.page.page import write_report

        try:
            write_report(record, report, data, page.parent)
        except Exception as error:  # the verdict stands without its page
            note = Note(Code.NO_PAGE, f"the page could not be drawn: {_in_a_line(error)}")
            record = replace(record, report=replace(report, notes=(*report.notes, note)))
    store.write(record)
    if sent and record.report is not None:
        record = replace(record, report=replace(record.report, candidates=(), fitted=None))
    return Outcome(record, False, page if page.exists() else None)


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
        here = _asked(machine, data, rivals, size)
    except DataError as error:
        return "no further readings could be planned that tell", f" ({error})"
    if here is None:
        return None
    there = None if completed is None else _asked(machine, completed.data, rivals, size)
    now = here.separation[0]
    if completed is not None and there is not None and there.separation[0] > max(_APART, 1.5 * now):
        reach = f" (from {now:.1f} to {there.separation[0]:.1f} {_UNIT} apart)"
        return f"{completed.words} would tell", reach
    if not here.helps:
        return None
    gained = (here.separation[-1] ** 2 - now**2) / _POSES  # sigma^2 a reading
    needed = max(_POSES, int(np.ceil((_APART**2 - now**2) / gained)))
    if needed > _MANY_READINGS:
        return "more poses of this kind hardly help to tell", ""
    places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in here.positions)
    return (
        f"about {needed} more readings, at places such as {places} mm, would tell",
        f" (now {now:.1f} standard deviations of the noise apart)",
    )


def _asked(machine: Machine, data: MeasuredData, rivals: list[str], size: float) -> NextPoses | None:
    """Return the next poses, or None where none can be proposed: another machine, or a rival that moves no mean."""
    try:
        return next_poses(machine, data, rivals, _POSES, size)
    except (NoPool, UnknownRival):
        return None
