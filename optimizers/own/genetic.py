"""`ga`: the genetic algorithm of Cong et al. 2008 (section 4.1, settings of 4.4); an option for each word left open."""

from dataclasses import dataclass
from math import ceil, inf, log2
from typing import Annotated, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import Range
from calibench.optimizers.base import Array, Count, Objective, Positive, Reason, Share, registry
from calibench.optimizers.own.population import compile_steps, population_traits

_LONGEST = 53  # bits of a parameter that a double holds exactly
_ROWS = 16  # in which the box is written down: a multiple of any vector's width


@registry.register("ga")
@final
@dataclass(frozen=True)
class GeneticAlgorithm:
    """Tournaments, one-point crossover and two-bit mutation of strings. Ignores the start: its first sample is random.

    As stated: `population` is N; a parameter has L = ceil(log2(width / `precision`)) bits, the precision in mm and rad
    alike; `tournament` is the number of individuals in one; `PCrossover` and `PMutation` are probabilities; the best
    individual is maintained, and evaluated once; after `NR` generations without an improvement, half the individuals
    except it begin again. As read, where the paper does not say:

    - `rivals`: those of a tournament are drawn with replacement (any), or are distinct.
    - `mutation_per`: two bits of an individual flip with PMutation, or two of each parameter's, or each bit does.
    - `crossover`: a pair has one crossing point in its whole string, or one in each parameter's.
    - `coding`: the string of a parameter is a binary number, or a Gray code.
    - `improvement`: the population improves where its best does, or where its mean since the last renewal does.
    - `renewal`: the half that begins again is a random one, or the worst.
    """

    population: Annotated[int, Range(2)] = 100  # a pair crosses
    precision: Positive = 1e-4
    tournament: Count = 4
    PCrossover: Share = 0.85
    PMutation: Share = 0.15
    NR: Count = 50
    rivals: Literal["any", "distinct"] = "any"
    mutation_per: Literal["individual", "parameter", "bit"] = "individual"
    crossover: Literal["string", "parameter"] = "string"
    coding: Literal["binary", "gray"] = "binary"
    improvement: Literal["best", "mean"] = "best"
    renewal: Literal["random", "worst"] = "random"

    name: ClassVar[str] = "ga"

    def __post_init__(self) -> None:
        registry.check("ga", vars(self))
        if self.rivals == "distinct" and self.tournament > self.population:
            rule = f"there are {self.population} distinct rivals; or rivals=any"
            raise ValueError(f"ga.tournament={self.tournament}: {rule}")

    traits = property(population_traits)
    compile = compile_steps

    def lengths(self, width: Array) -> NDArray[np.int64]:
        """Return the bits of each parameter, shape (dim,), at least one: L = ceil(log2(width / precision))."""
        if not np.isfinite(width).all():
            raise ValueError("ga searches a box: all bounds must be finite")
        bits = [ceil(log2(w / self.precision)) if w > self.precision else 1 for w in width.tolist()]
        if max(bits) > _LONGEST:
            raise ValueError(
                f"ga.precision={self.precision:g}: a parameter of width {width.max():g} would take {max(bits)} bits, "
                f"{_LONGEST} are the most; take a larger precision"
            )
        return np.array(bits, dtype=np.int64)

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Breed generations until the objective stops it."""
        from calibench.optimizers.own import _genetic_kernels as step
        from calibench.optimizers.own._random_kernels import random_state

        state, lower, upper = random_state(rng), objective.lower, objective.upper
        lengths, gray = self.lengths(upper - lower), self.coding == "gray"
        size, dim = self.population, objective.dimension
        words, values = np.empty((2, size, dim), dtype=np.int64), np.empty(size)
        box = step.scales(lower, upper, lengths, min(size, _ROWS))
        room = np.concatenate([np.empty((size, dim)), box.reshape(-1, dim)])
        asked = room[:size]
        memory = np.concatenate([np.zeros(step.HEAD, dtype=np.int64), lengths, np.zeros(size, dtype=np.int64)])
        mean = self.improvement == "mean"
        rules = np.array([
            inf, self.tournament, self.rivals == "distinct", self.PCrossover, self.crossover == "parameter",
            self.PMutation, ("individual", "parameter", "bit").index(self.mutation_per), gray, self.NR,
            self.renewal == "worst", mean,
        ], dtype=float)  # fmt: skip
        step.randomize(np.arange(size), words[0], lengths, state)
        step.decode(words[0], gray, lengths, box, asked)
        memory[step.STILL] = -1  # whatever the first sample is worth, it is no generation without an improvement
        points = asked
        while True:
            found = objective.batch(points)
            if mean:  # as NumPy adds, in pairs
                step.receive(values, found, memory)
                count = step.proceed(words, room, values, values.mean(), memory, rules, state)
            else:
                count = step.advance(words, room, values, found, memory, rules, state)
            if count != len(points):
                points = asked[:count]
