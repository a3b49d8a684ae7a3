"""From a finished search to its drawings and its page, in the case's own folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from bench.discovery.page.figures import discovery_figures
from bench.discovery.page.noise_charts import noise_charts
from bench.discovery.page.page import Page
from bench.discovery.page.quantity import amount
from bench.discovery.page.series import series_of
from bench.drawing import save
from bench.measured.units import COLUMN_UNITS
from bench.whole import write_whole
from discrepancy import MeasuredData
from discrepancy.effects import families
from discrepancy.model.machine import Formulation
from discrepancy.report import Report


def write_report(report: Report, told: Mapping[str, Any], data: MeasuredData, folder: Path) -> Path:
    """Write ``figures/`` and ``report.html`` into `folder`; return the page's path. `told` is the report as JSON."""
    drawings = {}
    for name, drawing in chain(discovery_figures(told, series_of(report)), noise_charts(report)):
        drawings[name] = save(name, drawing, folder / "figures")[0].read_text(encoding="utf-8")
    formulation = report.before.model.formulation
    page = Page(
        told,
        drawings,
        about_data={"readings": str(len(data)), "of them fitted": str(len(formulation.data))},
        notes=tuple(dict.fromkeys((*data.notes, *report.notes))),
        units={p.name: p.unit for p in formulation.parameters},
        causes={family.name: (family.cause, family.formula) for family in families(told["machine"])},
        candidates=report.candidates,
        provenance=_provenance(told),
        noise=_stated_noise(formulation),
    )
    text = page.html().encode()
    return write_whole(folder / "report.html", lambda file: file.write(text))


def _stated_noise(formulation: Formulation) -> str:
    """Return the stated deviation of each kind of reading, in words."""
    kinds: dict[str, list[str]] = {}
    for name, sigma in formulation.sigma.items():
        size = amount(float(np.median(sigma)), COLUMN_UNITS.get(name, "")).partition(" (")[0]
        kinds.setdefault(size, []).append(name)
    return "; ".join(f"{size} ({', '.join(names)})" for size, names in kinds.items())


def _provenance(told: Mapping[str, Any]) -> dict[str, Any]:
    origin = dict(told.get("provenance", {}))
    dirty = " (with changes)" if origin.get("git_dirty") else ""
    return {
        "case": told.get("case"),
        "searched": _minute(str(origin.get("started_at") or "")),
        "commit": f"{origin.get('git_commit', '')}{dirty}",
        "platform": origin.get("platform"),
        "versions": ", ".join(f"{k} {v}" for k, v in json.loads(origin.get("versions") or "{}").items() if v),
        "options": told.get("options"),
        "digest of the data": told.get("data_id"),
        "digest of data and options": told.get("case_id"),
        "computing time": f"{told['seconds']:.2f} s" if told.get("seconds") is not None else None,
    }


def _minute(moment: str) -> str:
    """Return an ISO time to the minute."""
    return f"{datetime.fromisoformat(moment).astimezone(UTC):%Y-%m-%d %H:%M} UTC" if moment else ""
