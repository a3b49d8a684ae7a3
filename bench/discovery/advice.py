"""What to measure next so that the rivals of a finding come apart: further poses, or a tracker beside the encoders.

How far apart rivals stand is asked of the data themselves: what is left of one, in sigma, when calibration and the
other do their best to mimic it (`discrepancy.design.next_poses`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.discovery.page.words import effect_words
from discrepancy import MeasuredData
from discrepancy.design.next_poses import NextPoses, next_poses
from discrepancy.model.model import Model
from discrepancy.report import Report

_POSES = 4
_MOST_RIVALS = 4
_MANY = 200  # readings above which it is no advice to take more
_LEAST = 0.01  # sigma of a finding's visible size
_APART = 4.0  # sigma: rivals that far apart are told from each other
_UNIT = "standard deviations of the noise"
_SIGMA_XY = 0.02  # mm: a tracker as it is sold


def with_advice(told: Mapping[str, Any], report: Report, data: MeasuredData) -> dict[str, Any]:
    """Return the report as JSON with what a computation adds to `separated_by` of findings that have rivals."""
    findings = []
    for finding in told["findings"]:
        computed = _advice(report, data, finding) if len(finding["set"]) > 1 else None
        said = [text for text in (finding.get("separated_by"), computed) if text]
        findings.append({**finding, "separated_by": "; ".join(said) or None})
    return {**told, "findings": findings}


def _advice(report: Report, data: MeasuredData, finding: Mapping[str, Any]) -> str | None:
    """Return what would separate the rivals of `finding`, in words; None where no reading would."""
    first, *others = finding["set"][:_MOST_RIVALS]
    size = max(_LEAST, float(finding.get("visible") or 1.0))
    tracked = _with_tracker(report, data)
    by_kind: dict[str, list[str]] = {}
    details: dict[str, str] = {}
    for other in others:
        found = _between(report.machine, data, tracked, [first["effect"], other["effect"]], size)
        if found is not None:
            kind, detail = found
            by_kind.setdefault(kind, []).append(effect_words(other["family"], other["target"]))
            details.setdefault(kind, detail)
    name = effect_words(first["family"], first["target"])
    said = [f"{kind} {name} from {' and '.join(names)}{details[kind]}" for kind, names in by_kind.items()]
    return "; ".join(said) or None


def _between(
    machine: str, data: MeasuredData, tracked: MeasuredData | None, rivals: list[str], size: float
) -> tuple[str, str] | None:
    """Return what would separate two rivals: the means, and a remark on it."""
    here = _asked(machine, data, rivals, size)
    if here is None:
        return None
    there = None if tracked is None else _asked(machine, tracked, rivals, size)
    now = here.separation[0]
    if there is not None and there.separation[0] > max(_APART, 1.5 * now):
        reach = f" (from {now:.1f} to {there.separation[0]:.1f} {_UNIT} apart)"
        return f"an external tracker in the same run (x, y to {_SIGMA_XY:g} mm) would tell", reach
    if not here.helps:
        return None
    gained = (here.separation[-1] ** 2 - now**2) / _POSES  # sigma^2 a reading
    needed = max(_POSES, int(np.ceil((_APART**2 - now**2) / gained)))
    if needed > _MANY:
        return "more poses of this kind hardly help to tell", ""
    places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in here.positions)
    return (
        f"about {needed} more readings, at places such as {places} mm, would tell",
        f" (now {now:.1f} standard deviations of the noise apart)",
    )


def _asked(machine: str, data: MeasuredData, rivals: list[str], size: float) -> NextPoses | None:
    """Return the next poses, or None where none can be proposed: another machine, or a rival that moves no mean."""
    try:
        return next_poses(machine, data, rivals, _POSES, size)
    except ValueError:
        return None


def _with_tracker(report: Report, data: MeasuredData) -> MeasuredData | None:
    """Return the data as a tracker would complete them; None where there is one, or the machine tells no place."""
    formulation = report.before.model.formulation
    if data.has("x", "y") or "workspace" not in formulation.covariates(report.before.fit.at.recorded):
        return None
    there = Model(formulation.on(data))
    q, _ = there.quantities(report.before.best)
    place = formulation.on(data).covariates(q)["workspace"]
    x, y = (np.real(np.asarray(place[name], dtype=complex)) for name in ("x", "y"))
    nominal = {**dict(data.metadata.get("nominal", {})), **dict(zip(there.names, report.before.best.tolist()))}
    return replace(
        data.with_columns({"x": x, "y": y}), metadata={**data.metadata, "sigma_xy": _SIGMA_XY, "nominal": nominal}
    )
