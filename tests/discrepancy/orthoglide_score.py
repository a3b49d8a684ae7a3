"""How often an explanation of a simulated Orthoglide is right: `python -m tests.discrepancy.orthoglide_score [seeds]`.

Families are asked one by one. On the cross plan (with loads for gravity) the first name must be the right one; on the
paper's plan what cannot be told apart must not be told apart: there a single name is right only if it is the truth.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field

from tests.sealed.orthoglide import TARGETS, Case, case

CONFOUNDED = ("thermal_legs", "gravity", "drift")  # on the paper's plan


@dataclass
class Tally:
    """Counts over the cases of one family on one plan."""

    cases: int = 0
    right: int = 0  # the first name is the truth
    inside: int = 0  # the truth is in the set, or among the twins
    guessed: int = 0  # a single name, and a wrong one
    silent: int = 0  # none, negligible, unknown
    verdicts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def line(self) -> str:
        """Return the tally in a line."""
        return (
            f"{self.right:4d} right {self.inside:4d} in set {self.guessed:4d} guessed {self.silent:4d} silent "
            f"of {self.cases:4d}  {dict(self.verdicts)}  {'; '.join(self.wrong[:4])}"
        )


def explained(hidden: Case, name: str = "case"):  # type: ignore[no-untyped-def]
    """Return the report on a simulated table, which is told nothing but the table."""
    from discrepancy import MeasuredData
    from discrepancy.explain import explain

    return explain("orthoglide", MeasuredData(hidden.columns, "orthoglide", hidden.metadata, name))


def tally(family: str, seeds: range, plan: str) -> Tally:
    """Return the counts for one family ("" for nothing hidden)."""
    told = Tally()
    for seed in seeds:
        hidden = case(seed, family, plan=plan)
        report = explained(hidden)
        truth = f"{family} {hidden.truth['target']}"
        sets = [{rival.effect for rival in finding.set} | {finding.effect} for finding in report.findings]
        told.cases += 1
        told.verdicts[report.verdict] += 1
        told.silent += report.verdict in ("none", "unknown", "negligible")
        told.inside += any(truth in members for members in sets)
        right = bool(report.findings) and len(report.findings) == 1 and report.findings[0].effect == truth
        told.right += right or (not family and report.verdict == "none")
        told.guessed += report.verdict == "named" and not right
        if report.findings and not right:
            names = " + ".join(finding.effect for finding in report.findings)
            told.wrong.append(f"{seed}: {truth} ({hidden.truth['lambda']:.1f}) called {names}")
    return told


def main(seeds: int = 20) -> None:
    """Print the tallies of all families on the cross plan and on the paper's plan, and of empty cases."""
    for family in TARGETS:
        plan = "loaded" if family == "gravity" else "cross"
        print(f"{family:18s} {plan:7s}", tally(family, range(seeds), plan).line(), flush=True)
    for plan in ("cross", "loaded", "paper"):
        print(f"{'nothing':18s} {plan:7s}", tally("", range(5 * seeds), plan).line(), flush=True)
    for family in (f for f in TARGETS if f not in ("gauge_placement",)):
        print(f"{family:18s} paper  ", tally(family, range(seeds), "paper").line(), flush=True)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
