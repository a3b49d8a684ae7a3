"""A series by itself: the 3D error of poses that were kept back, by the nominal arm, by geometry, by named effects.

Base and tool are found anew for each row of the table. Intervals are of the poses that were kept back, drawn anew with
repetition; that of what names gain over geometry draws the same poses for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from benchmarks.arms.frames import framed, norms
from benchmarks.arms.series import URDF
from calibench.calibration.fit import rms
from calibench.discrepancy import MeasuredData, Model, Report, explain
from calibench.discrepancy.machines.arm import Arm
from calibench.problems.base import Array

_DRAWS = 1000


@final
@dataclass(frozen=True, eq=False)
class Within:
    """Errors [mm] of the poses that were kept back, (n,) each, what was found, and the poses that were left out."""

    nominal: Array
    geometry: Array
    named: Array
    report: Report
    wild: int


def within(data: MeasuredData) -> Within:
    """Return the errors on the rows of `data` whose split is hold, by fits to the others."""
    whole = Arm(URDF).formulate(data)
    held = np.asarray(whole.data["split"]) == "hold"
    report = explain(Arm(URDF), data)
    plain = report.before
    seen = whole.data.rows(held)
    geometry = Model(plain.model.formulation.on(seen)).residuals(plain.best)
    nominal = framed(whole, np.flatnonzero(~held)).left(seen)
    return Within(nominal, norms(geometry), norms(report.predict(seen).residuals), report, len(data) - len(whole.data))


def told(name: str, found: Within) -> Sequence[str]:
    """Return lines for the page: the row of the table, and what was named."""
    cells = [_cell(errors) for errors in (found.nominal, found.geometry, found.named)]
    low, high = gain(found.geometry, found.named)
    report = found.report
    lines = [
        f"| {name} | {len(found.nominal)} | " + " | ".join(cells) + f" | {low:.3f} to {high:.3f} | {report.verdict} |",
        f"  {found.wild} rows left out (wild ones, and the first); {report.seconds:.0f} s of a core",
    ]
    for finding in report.findings:
        size, names = finding.amplitude, " or ".join(f"{r.effect} ({r.weight:.2f})" for r in finding.set)
        more = "; ".join(word for word in (finding.form, *(c.code for c in finding.caution)) if word)
        ends = f"{size.ci95[0]:.3g} to {size.ci95[1]:.3g}"
        period = f", period {finding.period:.3g}" if finding.period else ""
        lines.append(f"  {names}: {size.value:.3g} {size.unit} ({ends}){period}{': ' + more if more else ''}")
    if report.left is not None:
        lines.append(f"  left beside the names: {report.left.times:.2f} times what noise leaves")
    return lines


def gain(before: Array, after: Array, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of how much the rms falls [mm], both over the same poses drawn anew."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(before)]))
    drawn = rng.integers(len(before), size=(_DRAWS, len(before)))
    fall = np.sqrt((before**2)[drawn].mean(axis=1)) - np.sqrt((after**2)[drawn].mean(axis=1))
    low, high = np.quantile(fall, [0.025, 0.975])
    return float(low), float(high)


def _cell(errors: Array) -> str:
    low, high = gain(errors, np.zeros_like(errors))
    return f"{rms(errors):.3f} ({low:.3f} to {high:.3f})"
