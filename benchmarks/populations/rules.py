"""``python -m benchmarks.populations.rules --to FILE.csv``: one number for all against the rules, method by method.

`before` is what each method had when one default held for every dimension and budget; `after` is its rule, or ipopt's
memory. Random starts; a row is a problem, a budget and a seed, with both best values. Seeds are drawn outermost, so
that a run cut short holds whole seeds. ``--tables FILE.csv`` prints the medians as the page has them.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.populations.sizes import cases
from calibench import bench, optimizers
from calibench.bench.report.shared.page import table

BEFORE: Mapping[str, Mapping[str, int]] = {
    "de": {"population": 150}, "sade": {"population": 150}, "de1220": {"population": 150},
    "cmaes": {"population": 50}, "xnes": {"population": 50}, "pso": {"population": 50}, "pso_gen": {"population": 50},
    "sga": {"population": 150}, "bee_colony": {"population": 20}, "gaco": {"population": 100, "ker": 63},
    "gwo": {"population": 50}, "ihs": {"population": 50}, "ipopt": {"memory": 6},
}  # fmt: skip
BUDGETS = (5000, 20_000)
SOLVED = 1e-10  # of the foreign functions, whose minimum is 0: deeper is not better
FLOOR = 1e-20


def rows(whose: str, seeds: range, methods: Sequence[str]) -> Iterator[tuple[Any, ...]]:
    """Yield (whose, problem, dimension, method, budget, seed, before, after)."""
    for seed in seeds:
        for owner, name, problem in cases():
            if owner != whose:
                continue
            for method in methods:
                options = BEFORE[method]
                for budget in BUDGETS:
                    found = [
                        bench.execute(
                            problem,
                            optimizers.make(f"pygmo_{method}", **chosen),
                            budget=budget,
                            seed=seed,
                            start="random",
                        ).best_value
                        for chosen in (options, {})
                    ]
                    yield owner, name, len(problem.lower), method, budget, seed, *found


def tables(measured: pd.DataFrame) -> str:
    """Return a table of medians of log10 of the best value, before and after, and the gain, over problems and seeds."""
    floor = np.where(measured["whose"] == "foreign", SOLVED, FLOOR)
    for when in ("before", "after"):
        measured[f"log_{when}"] = np.log10(np.maximum(measured[when], floor))
    measured["gain"] = measured["log_before"] - measured["log_after"]
    lines = []
    for method in BEFORE:
        line = [f"`pygmo_{method}`"]
        for budget in BUDGETS:
            cell = measured[(measured["method"] == method) & (measured["budget"] == budget)]
            before, after = (float(cell[f"log_{when}"].median()) for when in ("before", "after"))
            gains = cell.groupby(["problem", "dimension"])["gain"].median()
            won, lost = int((gains > 0.3).sum()), int((gains < -0.3).sum())
            gain = f"{cell['gain'].median():+.1f}"
            line += [f"{before:.1f}", f"{after:.1f}", gain, f"{won} : {lost} of {len(gains)}"]
        lines.append(line)
    heads = [f"{word}, {budget}" for budget in BUDGETS for word in ("before", "after", "gain", "problems")]
    return table(("method", *heads), lines)


def main() -> None:
    """Write the rows as they come, or print the tables of a file."""
    parser = argparse.ArgumentParser(prog="benchmarks.populations.rules")
    parser.add_argument("methods", nargs="*", default=list(BEFORE))
    parser.add_argument("--to", type=Path)
    parser.add_argument("--tables", type=Path)
    parser.add_argument("--whose", choices=("ours", "foreign"), default="ours")
    parser.add_argument("--seeds", type=int, default=5)
    chosen = parser.parse_args()
    if chosen.tables:
        print(tables(pd.read_csv(chosen.tables)))
        return
    with chosen.to.open("w", newline="", buffering=1) as file:
        writer = csv.writer(file)
        writer.writerow(("whose", "problem", "dimension", "method", "budget", "seed", "before", "after"))
        writer.writerows(rows(chosen.whose, range(chosen.seeds), chosen.methods))


if __name__ == "__main__":
    main()
