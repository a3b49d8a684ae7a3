"""Your own problem: its laws are checked, then four optimisers share one budget.

    python examples/own_problem.py

The same class is swept from the command line: bench run -m problem=examples/own_problem.py:Decay optimizer=trf,de
budget=2000 seeds=5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import calibench

HOURS = np.linspace(0.0, 6.0, 25)
READ = 3.0 * np.exp(-0.7 * HOURS) + 0.5  # a sensor that settles


@dataclass(frozen=True)
class Decay:
    """A decay ``a exp(-k t) + c`` fitted to readings of a sensor [V]; `weight` is the weight of a reading [1/V]."""

    weight: float = 10.0

    lower = np.array([0.0, 0.01, -1.0])
    upper = np.array([9.0, 5.0, 1.0])
    start = np.array([1.0, 1.0, 0.0])
    truth = np.array([3.0, 0.7, 0.5])
    parameters = ("a", "k", "c")
    targets = (1e-6,)
    minimum = 0.0

    def residuals(self, x):
        return self.weight * (x[0] * np.exp(-x[1] * HOURS) + x[2] - READ)

    def jacobian(self, x):
        fall = np.exp(-x[1] * HOURS)
        return self.weight * np.stack([fall, -x[0] * HOURS * fall, np.ones_like(fall)], axis=-1)

    def __call__(self, x):
        r = self.residuals(x)
        return float(r @ r)


if __name__ == "__main__":
    calibench.testing.check_problem(Decay())
    print("all laws are kept")
    for name in ("trf", "fmincon", "nlopt_LN_BOBYQA", "de"):
        run = calibench.execute(Decay(), calibench.optimizers.make(name), budget=2000, seed=0)
        found = ", ".join(f"{value:.4f}" for value in run.best_x)
        print(f"{name:16s} {run.evaluations:5d} evaluations, best {run.best_value:9.2e}, at {found}")
