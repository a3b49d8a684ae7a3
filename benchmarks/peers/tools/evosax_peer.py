"""evosax: its strategies, compiled by JAX, ask and are told in the unit box; the objective is called between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import count
from typing import Any

import numpy as np
from answering import Level, answer, full12, reaching, timed

_SEEDS = count()
_DE = {"crossover_rate": 0.8, "differential_weight": 0.5}
_CMA = {"std_init": 0.3}


class _Strategy:
    """A strategy over the unit box in double precision; what it asks beyond the box is mirrored into it."""

    def __init__(self, name: str, size: int, dimension: int, settings: Mapping[str, Any]) -> None:
        import evosax.algorithms as all_of_them
        import jax

        jax.config.update("jax_enable_x64", True)
        self._jax, self._size, self._with_mean = jax, size, name == "CMA_ES"
        self._one = getattr(all_of_them, name)(population_size=size, solution=jax.numpy.zeros(dimension))
        self._params = self._one.default_params.replace(**settings)

    def search(self, function: Any, start: Any, seed: int, generations: int) -> int:
        """Return how many evaluations of `function` so many generations made."""
        width = function.upper - function.lower
        evaluate = lambda points: function.batch(function.lower + (1 - np.abs(1 - np.asarray(points) % 2)) * width)  # noqa: E731
        key, begin, made = self._jax.random.key(seed), (start - function.lower) / width, 0
        if self._with_mean:
            state = self._one.init(key, self._jax.numpy.asarray(begin), self._params)
        else:
            first = np.random.default_rng(seed).random((self._size, len(width)))
            first[0] = begin
            state = self._one.init(
                key, self._jax.numpy.asarray(first), self._jax.numpy.asarray(evaluate(first)), self._params
            )
            made = self._size
        for _ in range(generations):
            key, asking, telling = self._jax.random.split(key, 3)
            asked, state = self._one.ask(asking, state, self._params)
            state, _ = self._one.tell(telling, asked, self._jax.numpy.asarray(evaluate(asked)), state, self._params)
            made += len(asked)
        return made


def _search(name: str, size: int, settings: Mapping[str, Any], work: Mapping[str, Any]) -> dict[str, Any]:
    problem = full12()
    strategy = _Strategy(name, size, len(problem.lower), settings)
    return timed(lambda: strategy.search(problem, problem.start, next(_SEEDS), 15_000 // size))


def _reach(name: str, settings: Mapping[str, Any], work: Mapping[str, Any]) -> dict[str, Any]:
    strategy = _Strategy(name, 100, 12, settings)

    def searched(level: Level, start: Any, seed: int) -> None:
        strategy.search(level, start, seed, level.most)

    return reaching(searched)


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "de": {"evosax DE": partial(_search, "DifferentialEvolution", 150, _DE)},
    "pso": {"evosax PSO": partial(_search, "PSO", 100, {})},
    "ga": {"evosax GA": partial(_search, "SimpleGA", 100, {})},
    "cmaes": {"evosax CMA_ES": partial(_search, "CMA_ES", 100, _CMA)},
    "noise_level": {
        "evosax CMA_ES": partial(_reach, "CMA_ES", _CMA),
        "evosax DE": partial(_reach, "DifferentialEvolution", _DE),
    },
}

if __name__ == "__main__":
    answer(LINES)
