"""The next measurement that separates the rivals of a finding: further poses, or a tracker beside the encoders.

The distance of rivals follows from the data themselves: what remains of one, in sigma, when calibration and the other
imitate it as well as they can (`discrepancy.design.next_poses`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.design.next_poses import NextPoses, NoPool, UnknownRival, next_poses
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.model.description import Completed
from calibench.discrepancy.model.machine import Machine
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.report import Finding, Report

_POSES = 4
_MOST_RIVALS = 4
_MANY = 200  # readings above which it is no advice to take more
_LEAST = 0.01  # sigma of a finding's visible size
_APART = 4.0  # sigma: separation at which data distinguish two rivals
_UNIT = "standard deviations of the noise"


def with_advice(report: Report, data: MeasuredData, machine: Machine) -> Report:
    """Return the report with computed proposals added to `separated_by` of findings that have rivals.

    `machine` is the very object that was searched, because the report lacks its options, such as an arm's URDF.
    """
    findings = []
    for finding in report.findings:
        computed = _advice(report, data, machine, finding) if len(finding.set) > 1 else None
        said = [text for text in (finding.separated_by, computed) if text]
        findings.append(replace(finding, separated_by="; ".join(said) or None))
    return replace(report, findings=tuple(findings))


def _advice(report: Report, data: MeasuredData, machine: Machine, finding: Finding) -> str | None:
    """Return what would separate the rivals of `finding`, in words; None where no reading would."""
    first, *others = finding.set[:_MOST_RIVALS]
    size = max(_LEAST, finding.visible or 1.0)
    completed = _completed(report, data)
    by_kind: dict[str, list[str]] = {}
    details: dict[str, str] = {}
    for other in others:
        found = _between(machine, data, completed, [first.effect, other.effect], size)
        if found is not None:
            kind, detail = found
            by_kind.setdefault(kind, []).append(effect_label(report.machine, other.family, other.target, again=True))
            details.setdefault(kind, detail)
    name = effect_label(report.machine, first.family, first.target, again=True)  # the headline has their full words
    said = [f"{kind} {name} from {' and '.join(names)}{details[kind]}" for kind, names in by_kind.items()]
    if said and (more := len(finding.set) - _MOST_RIVALS) > 0:
        said.append(f"the {more} least likely {'one was' if more == 1 else 'ones were'} not looked at")
    return "; ".join(said) or None


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
    if needed > _MANY:
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


def _completed(report: Report, data: MeasuredData) -> Completed | None:
    """Return the data as a further sensor would complete them; None where the machine knows of none."""
    made = description_of(data.machine).completed
    there = report.before.model
    return made(there.formulation, data, dict(zip(there.names, report.before.best.tolist()))) if made else None
