"""Section 3.3 of Cong et al. 2008 under each variant of `fmincon`, because the paper does not print its release.

A variant is a rule of the difference step, a stopping test and its place (`optimizers.fmincon.options`).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import comb
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from calibench.bench.papers.cong2008.figures import COLUMNS
from calibench.bench.papers.ledger import Evidence, Ours, Printed, Row, Ruling, Verdict, problem as make_problem
from calibench.optimizers.fmincon import fmincon
from calibench.optimizers.fmincon.options import StopPlace

Stop = Literal["relative"] | StopPlace
End = Mapping[str, float]  # where a stop ends a search: kmrmse [mm], iterations, and the calibrated values by name
STOPS: tuple[Stop, ...] = ("relative", "after_step", "next_gradient", "before_step")
STEPS = ("typical_x", "gradient")
# its own plan and random ones: ratios of Table 2 differ more between plans
PLANS = {"sensor_zero": 31, "link_length": 15, "full11": 7, "full12": 7}
_MARK = {"true": "✓", "true in kind": "≈", "false": "✗", "open": "?"}
_TOLERANCE = 1e-6  # TolX, TolFun and TolCon as they were by default
_RELEASES: dict[tuple[str, Stop], str] = {
    ("gradient", "after_step"): "1998", ("gradient", "next_gradient"): "about 2002",
    ("typical_x", "next_gradient"): "2003-2008", ("typical_x", "before_step"): "2009",
}  # fmt: skip


@final
@dataclass(frozen=True)
class Variant:
    """A way in which fmincon may have been built."""

    step: str
    stop: Stop

    @property
    def release(self) -> str:
        """Return the years of the releases that were built so; empty where none was."""
        return _RELEASES.get((self.step, self.stop), "")


MATLAB = Variant("gradient", "next_gradient")  # what the preset fmincon_matlab is
VARIANTS = tuple(Variant(step, stop) for step, stop in product(STEPS, STOPS))
RELEASES = tuple(Variant(step, stop) for step, stop in _RELEASES)


@final
@dataclass(frozen=True)
class Judged:
    """A claim under one variant: the ratios, one a plan, and the limits of true and true in kind of their median."""

    variant: Variant
    ratios: tuple[float, ...]
    limits: tuple[float, float]

    @property
    def median(self) -> float:
        return float(np.median(self.ratios))

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of the median over all plans: two order statistics, as in a sign test."""
        n, sorted_ratios = len(self.ratios), sorted(self.ratios)
        tail = [sum(comb(n, j) for j in range(i + 1)) / 2**n for i in range(n)]  # that at most i are below the median
        i = max((i for i in range(n // 2) if tail[i] <= 0.025), default=0)  # under six plans: all that was found
        return sorted_ratios[i], sorted_ratios[n - 1 - i]

    @property
    def state(self) -> Literal["true", "true in kind", "false", "open"]:
        """Return on which side of the limits the whole interval lies; open where it lies on both."""
        low, high = self.interval
        if high <= self.limits[0]:
            return "true"
        if high <= self.limits[1]:
            return "true in kind"
        return "false" if low > self.limits[1] else "open"


def verdict_of(judged: Sequence[Judged]) -> Verdict:
    """Return the verdict on a claim from its states under the variants: releases judge, relative stops are controls.

    False in every release: not reproduced; in some and true in others: it depends on plan or release; in none and true
    in some: an artefact of the stopping tolerance where a control is false, else reproduced (in kind where any is).
    """
    releases = [j.state for j in judged if j.variant.release]
    controls = [j.state for j in judged if j.variant.stop == "relative"]
    if all(state == "false" for state in releases):
        return "not reproduced"
    if not any(state in ("true", "true in kind") for state in releases):
        return "not checkable"
    if "false" in releases:
        return "depends on plan or release"
    if "false" in controls:
        return "artefact of the stopping tolerance"
    return "reproduced" if {*releases, *controls} == {"true"} else "reproduced in kind"


def options_of(variant: Variant) -> dict[str, Any]:
    """Return the options of `fmincon` that make it this variant, with the tolerances that were MATLAB's defaults."""
    options: dict[str, Any] = {
        "OptimalityTolerance": 0.0 if variant.stop == "after_step" else _TOLERANCE,  # that of 1998 had no such test
        "StepTolerance": _TOLERANCE, "FiniteDifferenceStepRule": variant.step, "ScaleVariables": False,
        "MaxIterations": 400, "DiffMinChange": 1e-8, "DiffMaxChange": 0.1,  # MATLAB's until 2010
    }  # fmt: skip
    if variant.stop != "relative":
        options |= {"StopRule": "absolute", "StopPlace": variant.stop, "FunctionTolerance": _TOLERANCE}
    return options


@cache
def end(problem: str, options: tuple[tuple[str, Any], ...], variant: Variant) -> End:
    """Return where a variant ends the search on a problem with these options from its printed start."""
    built = make_problem(problem, **dict(options))
    found = fmincon(built, built.start, lb=built.lower, ub=built.upper, options=options_of(variant))
    names, values = (p.name for p in built.parameters), map(float, built.physical(found.x))
    merit = {"kmrmse": built.merit(found.x)["kmrmse"], "iterations": float(found.output.iterations)}
    return merit | dict(zip(names, values, strict=True))


def plan(problem: str, number: int) -> dict[str, Any]:
    """Return the options of plan `number`: -1 the problem's own, from 0 on those of the study cong2008_plans."""
    if number < 0:
        return {}
    return {"plan": "disc", "data_seed": number} | ({"radius": 60.0} if problem == "sensor_zero" else {})


def column(key: str, variant: Variant) -> list[End]:
    """Return the ends of a column of Tables 2 to 4 under a variant, one for each plan."""
    problem, options = COLUMNS[key]
    asked = [tuple(sorted((options | plan(problem, number)).items())) for number in range(-1, PLANS[problem] - 1)]
    return [end(problem, one, variant) for one in asked]


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
        return printed.column(self.above)[self.quantity] / printed.column(self.below)[self.quantity]


CLAIMS = (
    *(
        Claim(
            f"more_samples_{e}", "Section 3.3 A", f"more samples are more precise ({e})", f"table2.{e.lower()}_n9",
            f"table2.{e.lower()}_n3", "without noise the stop limits the precision, and plans differ more than stops",
        )
        for e in ("J1", "J2")
    ),
    *(
        Claim(f"j2_beats_j1_{key}", place, f"J2 gives more precise results than J1 ({key})", above, below, _UNITS)
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
        quantity="iterations", limits=(0.9, 1.0),
    ),
)  # fmt: skip


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield the claims; `ours` are the medians of the releases."""
    for claim in CLAIMS:
        judged = judge_claim(claim)
        releases = [f"{j.variant.release} {_cell(j)}" for j in judged if j.variant.release]
        controls = [f"{j.variant.step} {_cell(j)}" for j in judged if j.variant.stop == "relative"]
        told = f"releases: {', '.join(releases)}; with a relative stop: {', '.join(controls)}"
        ours = Ours.of([j.median for j in judged if j.variant.release])
        yield printed.claim(
            claim.key, claim.place, claim.sentence, ours=ours,
            ruling=Ruling(verdict_of(judged), ours.median, "at most, in every release", *claim.limits),
            rule=f"in a variant true below {claim.limits[0]:g}, in kind below {claim.limits[1]:g}, {_OVER_VARIANTS}",
            method=f"{claim.quantity} of {claim.above} over {claim.below}, the median of {len(judged[0].ratios)} "
            "plans, in four releases of fmincon",
            reason="; ".join(text for text in (told, claim.why) if text), printed=claim.printed(printed),
        )  # fmt: skip


@cache
def judge_claim(claim: Claim) -> tuple[Judged, ...]:
    """Return the claim under each variant, over its plans."""
    judged = []
    for variant in VARIANTS:
        pairs = zip(column(claim.above, variant), column(claim.below, variant), strict=True)
        ratios = tuple(a[claim.quantity] / b[claim.quantity] for a, b in pairs)
        judged.append(Judged(variant, ratios, claim.limits))
    return tuple(judged)


def write_table(path: Path) -> Path:
    """Write the claims by variants as a page, median and its interval over the plans, beside the printed one."""
    printed = Printed("cong2008")
    judged = {claim: judge_claim(claim) for claim in CLAIMS}
    heads = ["step", "stop", "MATLAB of", *(claim.key for claim in CLAIMS)]
    lines = [heads, ["---"] * len(heads), ["printed", "", "", *(f"{c.printed(printed):.2g}" for c in CLAIMS)]]
    for number, variant in enumerate(VARIANTS):
        cells = [_cell(judged[claim][number]) for claim in CLAIMS]
        lines.append([variant.step, variant.stop, variant.release, *cells])
    lines.append(["**verdict**", "", "", *(verdict_of(judged[claim]) for claim in CLAIMS)])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
    asked = {COLUMNS[key][0] for claim in CLAIMS for key in (claim.above, claim.below)}
    counts = ", ".join(f"{count} plans of {problem}" for problem, count in PLANS.items() if problem in asked)
    head = f"# Section 3.3 of Cong et al. 2008 over the variants of fmincon\n\nMedians (95 %) of {counts}. "
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(head + "What they are: docs/fmincon.md, Releases.\n\n" + table, encoding="utf-8")
    return path


def _cell(judged: Judged) -> str:
    low, high = judged.interval
    return f"{_MARK[judged.state]} {judged.median:.2g} ({low:.2g} .. {high:.2g})"
