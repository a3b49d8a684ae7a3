"""pycma: its Function counts, its CMADataLogger logs, its CMAEvolutionStrategy asks and is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from answering import Level, answer, cost, full12, points_in, reaching, timed
from small_runs import Sphere

_SEEDS = iter(range(1, 10**9))


def _count(work: Mapping[str, Any]) -> dict[str, Any]:
    import cma

    problem = full12()
    return cost(problem, cma.fitness_transformations.Function(problem), points_in(problem))


def _search(work: Mapping[str, Any]) -> dict[str, Any]:
    import cma

    problem = full12()
    width = problem.upper - problem.lower
    seed = next(_SEEDS)
    start = np.random.default_rng(seed).random(len(width))
    settings = {"bounds": [[0.0] * len(width), [1.0] * len(width)], "verbose": -9, "seed": seed, "popsize": 100}
    search = cma.CMAEvolutionStrategy(start, 0.3, settings)

    def searched() -> int:
        count = 0
        while count < 5000:
            asked = search.ask()
            search.tell(asked, problem.batch(problem.lower + np.array(asked) * width).tolist())
            count += len(asked)
        return count

    return timed(searched)


def _reach(work: Mapping[str, Any]) -> dict[str, Any]:
    import cma

    def searched(level: Level, start: Any, seed: int) -> None:
        width = level.upper - level.lower
        bounds = [[0.0] * len(width), [1.0] * len(width)]
        settings = {"bounds": bounds, "verbose": -9, "seed": seed + 1, "popsize": 100}
        search = cma.CMAEvolutionStrategy((start - level.lower) / width, 0.3, settings)
        while not search.stop():
            asked = search.ask()
            search.tell(asked, level.batch(level.lower + np.array(asked) * width).tolist())

    return reaching(searched)


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    import cma
    import pandas as pd

    sphere, rows = Sphere(), []
    for seed in range(work["runs"]):
        settings = {"bounds": [-5, 5], "verbose": -9, "seed": seed + 1, "maxfevals": work["budget"], "verb_log": 0}
        _, found = cma.fmin2(sphere, np.zeros(5), 2.0, settings)
        rows.append({"seed": seed, "best_value": found.result.fbest, "evaluations": found.result.evaluations})
    table = pd.DataFrame(rows)
    print(table.describe())
    return {"count": len(table), "note": "its CMA-ES in a loop of a user's own; nothing kept on disk"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import cma

    prefix = f"{work['folder']}/outcma/"
    settings = {"bounds": [-5, 5], "verbose": -9, "seed": 1, "maxfevals": work["budget"], "verb_filenameprefix": prefix}
    cma.fmin2(Sphere(), np.zeros(5), 2.0, settings)
    cma.plot(prefix)
    cma.s.figsave(f"{work['folder']}/first.png")
    return {"note": "1 run, the figure of its logger"}


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {"pycma, Function": _count},
    "cmaes": {"pycma": _search},
    "noise_level": {"pycma": _reach},
    "sweep": {"pycma": _sweep},
    "plot": {"pycma": _plot},
}

if __name__ == "__main__":
    answer(LINES)
