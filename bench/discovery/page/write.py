"""From a finished search to its drawings and its page, in the case's own folder."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any

from calibench.bench.discovery.page.figures import discovery_figures
from calibench.bench.discovery.page.noise_charts import noise_charts
from calibench.bench.discovery.page.page import Page
from calibench.bench.discovery.page.series import series_of
from calibench.bench.discovery.page.words import reading_noise_words
from calibench.bench.discovery.record import SearchRecord
from calibench.bench.report.shared.drawing import save
from calibench.bench.store.files.atomic_file import write_whole
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.effects import families
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.report import Report


def write_report(record: SearchRecord, report: Report, data: MeasuredData, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` of a finished search into `folder`; return the page's path."""
    drawings = {}
    for name, drawing in chain(discovery_figures(report, series_of(report)), noise_charts(report)):
        drawings[name] = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
    formulation = report.before.model.formulation
    written = description_of(report.machine).corrected
    correction = None if written is None else written(report)
    page = Page(
        report,
        drawings,
        about_data={"readings": str(len(data)), "of them fitted": str(len(formulation.data))},
        notes=tuple(dict.fromkeys((*data.notes, *report.notes))),
        units={p.name: p.unit for p in formulation.parameters},
        causes={family.name: (family.cause, family.formula) for family in families(report.machine)},
        provenance=_provenance(record),
        noise=reading_noise_words(report),
        correction=correction,
    )
    if correction is not None:
        write_whole(folder / correction.file, lambda file: file.write(correction.text.encode()))
    text = page.html().encode()
    return write_whole(folder / "report.html", lambda file: file.write(text))


def _provenance(record: SearchRecord) -> dict[str, Any]:
    origin = dict(record.provenance)
    dirty = " (with changes)" if origin.get("git_dirty") else ""
    return {
        "case": record.case,
        "searched": _minute(str(origin.get("started_at") or "")),
        "commit": f"{origin.get('git_commit', '')}{dirty}",
        "platform": origin.get("platform"),
        "versions": ", ".join(f"{k} {v}" for k, v in json.loads(origin.get("versions") or "{}").items() if v),
        "options": record.options,
        "digest of the data": record.data_id,
        "digest of data and options": record.case_id,
        "computing time": f"{record.seconds:.2f} s" if isfinite(record.seconds) else None,
    }


def _minute(moment: str) -> str:
    """Return an ISO time to the minute."""
    return f"{datetime.fromisoformat(moment).astimezone(UTC):%Y-%m-%d %H:%M} UTC" if moment else ""
