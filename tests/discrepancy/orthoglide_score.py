"""How often an explanation of a simulated Orthoglide is right: `python -m tests.discrepancy.orthoglide_score [seeds]`.

Families are asked one by one. On the cross plan (with loads for gravity) the first name must be the right one; on the
paper's plan what cannot be told apart must not be told apart: there a single name is right only if it is the truth.
The part `bent` has each seed's family in turn, its form off by 5 to 15 %: `300 --first 660000 --plans bent`.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from scipy.stats import beta

from benchmarks.blind.orthoglide import PATTERNS, TARGETS, Case, case

CONFOUNDED = ("thermal_legs", "gravity", "drift")  # on the paper's plan


@dataclass
class Tally:
    """Counts over the cases of one family on one plan."""

    cases: int = 0
    right: int = 0  # the first name is the truth
    inside: int = 0  # the truth is in the set, or among the twins
    single: int = 0  # a single name, and the right one
    guessed: int = 0  # a single name, and a wrong one
    missed: int = 0  # a set without the truth
    silent: int = 0  # none, negligible, unknown
    hidden: int = 0  # silent, but listed as what these readings could not have shown
    verdicts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    amplitudes: list[bool] = field(default_factory=list)  # the interval of a right first name holds the truth
    gaps: list[bool] = field(default_factory=list)  # that of the held-out gap holds the floor, names right or absent

    def line(self) -> str:
        """Return the tally in a line."""
        return (
            f"{self.right:4d} right {self.inside:4d} in set {self.single:4d} single {self.guessed:4d} guessed "
            f"{self.missed:4d} missed {self.silent:4d} silent ({self.hidden} told untestable) of {self.cases:4d}  "
            f"amplitude {rate(self.amplitudes)}  gap {rate(self.gaps)}  {'; '.join(self.wrong[:6])}"
        )


def rate(hits: Sequence[bool]) -> str:
    """Return a rate with its 95 % binomial interval, "-" of nothing."""
    n, k = len(hits), sum(hits)
    if not n:
        return "-"
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return f"{k / n:.3f} [{low:.3f}, {high:.3f}] of {n}"


def explained(hidden: Case, name: str = "case"):  # type: ignore[no-untyped-def]
    """Return the report on a simulated table, which is told nothing but the table."""
    from calibench.discrepancy import MeasuredData
    from calibench.discrepancy.procedure import explain

    return explain("orthoglide", MeasuredData(hidden.columns, "orthoglide", hidden.metadata, name))


def tally(family: str, seeds: range, plan: str, targets: Sequence[str] = ("",), bent: bool = False) -> Tally:
    """Return the counts for one family ("" for nothing hidden), each seed at each of `targets` ("": drawn)."""
    told = Tally()
    for seed in seeds:
        for target in targets:
            _count(told, case(seed, family, target, plan=plan, bent=bent))
    return told


def _count(told: Tally, hidden: Case) -> None:
    report = explained(hidden)
    family, target = hidden.truth["family"], hidden.truth["target"]
    truth = f"{family} {target}"
    sets = [{rival.effect for rival in finding.set} | {finding.effect} for finding in report.findings]
    told.cases += 1
    told.verdicts[report.verdict] += 1
    silent = report.verdict in ("none", "unknown", "negligible")
    told.silent += silent
    told.hidden += silent and any(u.family == family and u.target in ("all", target) for u in report.not_testable)
    inside = any(truth in members for members in sets)
    told.inside += inside
    right = len(report.findings) == 1 and report.findings[0].effect == truth
    told.right += right or (family == "none" and report.verdict == "none")
    told.single += right and report.verdict == "named"
    told.guessed += report.verdict == "named" and not right
    told.missed += report.verdict == "ambiguous" and not inside
    if report.findings and not right:
        names = " + ".join("|".join(rival.effect for rival in finding.set) for finding in report.findings)
        told.wrong.append(f"{hidden.truth['seed']}: {truth} ({hidden.truth['lambda']:.1f}) called {names}")
    if right:
        low, high = sorted(report.findings[0].amplitude.ci95)
        size = hidden.truth["amplitude"]  # its sign is the simulator's own
        told.amplitudes.append(low <= size <= high or low <= -size <= high)
    low, high = report.gap.held_out_ci95
    if (right or (family == "none" and report.verdict == "none")) and low == low:
        told.gaps.append(low <= report.gap.noise_floor <= high)


def plan_of(family: str) -> str:
    """Return the plan on which a family can be told from all others."""
    return "loaded" if family == "gravity" else "cross"


def main() -> None:
    """Print the tallies of all families on the cross plan and on the paper's plan, and of empty cases."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("seeds", type=int, nargs="?", default=20)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument("--families", default=",".join(TARGETS))
    asked.add_argument("--plans", default="cross,nothing,patterns,paper")
    wanted = asked.parse_args()
    seeds, families = range(wanted.first, wanted.first + wanted.seeds), wanted.families.split(",")
    for part in wanted.plans.split(","):
        if part == "nothing":
            many = range(wanted.first, wanted.first + 5 * wanted.seeds)
            for plan in ("cross", "loaded", "paper"):
                print(f"{'nothing':18s} {plan:7s}", tally("", many, plan).line(), flush=True)
            continue
        if part == "bent":  # seeds shared out among the families, each its own
            for i, family in enumerate(TARGETS):
                told = tally(family, seeds[i :: len(TARGETS)], plan_of(family), bent=True)
                print(f"{family:18s} {'bent':7s}", told.line(), flush=True)
            continue
        for family in PATTERNS if part == "patterns" else families:
            plan = "paper" if part == "paper" else plan_of(family)
            targets = PATTERNS[family] if part == "patterns" else ("",)
            word = "pattern" if part == "patterns" else plan
            print(f"{family:18s} {word:7s}", tally(family, seeds, plan, targets).line(), flush=True)


if __name__ == "__main__":
    main()
