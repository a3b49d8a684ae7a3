"""pymoo: its evaluator counts; differential evolution, particle swarm, genetic algorithm, CMA-ES."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

from answering import Level, answer, cost, full12, points_in, reaching, timed
from small_runs import Sphere

_SEEDS = iter(range(10**9))


def _problem(function: Any, batches: bool) -> Any:
    import numpy as np
    from pymoo.core.problem import ElementwiseProblem, Problem

    class Single(ElementwiseProblem):  # type: ignore[misc]
        def _evaluate(self, x: Any, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = function(x)

    class Batch(Problem):  # type: ignore[misc]
        def _evaluate(self, x: Any, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = np.asarray(function.batch(x))

    kind = Batch if batches else Single
    return kind(n_var=len(function.lower), n_obj=1, xl=function.lower, xu=function.upper)


def _count(size: int, work: Mapping[str, Any]) -> dict[str, Any]:
    import numpy as np
    from pymoo.core.evaluator import Evaluator
    from pymoo.core.individual import Individual
    from pymoo.core.population import Population

    function = full12()
    evaluator = Evaluator()
    if size == 1:
        own = _problem(function, batches=False)
        return cost(function, lambda x: evaluator.eval(own, Individual(X=x)), points_in(function))
    own = _problem(function, batches=True)
    hundreds = list(np.array(points_in(function, 20 * size)).reshape(20, size, -1))
    return cost(function.batch, lambda x: evaluator.eval(own, Population.new(X=x)), hundreds, each=size)


def _search(algorithm: str, size: int, work: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    from pymoo.optimize import minimize

    own = _problem(full12(), batches=True)
    room = import_module(f"pymoo.algorithms.soo.nonconvex.{algorithm.lower()}")
    settings = options or {"pop_size": size}
    method = getattr(room, algorithm)(**settings)

    def searched() -> int:
        ended = minimize(own, method, ("n_eval", 15_000), seed=next(_SEEDS), verbose=False)
        return int(ended.algorithm.evaluator.n_eval)

    return timed(searched)


def _cmaes(work: Mapping[str, Any]) -> dict[str, Any]:
    return _search("CMAES", 100, work, popsize=100, restarts=10, bipop=False, tolfun=0, tolx=0)


def _reach(algorithm: str, settings: Mapping[str, Any], work: Mapping[str, Any]) -> dict[str, Any]:
    from pymoo.optimize import minimize

    room = import_module(f"pymoo.algorithms.soo.nonconvex.{algorithm.lower()}")

    def searched(level: Level, start: Any, seed: int) -> None:
        method = getattr(room, algorithm)(**settings)
        minimize(_problem(level, batches=True), method, ("n_eval", level.most), seed=seed, verbose=False)

    return reaching(searched)


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    import pandas as pd
    from pymoo.algorithms.soo.nonconvex.de import DE
    from pymoo.optimize import minimize

    own = _problem(Sphere(), batches=False)
    rows = []
    for seed in range(work["runs"]):
        ended = minimize(own, DE(pop_size=20), ("n_eval", work["budget"]), seed=seed, verbose=False)
        rows.append({"seed": seed, "best_value": float(ended.F[0]), "evaluations": ended.algorithm.evaluator.n_eval})
    table = pd.DataFrame(rows)
    print(table.describe())
    return {"count": len(table), "note": "its DE, population 20, in a loop of a user's own; nothing kept on disk"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import matplotlib.pyplot as plt
    import numpy as np
    from pymoo.algorithms.soo.nonconvex.de import DE
    from pymoo.optimize import minimize

    own = _problem(Sphere(), batches=False)
    ended = minimize(own, DE(pop_size=20), ("n_eval", work["budget"]), seed=1, save_history=True, verbose=False)
    plt.semilogy([e.evaluator.n_eval for e in ended.history], [np.min(e.opt.get("F")) for e in ended.history])
    plt.savefig(f"{work['folder']}/first.png")
    return {"note": "1 run, one figure by Matplotlib from its history"}


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {"pymoo, Evaluator": partial(_count, 1), "pymoo, Evaluator, batches of 100": partial(_count, 100)},
    "de": {"pymoo DE": partial(_search, "DE", 150)},
    "pso": {"pymoo PSO": partial(_search, "PSO", 100)},
    "ga": {"pymoo GA": partial(_search, "GA", 100)},
    "cmaes": {"pymoo CMAES": _cmaes},
    "noise_level": {
        "pymoo CMAES": partial(_reach, "CMAES", {"popsize": 100, "tolfun": 0, "tolx": 0}),
        "pymoo DE": partial(_reach, "DE", {"pop_size": 100}),
    },
    "sweep": {"pymoo": _sweep},
    "plot": {"pymoo": _plot},
}

if __name__ == "__main__":
    answer(LINES)
