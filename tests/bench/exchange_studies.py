"""Studies for the tests of exports and imports: a stand-in for COCO's suite, and a study of each kind of run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibench import bench, optimizers, problems
from calibench.bench.store.runs import ResultStore
from calibench.problems.suites.black_box import COCO_GAPS


class Raised:
    """A bowl that is called as COCO's problems are: shifted by its instance, its minimum not zero, COCO's targets."""

    name = "bbob"

    def __init__(self, function=1, dimension=2, instance=1):
        self.options = {"function": function, "dimension": dimension, "instance": instance}
        self.data_id = f"bbob_f{function:03d}_i{instance:02d}_d{dimension:02d}"
        self.lower, self.upper, self.start = np.full(dimension, -5.0), np.full(dimension, 5.0), np.zeros(dimension)
        self.minimum = 394.48 - 79.0 * instance
        self.targets = [self.minimum + gap for gap in COCO_GAPS]
        self.seen = []
        self._weights = 10.0 ** (function * np.arange(dimension) / dimension)

    def __call__(self, x):
        value = float(self._weights @ (x - 0.3 * self.options["instance"]) ** 2) + self.minimum
        self.seen.append(value)
        return value


class Falls(Raised):
    """The same, of function 3, that breaks after 30 calls."""

    def __init__(self):
        super().__init__(function=3)

    def __call__(self, x):
        if len(self.seen) >= 30:
            raise RuntimeError("the encoder fell off")
        return super().__call__(x)


class Trembles(Raised):
    """The same with noise: the lowest value seen is a lucky one. Without noise that of instance 2 is not finite."""

    stochastic = True

    def __call__(self, x):
        return super().__call__(x) + 30.0 * self.rng.standard_normal()

    def noise_free(self, x):
        return super().__call__(x) if self.options["instance"] == 1 else np.inf


def suite_study(folder: Path, instances=(1, 2, 3), seeds=range(2), methods=("de", "nlopt_LN_BOBYQA"), budget=300):
    """Fill `folder` with runs on two functions in two dimensions; return its store."""
    store = ResultStore(folder)
    store.open()
    for method in methods:
        for function, dimension in ((1, 2), (1, 3), (2, 2)):
            for instance in instances:
                for seed in seeds:
                    problem = Raised(function, dimension, instance)
                    store.write(
                        bench.execute(problem, optimizers.make(method), budget=budget, seed=seed, start="random")
                    )
    store.collect()
    return store


def mixed_study(folder: Path):
    """Fill `folder` with runs of our own problems: least squares with Jacobians, a search, two budgets."""
    store = ResultStore(folder)
    store.open()
    for name in ("sensor_zero", "full12"):
        for method, budget in (("lm", 90), ("lm", 120), ("de", 400)):
            for seed in range(2):
                problem, optimizer = problems.make(name), optimizers.make(method)
                store.write(bench.execute(problem, optimizer, budget=budget, seed=seed, start="random"))
    store.collect()
    return store
