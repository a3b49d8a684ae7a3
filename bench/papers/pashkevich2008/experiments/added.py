"""What the page on the Orthoglide's experiments says of the family that entered the catalogue after the fits."""

from __future__ import annotations

from collections.abc import Iterable

from calibench.bench.papers.pashkevich2008.experiments.tables import SETS, WEIGHTING
from calibench.bench.report.shared.markdown import table, text
from calibench.discrepancy.machines.orthoglide.experiments import ADDED_LATER, Experiments


def added_later(found: Experiments) -> Iterable[str]:
    """Yield when the family was added, what that costs by three prices, and which of them holds."""
    late, _ = found.prices["exp2", False]
    yield f"## `{ADDED_LATER}` was added afterwards"
    yield text(
        f"""The history of this repository says so: the sets were fitted and Experiment 3 was predicted in commit
        8faa0e2 (2026-11-21 13:55), `{ADDED_LATER}` entered the catalogue in d6cdf45 (14:05), ten minutes later, by who
        had seen what the fits had left. The same commit took out gauges that lean or stand elsewhere where no plausible
        size would show, and they had fitted exp3_t2 well. A p that counts a list of candidates holds for a list that
        was there before the data; this one was not."""
    )
    yield text(
        f"""Three prices, of {found.draws} turns of the misfit. *As it stands*: the chance that the best of the present
        catalogue does as well on noise; the p of the tables above. *All ever tried*: what was taken out is counted too.
        *With the choice*: besides, one of {late.others} further families of the same shape might have been written,
        as many as the catalogue has others; each would do on noise as well as `{ADDED_LATER}` alone does. The right
        price of `{ADDED_LATER}` is the last, as it was written to a residual that had been seen; and it is a lower
        bound, for nobody counted what else was thought of. The right price of what was there from the beginning is
        *all ever tried*, for taking the family out again would be a second choice. "Without" is the p of all as it was
        before the family was added."""
    )
    rows = []
    for name in SETS:
        for weighted in [w for w in (False, True) if (name, w) in found.prices]:
            for one in found.prices[name, weighted]:
                without = "" if one.listed is None else f"{one.listed:.2f}"
                choice = "" if one.chosen is None else f"{one.chosen:.2f}"
                numbers = (f"{one.p:.4f}", without, f"{one.now:.2f}", f"{one.ever:.2f}", choice, f"**{one.right:.2f}**")
                rows.append((name, WEIGHTING[weighted], one.name, *numbers))
    yield table(
        ("set", "", "candidate", "p", "without", "as it stands", "all ever tried", "with the choice", "right"), rows
    )
    yield text(
        f"""No price makes a name: .01 is asked for, and the least is
        {min(one.right for pair in found.prices.values() for one in pair):.2f}. Experiment 3 does not make up for it, as
        its numbers had been seen as well when the family was written. Only readings taken from now on can test
        `{ADDED_LATER}` at its own p."""
    )
