"""optimagic: one face for many optimisers, with a history of each evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from answering import answer, full12, timed
from small_runs import Sphere

_SEEDS = iter(range(10**9))


def _count(work: Mapping[str, Any]) -> dict[str, Any]:
    """Take SciPy's Nelder-Mead alone from the same through optimagic, an evaluation: history and conversions."""
    import optimagic as om
    from scipy.optimize import minimize

    problem, budget = full12(), 500

    def alone() -> int:
        return int(minimize(problem, problem.start, method="Nelder-Mead", options={"maxfev": budget}).nfev)

    def through() -> int:
        options = {"stopping_maxfun": budget, "stopping_maxiter": 10**6}
        found = om.minimize(problem, problem.start, algorithm="scipy_neldermead", algo_options=options)
        return int(found.n_fun_evals)

    bare, whole = timed(alone), timed(through)
    per = {key: whole[key] / whole["count"] - bare[key] / bare["count"] for key in ("cpu_s", "wall_s")}
    return {
        **per,
        "count": 1,
        "note": "SciPy's Nelder-Mead through it, less the same alone, 500 evaluations, per evaluation",
    }


def _search(work: Mapping[str, Any]) -> dict[str, Any]:
    import optimagic as om

    problem = full12()
    bounds = om.Bounds(lower=problem.lower, upper=problem.upper)
    options = {
        "population_size_multiplier": 12, "stopping_maxiter": 30, "convergence_ftol_rel": 0, "convergence_ftol_abs": 0,
        "seed": next(_SEEDS), "strategy": "rand1bin", "mutation_constant": 0.5, "recombination_constant": 0.8,
    }  # fmt: skip

    def searched() -> int:
        found = om.minimize(
            problem, problem.start.copy(), bounds=bounds, algorithm="scipy_differential_evolution", algo_options=options
        )
        return int(found.n_fun_evals)

    return {**timed(searched), "note": "SciPy's through it, population 144, one call a candidate"}


def _run(budget: int, seed: int) -> Any:
    import optimagic as om

    sphere = Sphere()
    start = np.random.default_rng(seed).uniform(-5, 5, 5)
    options = {"stopping_maxfun": budget, "stopping_maxiter": 10**6}
    bounds = om.Bounds(lower=sphere.lower, upper=sphere.upper)
    return om.minimize(sphere, start, bounds=bounds, algorithm="scipy_neldermead", algo_options=options)


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    import pandas as pd

    found = [_run(work["budget"], seed) for seed in range(work["runs"])]
    table = pd.DataFrame([{"best_value": one.fun, "evaluations": one.n_fun_evals} for one in found])
    print(table.describe())
    return {"count": len(table), "note": "Nelder-Mead in a loop of a user's own; nothing kept on disk"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import optimagic as om

    om.criterion_plot(_run(work["budget"], 1)).write_html(f"{work['folder']}/first.html")
    return {"note": "1 run, its criterion_plot as a page"}


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {"optimagic, history": _count},
    "de": {"optimagic, SciPy's DE": _search},
    "sweep": {"optimagic": _sweep},
    "plot": {"optimagic": _plot},
}

if __name__ == "__main__":
    answer(LINES)
