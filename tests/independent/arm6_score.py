"""Score verdicts on the six-axis arm: `answer` is what a report says of a case, `score` are the rates of many.

A fault is in a set where the set holds one of its catalogue names: the same cause at the same part. What the catalogue
calls by two names (a joint's drift that one drift of the frame makes as well) counts only as it stands in the set.
A fault of which calibration leaves mostly what is off the textbook's form is counted apart. Bars: truth in the set at
visible size 1 or more >= .95, alarms <= 1.5 %, plain "named" above 1.5 floors never.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.stats import beta

from tests.independent.arm6_cases import Hidden, Truth

BINS = ((0.3, 0.6), (0.6, 1.0), (1.0, 1.5), (1.5, 2.5), (2.5, 4.05))
CATALOGUE = {  # the fault's family -> what the catalogue calls it
    "eccentricity": ("eccentricity", "angle_error"), "second": ("second_harmonic", "angle_error"),
    "teeth": ("cyclic",), "compliance": ("compliance",), "play": ("backlash",), "gain": ("gear",), "drift": ("drift",),
    "slip": ("slip",), "zero": ("thermal_zero",), "lag": ("lag",), "growth": ("thermal_length",),
    "frame": ("frame_drift",), "scale": ("instrument_scale",),
}  # fmt: skip


@dataclass(frozen=True)
class Answer:
    """One case: its truth, the verdict, the sets as (family, target), the floors left, the seconds."""

    truth: Truth
    verdict: str
    sets: tuple[tuple[tuple[str, str], ...], ...]
    floors: float
    seconds: float

    def plain(self) -> dict[str, Any]:
        """Return it as plain values, for a line of JSON."""
        return asdict(self)


def answer(truth: Truth, report: Any) -> Answer:
    """Return what a report says of a case; floors are the larger of fitted and held-out error over noise's."""
    gap = report.gap
    after = [v for v in (gap.train_after, gap.held_out_after) if v == v]
    floors = max(after) / gap.noise_floor if gap.noise_floor == gap.noise_floor else float("nan")
    sets = tuple(tuple((r.family, r.target) for r in finding.set) for finding in report.findings)
    return Answer(truth, report.verdict, sets, floors, report.seconds)


def names_of(fault: Hidden) -> set[tuple[str, str]]:
    """Return the catalogue's names for a fault."""
    target = f"axis {fault.target}" if len(fault.target) == 1 else fault.target
    return {(family, target) for family in CATALOGUE.get(fault.family, ())}


def own(told: Answer) -> bool:
    """Return whether of each fault its own form is what is seen, by half at least."""
    return all(fault.outside <= 0.5 for fault in told.truth.faults)


def in_a_set(fault: Hidden, told: Answer) -> bool:
    """Return whether a set of the answer holds the fault."""
    return any(names_of(fault) & set(one) for one in told.sets)


def first_right(told: Answer) -> bool:
    """Return whether the first name of the first set is a true one."""
    return any(told.sets[0][0] in names_of(fault) for fault in told.truth.faults)


def alarm(told: Answer) -> bool:
    """Return whether something is called missing where nothing is."""
    return told.verdict != "none"


def overstated(told: Answer) -> bool:
    """Return whether a plain name stands beside an error of more than one and a half floors."""
    return told.verdict == "named" and told.floors > 1.5


@dataclass(frozen=True)
class Rate:
    """How often, of how many, with the 95 % interval (Clopper-Pearson)."""

    what: str
    hits: int
    n: int

    @property
    def interval(self) -> tuple[float, float]:
        """Return the interval, 0 to 1 of none."""
        low = float(beta.ppf(0.025, self.hits, self.n - self.hits + 1)) if self.hits else 0.0
        high = float(beta.ppf(0.975, self.hits + 1, self.n - self.hits)) if self.hits < self.n else 1.0
        return low, high

    def __str__(self) -> str:
        low, high = self.interval
        share = f"{self.hits / self.n:.3f} ({low:.3f}-{high:.3f})" if self.n else "-"
        return f"{self.what:<60} {share}  {self.hits} of {self.n}"


def rate(what: str, of: Iterable[Answer], hit: Callable[[Answer], bool]) -> Rate:
    """Return how many of some answers hit."""
    hits = [hit(one) for one in of]
    return Rate(what, sum(hits), len(hits))


def score(told: Sequence[Answer]) -> list[Rate]:
    """Return the rates of a batch."""
    by = {kind: [a for a in told if a.truth.kind == kind] for kind in ("none", "one", "two", "outside")}
    one = [a for a in by["one"] if own(a)]
    rates = [rate(f"truth in set, one fault, {low:g}-{high:g}", _between(one, low, high), _whole) for low, high in BINS]
    seen = _between(one, 1.0, 9.0)
    rates.append(rate("truth in set, one fault, >= 1", seen, _whole))
    rates.append(rate("both in sets, two faults, >= 1", _between(filter(own, by["two"]), 1.0, 9.0), _whole))
    other = [a for a in by["one"] if a.truth.faults and not own(a)]
    rates.append(rate("truth in set, one fault of which another form is seen, >= 1", _between(other, 1.0, 9.0), _whole))
    named = [a for a in seen if a.sets]
    rates.append(rate("first name right where one is given, >= 1", named, first_right))
    rates.append(rate("alone and right, one fault, >= 1", seen, _alone))
    rates.append(rate("a wrong name alone in its set, one fault, >= 1", seen, _wrong))
    for law in ("gauss", "t4"):
        rates.append(rate(f"alarm, {law}", [a for a in by["none"] if a.truth.noise == law], alarm))
    rates.append(rate("alarm", by["none"], alarm))
    foreign = _between(by["outside"], 1.0, 9.0)
    for verdict in ("unknown", "partly", "named", "ambiguous"):
        rates.append(rate(f"in no catalogue, >= 1: {verdict}", foreign, lambda a, v=verdict: a.verdict == v))
    rates.append(rate('plain "named" above 1.5 floors', told, overstated))
    return rates


def _between(told: Iterable[Answer], low: float, high: float) -> list[Answer]:
    return [a for a in told if low <= a.truth.visible < high]


def _whole(told: Answer) -> bool:
    return all(in_a_set(fault, told) for fault in told.truth.faults)


def _alone(told: Answer) -> bool:
    return [len(one) for one in told.sets] == [1] and _whole(told)


def _wrong(told: Answer) -> bool:
    true = set().union(*(names_of(fault) for fault in told.truth.faults))
    return any(len(one) == 1 and one[0] not in true for one in told.sets)
