"""Whole optimisers on one compiled objective (full12, J3, 50 readings): ours, and those of the libraries.

An evaluation is a candidate, not a call. Ours pass the gate, budget, best and trace included; the libraries call the
bare problem.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, final

import numpy as np
import pandas as pd

from benchmarks.rounds import Contestant, interleave
from calibench import optimizers, problems
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Array, Stop

_OWN_BUDGET = 500_000  # the first thousand generations, which redraw more, are a small part of a run
_PEER_BUDGET = 15_000  # the slow ones would make a round too long for its neighbours
_N = {"de": 150, "pso": 100, "ga": 100}
_EARLY = {"de": "de early_abandon", "pso": "pso early_abandon"}
_SEEDS = iter(range(10**9))  # a new search each time: a start that is easy for one shows in no median


def rows() -> pd.DataFrame:
    """Return a row for each method: against the bare kernel, and against each of our own."""
    problem = problems.make("full12", error="J3")
    problem.compile()
    tables = []
    for name, size in _N.items():
        optimizers.make(name).compile()
        own: dict[str, Contestant] = {name: partial(_own, problem, name, {})}
        if name in _EARLY:
            own[_EARLY[name]] = partial(_own, problem, name, {"early_abandon": True})
        tables.append(interleave(f"{name}, N={size}, against its kernel", {"kernel": _kernel(problem, size)} | own))
        tables.append(interleave(f"{name} against libraries", own | _peers(problem)[name], rounds=9))
    return pd.concat(tables, ignore_index=True)


def _kernel(problem: Any, size: int) -> Contestant:
    """Return the bare compiled kernel on a population like those it meets half way in a search."""
    kernel, arguments = problem._compiled.kernels.batch, problem._compiled.constants
    points = _half_way(problem, size)

    def work() -> int:
        kernel(points, *arguments)
        return size

    return work


def _half_way(problem: Any, size: int) -> Array:
    seen: list[Array] = []
    watched = _Counted(problem, seen.append)
    with suppress(Stop):
        optimizers.make("de", population=max(size, 4)).minimize(Evaluator(watched, 50_000), np.random.default_rng(0))
    return np.array(seen[-2])


def _own(problem: Any, name: str, options: Mapping[str, Any]) -> int:
    gate = Evaluator(problem, _OWN_BUDGET)
    with suppress(Stop):
        optimizers.make(name, **options).minimize(gate, np.random.default_rng(next(_SEEDS)))
    return gate.evaluations


@final
class _Counted:
    """A problem that tells of each batch."""

    side_effect_free = True

    def __init__(self, problem: Any, tell: Callable[[Array], object]) -> None:
        self.lower, self.upper, self.start = problem.lower, problem.upper, problem.start
        self._problem, self._tell = problem, tell

    def __call__(self, x: Array) -> float:
        return float(self._problem(x))

    def batch(self, points: Array) -> Array:
        self._tell(points)
        return np.asarray(self._problem.batch(points))


def _peers(problem: Any) -> dict[str, dict[str, Contestant]]:
    """Return for each of our methods the libraries', as contestants."""
    return {method: {label: partial(run, problem) for label, run in mine.items()} for method, mine in _PEERS.items()}


def _pygmo(algorithm: str, size: int, settings: Mapping[str, Any], problem: Any, batches: bool = False) -> int:
    import pygmo

    @final
    class Udp:
        def fitness(self, x: Array) -> list[float]:
            return [problem(x)]

        def batch_fitness(self, flat: Array) -> Array:
            return np.asarray(problem.batch(flat.reshape(-1, len(problem.lower))))

        def get_bounds(self) -> tuple[Array, Array]:
            return problem.lower, problem.upper

    generations = _PEER_BUDGET // size
    named = getattr(pygmo, algorithm)(gen=generations, seed=next(_SEEDS), **settings)
    if batches:
        named.set_bfe(pygmo.bfe(pygmo.member_bfe()))
    method = pygmo.algorithm(named)
    population = pygmo.population(pygmo.problem(Udp()), size=size, seed=next(_SEEDS))
    return int(method.evolve(population).problem.get_fevals())


def _scipy_de(problem: Any) -> int:
    from scipy.optimize import differential_evolution

    candidates = 0
    rng = np.random.default_rng(next(_SEEDS))

    def values(columns: Array) -> Array:
        nonlocal candidates
        candidates += columns.shape[1]
        return np.asarray(problem.batch(columns.T))

    differential_evolution(
        values, list(zip(problem.lower, problem.upper, strict=True)), strategy="rand1bin", mutation=0.5,
        recombination=0.8, init=problem.lower + rng.random((150, 12)) * (problem.upper - problem.lower),
        maxiter=_PEER_BUDGET // 150, tol=0, atol=0, polish=False, rng=rng, vectorized=True, updating="deferred",
    )  # fmt: skip
    return candidates


def _nlopt(algorithm: str, problem: Any) -> int:
    import nlopt

    nlopt.srand(next(_SEEDS))
    search = nlopt.opt(getattr(nlopt, algorithm), len(problem.lower))
    search.set_lower_bounds(problem.lower)
    search.set_upper_bounds(problem.upper)
    search.set_min_objective(lambda x, gradient: problem(x))
    search.set_maxeval(_PEER_BUDGET)
    search.optimize(np.array(problem.start))
    return int(search.get_numevals())


_SWARM = {"variant": 1, "omega": 0.7298, "eta1": 2.0, "eta2": 2.0}
_PEERS: dict[str, dict[str, Callable[[Any], int]]] = {
    "de": {
        "pygmo de": partial(_pygmo, "de", 150, {"F": 0.5, "CR": 0.8, "variant": 7, "ftol": 0, "xtol": 0}),
        "scipy de, vectorised": _scipy_de,
        "nlopt GN_CRS2_LM": partial(_nlopt, "GN_CRS2_LM"),
        "nlopt GN_ESCH": partial(_nlopt, "GN_ESCH"),
    },
    "pso": {
        "pygmo pso": partial(_pygmo, "pso", 100, _SWARM),
        "pygmo pso_gen, batches (bfe)": partial(_pygmo, "pso_gen", 100, _SWARM, batches=True),
    },
    "ga": {
        "pygmo sga": partial(_pygmo, "sga", 100, {}),
    },
}


if __name__ == "__main__":
    print(rows().to_string(index=False, float_format="{:.3g}".format))
