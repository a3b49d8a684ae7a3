"""What the page on the Orthoglide's experiments says of the family that entered the catalogue after the fits."""

from __future__ import annotations

from collections.abc import Iterable

from calibench.bench.papers.pashkevich2008.experiments.tables import SETS, WEIGHTING
from calibench.bench.report.shared.markdown import table, text
from calibench.discrepancy.machines.orthoglide.experiments import ADDED_LATER, Experiments


def added_later(found: Experiments) -> Iterable[str]:
    """Yield when the family was added, and what that costs."""
    late, _ = found.prices["exp2", False]
    yield f"## `{ADDED_LATER}` was added afterwards"
    yield text(
        f"""`{ADDED_LATER}` entered the catalogue (commit d6cdf45) after the sets had been fitted (8faa0e2), by who had
        seen what the fits leave. So its p has to pay for that choice. *As it stands*: the chance that the best of the
        present catalogue does as well on noise ({found.draws} turns of the misfit). *Right*: what was taken out in the
        same commit is counted too, and for `{ADDED_LATER}` that one of {late.others} further families of the same
        shape might have been written, as many as the catalogue has others; that is a lower bound."""
    )
    rows = []
    for name in SETS:
        for weighted in [w for w in (False, True) if (name, w) in found.prices]:
            for one in found.prices[name, weighted]:
                numbers = (f"{one.p:.4f}", f"{one.now:.2f}", f"**{one.right:.2f}**")
                rows.append((name, WEIGHTING[weighted], one.name, *numbers))
    yield table(("set", "", "candidate", "p", "as it stands", "right"), rows)
    yield text(
        f"""No price makes a name: .01 is asked for, and the least is
        {min(one.right for pair in found.prices.values() for one in pair):.2f}. Only new readings can test
        `{ADDED_LATER}` at its plain p."""
    )
