"""The table of docs/optimizers.md that says how many members pygmo's populations have, made from the rules."""

from __future__ import annotations

from calibench.bench.report.shared.page import table
from calibench.optimizers.pygmo import RULES

_EXAMPLES = ((2, 1000), (12, 5000), (20, 20_000))  # dimension, budget


def pygmo_table() -> str:
    """Return a row a method: its rule, what it gives, where it is from, and why it looks at the budget."""
    head = [
        "algorithm",
        "members",
        *(f"d = {d}, B = {budget}" for d, budget in _EXAMPLES),
        "source",
        "read again in",
        "why",
    ]
    rows = [
        [
            f"`{rule.method}`",
            f"`{rule.name}`{f', at least {rule.least}' if rule.generations else ''}",
            *(str(rule.size(d, budget)) for d, budget in _EXAMPLES),
            rule.source,
            rule.read,
            rule.why,
        ]
        for rule in RULES.values()
    ]
    return table(head, rows)
