"""From a finished search to its drawings and its page, in the case's own folder."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib import rc_context

from bench.discovery_figures import discovery_figures
from bench.discovery_page import Page
from bench.discovery_series import series_of
from bench.drawing import STYLE, save
from bench.whole import write_whole
from discrepancy import MeasuredData
from discrepancy.report import Report


def write_report(report: Report, told: Mapping[str, Any], data: MeasuredData, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` into `folder`; return the page's path. `told` is the report as JSON."""
    drawings = {}
    for name, drawing in discovery_figures(told, series_of(report)):
        save(name, drawing, folder / "figures")
        drawings[name] = _svg(drawing[0])
    formulation = report.before.model.formulation
    page = Page(
        told,
        drawings,
        about_data={"readings": str(len(data)), "of them fitted": str(len(formulation.data))},
        notes=tuple(dict.fromkeys((*data.notes, *report.notes))),
        units={p.name: p.unit for p in formulation.parameters},
        provenance=_provenance(told),
    )
    text = page.html().encode()
    return write_whole(folder / "report.html", lambda file: file.write(text))


def _svg(figure: Any) -> str:
    buffer = io.StringIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _provenance(told: Mapping[str, Any]) -> dict[str, Any]:
    origin = dict(told.get("provenance", {}))
    dirty = " (with changes)" if origin.get("git_dirty") else ""
    return {
        "started": origin.get("started_at"),
        "commit": f"{origin.get('git_commit', '')}{dirty}",
        "platform": origin.get("platform"),
        "versions": origin.get("versions"),
        "options": told.get("options"),
        "data (digest)": told.get("data_id"),
        "case id": told.get("case_id"),
        "seconds": f"{told['seconds']:.2f}" if told.get("seconds") is not None else None,
    }
