"""Which methods differ over all problems: Friedman's test as a table, with what each pair's test says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.bench.report.shared.page import Table
from calibench.bench.report.study.html_tables import number, table
from calibench.bench.statistics.comparison.many_methods import Ranked
from calibench.core.counted import counted, listed


@final
@dataclass(frozen=True)
class Differing:
    """A sentence on the test, and a row a method, best first."""

    told: str
    table: Table


def differing(ranked: Ranked) -> Differing:
    """Return the table of a test that was not refused: mean ranks, p-values after correction, and who differs."""
    alike = ranked.nemenyi >= ranked.level
    np.fill_diagonal(alike, False)
    differ = int((~alike).sum() - len(ranked.methods)) // 2
    pairs = len(ranked.methods) * (len(ranked.methods) - 1) // 2
    level = f"{100 * ranked.level:g} %"
    told = (
        f"Friedman's test over {counted(ranked.blocks, 'block')} (a problem with its instance under one start and "
        f"budget; seeds are none): p = {number(ranked.p)}. "
        + (
            f"Of {counted(pairs, 'pair')} of methods {differ} differ at the {level} level (Nemenyi's test, which is "
            f"corrected for all pairs): mean ranks that are {number(ranked.critical_difference, 3)} apart or more."
            if ranked.p < ranked.level
            else f"The ranks do not tell the methods apart at the {level} level, and what pairs say is not to be read."
        )
        + (f" {ranked.left_out}." if ranked.left_out else "")
    )
    heads = [
        ("method", ""), ("mean rank", "n"), ("p against the first, Holm", "n"), ("p against the first, Nemenyi", "n"),
        ("differs from", "why"), ("not told apart from", "why"),
    ]  # fmt: skip
    rows = []
    for i, name in enumerate(ranked.methods):
        others = [j for j in range(len(ranked.methods)) if j != i]
        rows.append(
            [
                name, f"{ranked.mean_ranks[i]:.2f}", number(ranked.against_best[i]),
                number(ranked.nemenyi[0, i]) if i else "–",
                *(_named(ranked, [j for j in others if alike[i, j] == same]) for same in (False, True)),
            ]
        )  # fmt: skip
    return Differing(told, table(heads, rows))


_SHOWN = 8  # names in a cell, beyond which they are counted


def _named(ranked: Ranked, at: list[int]) -> str:
    if len(at) == len(ranked.methods) - 1 and len(at) > 1:
        return "all others"
    return listed([ranked.methods[j] for j in at], _SHOWN) or "none"
