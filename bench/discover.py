"""Search sets of measured data for a missing effect: one after the other or side by side, a folder a set.

A set that was searched before with the same data and options is not searched again. What cannot be read, or fails,
is a report with an `error`; the others go on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import process_time
from typing import Any, final

import discrepancy
from bench.discover_request import DiscoverRequest
from bench.findings import SCHEMA_VERSION, FindingStore
from bench.identity import digest
from bench.measured_sources import Source, sources
from bench.provenance import provenance
from bench.watch import text_of
from discrepancy import DataError

_MANY = 24  # sets of data above which pages are not drawn unless asked for: a page takes longer than its search


@final
@dataclass(frozen=True)
class Outcome:
    """What became of one set: its report as JSON has it, whether it was there before, and its page if it has one."""

    report: Mapping[str, Any]
    before: bool
    page: Path | None


def discover(request: DiscoverRequest, retry: bool = False) -> Iterator[Outcome]:
    """Yield what became of each set of data, in order, as it is done; the tables are folded at the end.

    Raises `DataError` before anything is written where `data=` names nothing, or one set that cannot be read.
    """
    listed = sources(request.data, request.machine)
    if len(listed) == 1:
        listed[0].read(request.stated)  # a single set that cannot be read is a wrong request
    pages = request.pages == "all" or (request.pages == "auto" and len(listed) <= _MANY)
    store = FindingStore(request.folder)
    store.open()
    try:
        yield from _all(listed, request, pages, retry)
    finally:
        store.collect()


def _all(listed: Sequence[Source], request: DiscoverRequest, pages: bool, retry: bool) -> Iterator[Outcome]:
    if request.workers == 1 or len(listed) == 1:
        for source in listed:
            yield _one(source, request, pages, retry, ())
        return
    from joblib import Parallel, delayed

    jobs = (delayed(_one)(source, request, pages, retry, tuple(sys.path)) for source in listed)
    yield from Parallel(n_jobs=request.workers, backend="loky", return_as="generator")(jobs)


def _one(source: Source, request: DiscoverRequest, pages: bool, retry: bool, path: Sequence[str]) -> Outcome:
    """Search one set and write what came of it. `path` lets a worker import the user's own machine."""
    sys.path[:] = list(dict.fromkeys([*sys.path, *path]))
    store = FindingStore(request.folder)
    data_id = source.data_id
    case_id = digest(source.case, data_id, request.options)
    page = request.folder / source.case / "report.html"
    known = None if retry or not data_id else store.done(source.case, case_id)
    if known is not None and (page.exists() or not pages):
        return Outcome(known, True, page if page.exists() else None)
    began, cpu = datetime.now(UTC), process_time()
    head = {
        "schema_version": SCHEMA_VERSION,
        "case": source.case,
        "machine": request.machine,
        "case_id": case_id,
        "data_id": data_id,
        "options": request.options,
        "provenance": {**provenance(), "started_at": began.isoformat()},
    }
    page.unlink(missing_ok=True)
    try:
        data = source.read(request.stated)
        report = discrepancy.explain(request.build_machine(), data)
        told = head | report.to_dict() | {"case": source.case}
        if pages:
            from bench.discovery_report import write_report

            write_report(report, told, data, page.parent)
    except Exception as error:
        told = head | {"error": _said(error), "seconds": process_time() - cpu}
    store.write(told)
    return Outcome(told, False, page if page.exists() else None)


def _said(error: Exception) -> str:
    """Return a line for an error: what is wrong with the data, or the kind of a fault of ours."""
    return text_of(error) if isinstance(error, DataError) else f"{type(error).__name__}: {text_of(error)}"
