"""Your own optimiser: a random walk that takes what is better, beside differential evolution on the same problem.

    python examples/own_optimizer.py

From the command line: bench run problem=full11 optimizer=examples/own_optimizer.py:Walk budget=5000 seeds=5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import calibench
from calibench.optimizers import Traits


@dataclass(frozen=True)
class Walk:
    """Step to a normal neighbour and stay where it is better; `width` is the first step, in parts of the box."""

    width: float = 0.1
    name = "walk"
    traits = Traits(stochastic=True, needs_finite_bounds=True)

    def minimize(self, objective, rng):
        """Walk until the objective stops it: there is no budget to count, and no best to keep."""
        sides = objective.upper - objective.lower
        x, step = objective.start, self.width
        value = objective(x)
        while True:
            trial = np.clip(
                x + step * sides * rng.standard_normal(objective.dimension), objective.lower, objective.upper
            )
            found = objective(trial)
            if found < value:
                x, value, step = trial, found, min(2 * step, self.width)
            else:
                step = max(0.95 * step, 1e-9)


if __name__ == "__main__":
    calibench.testing.check_optimizer(Walk)
    print("all laws are kept")
    problem = calibench.problems.make("link_length")
    for optimizer in (Walk(), Walk(width=0.01), calibench.optimizers.make("de")):
        values = [calibench.execute(problem, optimizer, budget=3000, seed=seed).best_value for seed in range(5)]
        print(f"{optimizer!r:45.45s} median of 5 runs {np.median(values):9.2e} mm^4")
