"""`Report`: what is missing, where, how large, with which rivals; the gap before and after; what could not be told."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, final

from discrepancy.fitting.residual_problem import ResidualProblem

SCHEMA_VERSION = 1
Verdict = Literal["none", "negligible", "named", "ambiguous", "unknown"]


@final
@dataclass(frozen=True)
class Amplitude:
    """The number an engineer quotes, with its 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]


@final
@dataclass(frozen=True)
class Rival:
    """A member of the set that the data cannot tell apart, with its weight among them; weights sum to 1."""

    effect: str
    family: str
    target: str
    weight: float


@final
@dataclass(frozen=True)
class Finding:
    """One effect that is missing: the most likely name and its rivals, the gain over the model without it.

    `visible` is its size in sigma: the rms of what it leaves in the whitened constraints after calibration.
    """

    effect: str
    family: str
    target: str
    amplitude: Amplitude
    gain: float
    set: tuple[Rival, ...]
    separated_by: str | None
    visible: float = 0.0


@final
@dataclass(frozen=True)
class Gap:
    """Rms of the whitened constraints, in units of the stated noise; `noise_floor` is what noise alone leaves."""

    noise_floor: float
    train_before: float
    train_after: float
    held_out_before: float
    held_out_after: float
    held_out_ci95: tuple[float, float]
    excess_shrink: float
    cross_validated: bool = False


@final
@dataclass(frozen=True)
class Place:
    """A chart of the atlas on which something shows: p is of this chart alone."""

    target: str
    covariate: str
    p: float


@final
@dataclass(frozen=True)
class Untested:
    """A family, or a target of it, that these data cannot test, and why."""

    family: str
    target: str
    reason: str


@final
@dataclass(frozen=True)
class Invisible:
    """A candidate that calibration all but absorbs, and how large it would have to be."""

    effect: str
    family: str
    target: str
    visible_fraction: float
    minimum_detectable: float
    unit: str = ""


@final
@dataclass(frozen=True)
class ParameterChange:
    """A calibrated parameter before and after the findings were added, with its standard deviation after."""

    before: float
    after: float
    sd: float


@final
@dataclass(frozen=True)
class Candidate:
    """A line of the table of candidates, against the model without effects."""

    effect: str
    family: str
    target: str
    gain: float
    p: float
    visible_fraction: float
    minimum_detectable: float
    unit: str


@final
@dataclass(frozen=True)
class Report:
    """The verdict on one set of data; `model` is the machine with the findings added, ready for an optimiser."""

    case: str
    machine: str
    verdict: Verdict
    findings: tuple[Finding, ...]
    gap: Gap
    where: tuple[Place, ...]
    not_testable: tuple[Untested, ...]
    invisible: tuple[Invisible, ...]
    parameters: dict[str, ParameterChange]
    seconds: float
    p: float
    notes: tuple[str, ...]
    candidates: tuple[Candidate, ...] = field(repr=False)
    model: ResidualProblem = field(repr=False)
    before: ResidualProblem = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values, as `discover --json` prints it; what is not a number is None."""
        return {
            "schema_version": SCHEMA_VERSION,
            "case": self.case,
            "machine": self.machine,
            "verdict": self.verdict,
            "findings": [
                {
                    "effect": f.effect,
                    "family": f.family,
                    "target": f.target,
                    "amplitude": {
                        "value": _plain(f.amplitude.value),
                        "unit": f.amplitude.unit,
                        "ci95": [_plain(v) for v in f.amplitude.ci95],
                    },
                    "gain": _plain(f.gain),
                    "visible": _plain(f.visible),
                    "set": [
                        {"effect": r.effect, "family": r.family, "target": r.target, "weight": _plain(r.weight)}
                        for r in f.set
                    ],
                    "separated_by": f.separated_by,
                }
                for f in self.findings
            ],
            "gap": {
                "noise_floor": _plain(self.gap.noise_floor),
                "train_before": _plain(self.gap.train_before),
                "train_after": _plain(self.gap.train_after),
                "held_out_before": _plain(self.gap.held_out_before),
                "held_out_after": _plain(self.gap.held_out_after),
                "held_out_ci95": [_plain(v) for v in self.gap.held_out_ci95],
                "excess_shrink": _plain(self.gap.excess_shrink),
                "unit": "sigma",
                "cross_validated": self.gap.cross_validated,
            },
            "where": [{"target": w.target, "covariate": w.covariate, "p": _plain(w.p)} for w in self.where],
            "not_testable": [{"family": u.family, "target": u.target, "reason": u.reason} for u in self.not_testable],
            "invisible": [
                {
                    "effect": i.effect,
                    "family": i.family,
                    "target": i.target,
                    "visible_fraction": _plain(i.visible_fraction),
                    "minimum_detectable": _plain(i.minimum_detectable),
                    "unit": i.unit,
                }
                for i in self.invisible
            ],
            "parameters": {
                name: {"before": _plain(c.before), "after": _plain(c.after), "sd": _plain(c.sd)}
                for name, c in self.parameters.items()
            },
            "p": _plain(self.p),
            "notes": list(self.notes),
            "seconds": _plain(self.seconds),
        }


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
