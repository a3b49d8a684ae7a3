"""What the instances 1 to 24 of each family came out as: the table of docs/instances.md.

``python -m benchmarks.answer.drawn`` prints it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from calibench import problems
from calibench.bench.report.shared.page import table

FAMILIES = ("sensor_zero", "link_length", "full11", "full12", "tracking_zero", "orthoglide6")
_HEAD = ("family", "parameters", "directions seen", "poses or readings", "kinds of plan", "without noise", "condition",
         "draws", "most draws")  # fmt: skip


def instances(family: str) -> list[Any]:
    """Return the instances 1 to 24 of a family."""
    return [problems.make(family, instance=k) for k in range(1, 25)]


def drawn_table(of: Callable[[str], list[Any]] = instances) -> str:
    """Return a row a family over its instances `of` it: least .. largest, and how often it was drawn again."""
    return table(_HEAD, [_row(family, of(family)) for family in FAMILIES])


def _row(family: str, made: list[Any]) -> list[str]:
    found = [problems.identify(p) for p in made]
    drawn = [p.drawn for p in made]
    sizes = sorted(len(d.plan) if family == "orthoglide6" else d.plan.n for d in drawn)
    kinds = {d.options["plan"] for d in drawn}
    conditions = sorted(f.condition for f in found)
    tries = [d.attempts for d in drawn]
    (rank,) = {f.rank for f in found}
    return [
        f"`{family}`", str(found[0].dimension), str(rank), f"{sizes[0]} .. {sizes[-1]}", str(len(kinds)),
        str(sum(d.noise.level == 0 for d in drawn)), f"{conditions[0]:.0f} .. {conditions[-1]:.0f}", str(sum(tries)),
        str(max(tries)),
    ]  # fmt: skip


if __name__ == "__main__":
    print(drawn_table())
