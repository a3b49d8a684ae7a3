"""Search sets of measured data for a missing effect: one after the other or side by side, a folder a set.

A set that was searched before with the same data, options and code is not searched again. What cannot be read, or
fails, is a report with an `error`; the others go on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from time import process_time
from typing import final

from calibench import discrepancy
from calibench.bench.discovery.advice import with_advice
from calibench.bench.discovery.code import search_digest
from calibench.bench.discovery.record import SearchRecord
from calibench.bench.discovery.request import DiscoverRequest
from calibench.bench.discovery.store import FindingStore
from calibench.bench.gate.frames import place_of, text_of
from calibench.bench.measured.sources import Source, sources
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import digest
from calibench.core.user_file import as_usual, safe_children
from calibench.core.words import one_line
from calibench.discrepancy import DataError, MeasuredData, Report

_MANY = 24  # sets of data above which pages are not drawn unless asked for: a page takes longer than its search


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
    listed = sources(request.data, request.build_machine().name)
    pages = request.pages == "all" or (request.pages == "auto" and len(listed) <= _MANY)
    task = _Task(request, pages, retry, alone=len(listed) == 1)
    store = FindingStore(request.folder)
    store.check()
    if not task.alone:
        store.open()
    try:
        if request.workers == 1 or task.alone:
            for source in listed:
                yield task.search(source, ())
        else:
            from joblib import Parallel, delayed

            jobs = (delayed(task.search)(source, tuple(sys.path)) for source in listed)
            with safe_children():
                yield from Parallel(n_jobs=request.workers, backend="loky", return_as="generator")(jobs)
    finally:
        if request.folder.is_dir():
            store.collect()


@final
@dataclass(frozen=True)
class _Task:
    """The work on each set; an unusable set that is `alone` raises an error and gets no report."""

    request: DiscoverRequest
    pages: bool
    retry: bool
    alone: bool

    def search(self, source: Source, path: Sequence[str]) -> Outcome:
        """Search one set and write what came of it. `path` lets a worker import the user's own machine."""
        as_usual()
        sys.path[:] = list(dict.fromkeys([*sys.path, *path]))
        request, data_id = self.request, source.data_id
        case_id = digest(source.case, data_id, request.options, search_digest(request.build_machine()))
        store, page = FindingStore(request.folder), request.folder / source.case / "report.html"
        known = None if self.retry or not data_id else store.done(source.case, case_id)
        if known is not None and (page.exists() or not self.pages):
            return Outcome(known, True, page if page.exists() else None)
        began, cpu = datetime.now(UTC), process_time()
        origin = {**provenance(), "started_at": began.isoformat()}
        record = SearchRecord(source.case, source.machine, case_id, data_id, request.options, origin)
        data: MeasuredData | None = None
        try:
            data = source.read(request.stated)
            if source.data_id != data_id:
                raise DataError(f"{source.path}: changed while it was read; wait until it is written, then ask again")
            machine = request.build_machine()
            report = with_advice(discrepancy.explain(machine, data), data, machine)
            report = replace(report, case=source.case)
            record = replace(record, machine=report.machine, report=report, seconds=report.seconds)
        except Exception as error:
            if self.alone and isinstance(error, DataError):
                raise
            record = replace(record, error=_said(error), seconds=process_time() - cpu)
        store.open()
        page.unlink(missing_ok=True)
        if self.pages and record.report is not None and data is not None:
            notes = _drawn(record, record.report, data, page.parent)
            record = replace(record, report=replace(record.report, notes=(*record.report.notes, *notes)))
        store.write(record)
        return Outcome(record, False, page if page.exists() else None)


def _drawn(record: SearchRecord, report: Report, data: MeasuredData, folder: Path) -> tuple[str, ...]:
    """Write drawings and page; return a note where they cannot be drawn, for the verdict stands without them."""
    from calibench.bench.discovery.page.write import write_report

    try:
        write_report(record, report, data, folder)
    except Exception as error:
        return (f"the page could not be drawn: {_said(error)}",)
    return ()


def _said(error: Exception) -> str:
    """Return a line for an error: what is wrong with the data, or a failure's type and place in the user's code."""
    text = one_line(text_of(error))
    if isinstance(error, DataError):
        return text
    place = place_of(error)
    return f"{type(error).__name__}: {text}{f' ({place})' if place else ''}"
