"""The sentences of section 3.3 about which J is more precise, judged in each variant of fmincon, and the table of it.

Each is a ratio of two printed numbers. In a variant ours is the median over the plans, which are not printed either;
the rule of `cong2008_stopping.verdict_of` makes the verdicts of the variants into one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import final

from calibench.bench.papers.cong2008.section3.stopping import (
    COLUMNS,
    PLANS,
    VARIANTS,
    Judged,
    Variant,
    column,
    verdict_of,
)
from calibench.bench.papers.evidence import Evidence
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Ours, Row, Ruling

_OVER_VARIANTS = (
    "with the whole 95 % interval of the median, else open. Over the variants: not reproduced where every release "
    "refutes it, dependent on plan or release where one does and another makes it true, an artefact of the stopping "
    "tolerance where only a relative stop refutes it, in kind where one is open"
)
_UNITS = (
    "near zero J1 is J2 / (4 l_b^2), 2.4e5 times smaller: an absolute stop ends J1 earlier, and steps of -1e-8 / g are "
    "longer for it"
)


@final
@dataclass(frozen=True)
class Claim:
    """A sentence as a ratio of one column to another; `limits` of true and true in kind."""

    key: str
    place: str
    sentence: str
    above: str
    below: str
    why: str
    quantity: str = "kmrmse"
    limits: tuple[float, float] = (0.5, 0.75)

    def printed(self, printed: Printed) -> float:
        """Return the printed ratio."""
        return printed.column(self.above)[self.quantity] / printed.column(self.below)[self.quantity]

    def said(self) -> str:
        """Return what is measured in a variant."""
        return f"{self.quantity} of {self.above} over {self.below}"


CLAIMS = (
    *(
        Claim(
            f"more_samples_{e}", "Section 3.3 A", f"more samples are more precise ({e})", f"table2.{e.lower()}_n9",
            f"table2.{e.lower()}_n3", "without noise the stop limits the precision, and plans differ more than stops",
        )
        for e in ("J1", "J2")
    ),
    *(
        Claim(
            f"j2_beats_j1_{key}", place, f"J2 gives more precise results than J1 ({key})", above, below, _UNITS,
        )
        for key, place, above, below in (
            ("table2_n3", "Section 3.3 A", "table2.j2_n3", "table2.j1_n3"),
            ("table2_n9", "Section 3.3 A", "table2.j2_n9", "table2.j1_n9"),
            ("table3", "Section 3.3 B", "table3.j2", "table3.j1"),
        )
    ),
    Claim(
        "j3_beats_j2_table3", "Section 3.3 B", "J3 gives more precise results than J2", "table3.j3", "table3.j2",
        "the difference step decides it, not the stop: differences limit J3, and steps of -1e-8 / g err less than "
        "those of eps^(1/2) |x|; its mixed units limit J2 with either; with the exact gradient all reach 1e-12 mm",
    ),
    Claim(
        "j3_iterations", "Section 3.3 B", "J3 takes fewer iterations than J2", "table3.j3", "table3.j2", "",
        "iterations", (0.9, 1.0),
    ),
)  # fmt: skip


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield the claims; `ours` are the medians of the releases."""
    for claim in CLAIMS:
        judged = judge_claim(claim)
        ours = Ours.of([j.median for j in judged if j.variant.release])
        ruling = Ruling(verdict_of(judged), ours.median, "at most, in every release", *claim.limits)
        yield printed.claim(
            claim.key, claim.place, claim.sentence, ours, ruling,
            f"in a variant true below {claim.limits[0]:g}, in kind below {claim.limits[1]:g}, "
            f"{_OVER_VARIANTS}",
            f"{claim.said()}, the median of {len(judged[0].ratios)} plans, in four releases of fmincon",
            "; ".join(text for text in (_sentence(judged), claim.why) if text), printed=claim.printed(printed),
        )  # fmt: skip


def _sentence(judged: Sequence[Judged]) -> str:
    """Return what each release and each control gives."""
    releases = [f"{j.variant.release} {_cell(j)}" for j in judged if j.variant.release]
    controls = [f"{j.variant.step} {_cell(j)}" for j in judged if j.variant.stop == "relative"]
    return f"releases: {', '.join(releases)}; with a relative stop: {', '.join(controls)}"


@cache
def judge_claim(claim: Claim, variants: tuple[Variant, ...] = VARIANTS, most: int = 1000) -> tuple[Judged, ...]:
    """Return the claim under each variant, over its plans, of which at most `most`."""
    found = []
    for variant in variants:
        above, below = (column(key, variant, most) for key in (claim.above, claim.below))
        if claim.quantity == "iterations":
            ratios = tuple(a.iterations / b.iterations for a, b in zip(above, below, strict=True))
        else:
            ratios = tuple(a.kmrmse / b.kmrmse for a, b in zip(above, below, strict=True))
        found.append(Judged(variant, ratios, claim.limits))
    return tuple(found)


def table(variants: tuple[Variant, ...] = VARIANTS, most: int = 1000) -> str:
    """Return claims by variants in Markdown: median and its interval over the plans, beside the printed one."""
    printed = Printed("cong2008")
    judged = {claim: judge_claim(claim, variants, most) for claim in CLAIMS}
    heads = ["step", "stop", "MATLAB of", *(claim.key for claim in CLAIMS)]
    lines = [heads, ["---"] * len(heads), ["printed", "", "", *(_short(c.printed(printed)) for c in CLAIMS)]]
    for number, variant in enumerate(variants):
        cells = [variant.step, variant.stop, variant.release]
        lines.append([*cells, *(_cell(judged[claim][number]) for claim in CLAIMS)])
    lines.append(["**verdict**", "", "", *(verdict_of(judged[claim]) for claim in CLAIMS)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def write_table(path: Path) -> Path:
    """Write the table as a page and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    asked = {COLUMNS[key][0] for claim in CLAIMS for key in (claim.above, claim.below)}
    counts = ", ".join(f"{count} plans of {problem}" for problem, count in PLANS.items() if problem in asked)
    said = f"# Section 3.3 of Cong et al. 2008 over the variants of fmincon\n\nMedians (95 %) of {counts}. "
    path.write_text(said + "What they are: docs/fmincon.md, Releases.\n\n" + table(), encoding="utf-8")
    return path


_MARK = {"true": "✓", "true in kind": "≈", "false": "✗", "open": "?"}


def _cell(judged: Judged) -> str:
    low, high = judged.interval
    return f"{_MARK[judged.state]} {_short(judged.median)} ({_short(low)} .. {_short(high)})"


def _short(number: float) -> str:
    return f"{number:.2g}"
