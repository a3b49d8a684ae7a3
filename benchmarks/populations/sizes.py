"""``python -m benchmarks.populations.sizes --to FILE.csv``: every pygmo method with populations of many sizes.

A row is a method, a size, a problem, a budget and a seed, with the best value found. One run of the largest budget
tells all budgets, but for the methods that plan their course by the number of generations. ``--tables FILE.csv ...``
prints how many decades each size is behind the best size of the same problem, budget and seed.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from math import log
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.populations.functions import FUNCTIONS, Foreign
from calibench import bench, optimizers, problems
from calibench.bench.report.shared.page import table

BUDGETS = (1000, 5000, 20000)
DIMENSIONS = (2, 5, 10, 20)
OURS = ("sensor_zero", "link_length", "full11", "full12")
PLANNED = ("gwo", "ihs")  # their steps depend on the number of generations
METHODS = ("de", "sade", "de1220", "cmaes", "xnes", "pso", "pso_gen", "sga", "bee_colony", "gaco", "gwo", "ihs")
SIZES = (5, 10, 20, 40, 80, 150)
LEAST = {"sade": 7, "de1220": 7}


def cases() -> Iterator[tuple[str, str, Any]]:
    """Yield (whose, name, problem) of our problems and of the foreign functions."""
    for name in OURS:
        yield "ours", name, problems.make(name)
    for function in FUNCTIONS:
        for dimension in DIMENSIONS:
            yield "foreign", function, Foreign(function, dimension)


def sizes(method: str, dimension: int) -> list[int]:
    """Return the sizes to try, which for the two evolution strategies hold that of their papers."""
    theirs = [4 + int(3 * log(dimension))] if method in ("cmaes", "xnes") else []
    return sorted({size for size in (*SIZES, *theirs) if size >= LEAST.get(method, 5)})


def measure(method: str, size: int, problem: Any, seed: int) -> Iterator[tuple[int, float]]:
    """Yield (budget, best value) of one size and seed."""
    optimizer = optimizers.make(f"pygmo_{method}", population=size)
    for budget in BUDGETS if method in PLANNED else BUDGETS[-1:]:
        run = bench.execute(problem, optimizer, budget=budget, seed=seed, start="random")
        if run.status != "ok":
            raise RuntimeError(f"{method} of {size}: {run.row['error']}")
        if method in PLANNED:
            yield budget, run.best_value
    if method not in PLANNED:
        for budget in BUDGETS:
            yield budget, min(point[2] for point in run.points if point[1] <= budget)


def tables(measured: pd.DataFrame) -> str:
    """Return a table of decades behind the best size, means over problems and seeds, ours / foreign."""
    floor = np.where(measured["whose"] == "foreign", 1e-10, 1e-20)  # deeper is solved: no better
    measured = measured.assign(log=np.log10(np.maximum(measured["best"], floor)))
    measured = measured[measured["size"].isin(SIZES)]
    cell = ["method", "whose", "problem", "dimension", "budget", "seed"]
    measured["behind"] = measured["log"] - measured.groupby(cell)["log"].transform("min")
    means = measured.groupby(["method", "budget", "size", "whose"])["behind"].mean().to_dict()
    lines = []
    for method in METHODS:
        for budget in BUDGETS:
            both = [[means.get((method, budget, size, whose)) for whose in ("ours", "foreign")] for size in SIZES]
            shown = ["" if None in pair else " / ".join(f"{v:.1f}" for v in pair) for pair in both]
            lines.append([f"`{method}`", str(budget), *shown])
    return table(("method", "budget", *(str(size) for size in SIZES)), lines)


def main() -> None:
    """Write the rows as they come, or print the table of files."""
    parser = argparse.ArgumentParser(prog="benchmarks.populations.sizes")
    parser.add_argument("methods", nargs="*", default=METHODS)
    parser.add_argument("--to", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--tables", type=Path, nargs="*")
    chosen = parser.parse_args()
    if chosen.tables:
        print(tables(pd.concat([pd.read_csv(file) for file in chosen.tables])))
        return
    with chosen.to.open("w", newline="", buffering=1) as file:
        writer = csv.writer(file)
        writer.writerow(("method", "size", "whose", "problem", "dimension", "budget", "seed", "best"))
        for seed in range(chosen.seeds):
            for whose, name, problem in cases():
                for method in chosen.methods:
                    for size in sizes(method, len(problem.lower)):
                        for budget, best in measure(method, size, problem, seed):
                            writer.writerow((method, size, whose, name, len(problem.lower), budget, seed, best))


if __name__ == "__main__":
    main()
