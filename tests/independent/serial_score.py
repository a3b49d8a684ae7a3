"""Score verdicts on the arms of `serial`: is each fault in a set, alone and right, and is silence kept.

A fault is in a set where the set holds one of the catalogue's names for it at the same part; a base that moves and a
tracker's frame that moves are one thing. A fault of which calibration leaves mostly what is off the textbook's form is
counted apart. Bars: in its set at visible size 1 or more >= .95, alone and right >= .85, silent >= .985.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.independent.arm6_score import Rate
from tests.independent.serial_cases import Case, Hidden

CATALOGUE = {
    "eccentricity": ("eccentricity", "angle_error"), "second": ("second_harmonic", "angle_error"),
    "teeth": ("cyclic",), "compliance": ("compliance",), "play": ("backlash",), "gain": ("gear",), "drift": ("drift",),
    "slip": ("slip",), "zero": ("thermal_zero",), "lag": ("lag",), "growth": ("thermal_length",),
    "bending": ("bending",), "base_drift": ("base_drift",), "base_shift": ("base_shift",), "tool_slip": ("tool_shift",),
    "scale": ("instrument_scale",),
}  # fmt: skip
BATCHES = Path(__file__).parent / "serial_batches.json"


@dataclass(frozen=True)
class Answer:
    """One case: its truth, the verdict, the sets as (family, target), the CPU seconds.

    `marked` tells of each finding whether the report says that it is like its name only, or stands beside a doubt.
    """

    seed: int
    kind: str
    make: str
    poses: int
    sigma: float
    faults: tuple[Hidden, ...]
    verdict: str
    sets: tuple[tuple[tuple[str, str], ...], ...]
    seconds: float
    marked: tuple[bool, ...] = ()

    def plain(self) -> dict[str, Any]:
        """Return it as plain values, for a line of JSON."""
        return asdict(self)


def answer(seed: int, case: Case, report: Any) -> Answer:
    """Return what a report says of a case."""
    sets = tuple(tuple((r.family, r.target) for r in finding.set) for finding in report.findings)
    return Answer(
        seed, case.kind, case.make, case.poses, case.sigma, case.faults, report.verdict, sets, float(report.seconds),
        tuple(bool(finding.form or finding.caution) for finding in report.findings),
    )  # fmt: skip


def from_plain(told: dict[str, Any]) -> Answer:
    """Return the answer that `plain` wrote."""
    sets = tuple(tuple((f, t) for f, t in one) for one in told["sets"])
    faults, marked = tuple(Hidden(**f) for f in told["faults"]), tuple(told.get("marked", ()))
    return Answer(**{**told, "faults": faults, "sets": sets, "marked": marked})


def names_of(fault: Hidden) -> set[tuple[str, str]]:
    """Return the catalogue's names for a fault."""
    target = f"link to {fault.target}" if fault.family == "growth" else fault.target
    return {(family, target) for family in CATALOGUE[fault.family]}


def own(told: Answer) -> bool:
    """Return whether of each fault its own form is what is seen, by half at least."""
    return all(fault.outside <= 0.5 for fault in told.faults)


def in_a_set(fault: Hidden, told: Answer) -> bool:
    """Return whether a set of the answer holds the fault."""
    return any(names_of(fault) & set(one) for one in told.sets)


def alone(told: Answer) -> bool:
    """Return whether the first set holds one name and it is a true one; further sets may take up an error of form."""
    return bool(told.sets) and len(told.sets[0]) == 1 and any(told.sets[0][0] in names_of(f) for f in told.faults)


def further_marked(told: Answer) -> bool:
    """Return whether each finding after the first is told to be what the form of another may be off by."""
    return len(told.sets) == 1 or (len(told.marked) > 1 and all(told.marked[1:]))


def score(told: Sequence[Answer]) -> list[Rate]:
    """Return the rates of a batch."""
    one = [a for a in told if a.kind == "one" and own(a)]
    seen = [a for a in one if a.faults[0].visible >= 1]
    two = [a for a in told if a.kind == "two" and own(a) and min((f.visible for f in a.faults), default=0) >= 1]
    none = [a for a in told if a.kind == "none"]
    faint = [a for a in one if a.faults[0].visible < 1]
    rates = [
        _rate("in its set, one fault, visible >= 1", seen, lambda a: in_a_set(a.faults[0], a)),
        _rate("alone and right, one fault, visible >= 1", seen, alone),
        _rate("only that one finding, one fault, visible >= 1", seen, lambda a: alone(a) and len(a.sets) == 1),
        _rate("that one, further ones marked, one fault, visible >= 1", seen, lambda a: alone(a) and further_marked(a)),
        _rate("in its set, one fault, visible .6-1", faint, lambda a: in_a_set(a.faults[0], a)),
        _rate("both in sets, two faults, visible >= 1", two, lambda a: all(in_a_set(f, a) for f in a.faults)),
        _rate("silent where nothing is missing", none, lambda a: a.verdict == "none"),
    ]  # fmt: skip
    for poses in (60, 300):
        some = [a for a in seen if a.poses == poses]
        rates.append(
            _rate(f"in its set, one fault, visible >= 1, {poses} poses", some, lambda a: in_a_set(a.faults[0], a))
        )
    for family in CATALOGUE:
        some = [a for a in seen if a.faults[0].family == family]
        rates.append(_rate(f"in its set: {family}", some, lambda a: in_a_set(a.faults[0], a)))
    return rates


def batches() -> list[dict[str, Any]]:
    """Return the batches that were stated."""
    return json.loads(BATCHES.read_text())  # type: ignore[no-any-return]


def _rate(what: str, of: Iterable[Answer], hit: Callable[[Answer], bool]) -> Rate:
    hits = [hit(one) for one in of]
    return Rate(what, sum(hits), len(hits))
