"""nevergrad: its optimisers ask and are told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from answering import Level, answer, full12, reaching, timed
from small_runs import Sphere

_SEEDS = iter(range(10**9))
_BUDGET = 1500  # a slow one would make a round too long for its neighbours


def _count(work: Mapping[str, Any]) -> dict[str, Any]:
    """Time ask and tell of its RandomSearch: it counts nowhere else."""
    import nevergrad

    problem = full12()
    space = nevergrad.p.Array(init=problem.start.copy()).set_bounds(problem.lower, problem.upper)
    search = nevergrad.optimizers.registry["RandomSearch"](parametrization=space, budget=_BUDGET)

    def asked() -> int:
        for _ in range(_BUDGET):
            search.tell(search.ask(), 1.0)
        return _BUDGET

    return {**timed(asked), "note": "ask and tell of its RandomSearch: it counts nowhere else"}


def _search(make: Callable[[Any], Any], work: Mapping[str, Any]) -> dict[str, Any]:
    import nevergrad

    problem = full12()
    space = nevergrad.p.Array(init=problem.start.copy()).set_bounds(problem.lower, problem.upper)
    search = make(nevergrad)(parametrization=space, budget=_BUDGET)
    space.random_state.seed(next(_SEEDS))

    def searched() -> int:
        for _ in range(_BUDGET):
            asked = search.ask()
            search.tell(asked, problem(asked.value))
        return _BUDGET

    return timed(searched)


def _reach(work: Mapping[str, Any]) -> dict[str, Any]:
    import nevergrad

    def searched(level: Level, start: Any, seed: int) -> None:
        space = nevergrad.p.Array(init=start).set_bounds(level.lower, level.upper)
        space.random_state.seed(seed)
        search = nevergrad.families.ParametrizedCMA(popsize=100)(parametrization=space, budget=level.most)
        while True:
            asked = search.ask()
            search.tell(asked, level(asked.value))

    return reaching(searched, most=20_000)


def _runs(runs: int, budget: int) -> list[list[float]]:
    """Return the best values so far of runs of its DE; its package of experiments wants a dozen packages more."""
    import nevergrad

    sphere, told = Sphere(), []
    for seed in range(runs):
        space = nevergrad.p.Array(shape=(5,)).set_bounds(-5, 5)
        space.random_state.seed(seed)
        search = nevergrad.optimizers.registry["DE"](parametrization=space, budget=budget)
        best: list[float] = []
        search.register_callback("tell", lambda _, __, value, best=best: best.append(min([value, *best[-1:]])))
        search.minimize(sphere)
        told.append(best)
    return told


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    import pandas as pd

    table = pd.DataFrame(
        [{"best_value": best[-1], "evaluations": len(best)} for best in _runs(work["runs"], work["budget"])]
    )
    print(table.describe())
    return {"count": len(table), "note": "its DE in a loop of a user's own; nothing kept on disk"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import matplotlib.pyplot as plt

    for best in _runs(1, work["budget"]):
        plt.semilogy(best)
    plt.savefig(f"{work['folder']}/first.png")
    return {"note": "1 run, one figure by Matplotlib"}


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {"nevergrad, ask and tell": _count},
    "de": {"nevergrad DE": partial(_search, lambda ng: ng.families.DifferentialEvolution(popsize=150))},
    "pso": {"nevergrad PSO": partial(_search, lambda ng: ng.families.ConfPSO(popsize=100))},
    "ga": {"nevergrad ES, the nearest it has": partial(_search, lambda ng: ng.families.EvolutionStrategy(popsize=100))},
    "cmaes": {"nevergrad CMA": partial(_search, lambda ng: ng.families.ParametrizedCMA(popsize=100))},
    "noise_level": {"nevergrad CMA, at most 20 000 evaluations": _reach},
    "sweep": {"nevergrad": _sweep},
    "plot": {"nevergrad": _plot},
}

if __name__ == "__main__":
    answer(LINES)
