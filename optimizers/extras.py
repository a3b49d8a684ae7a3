"""Methods of packages that are an extra: ``pip install 'calibench[methods]'``. Where one is missing, so is its method.

`dfols` fits residuals without their derivatives, which is what the calibration of a simulator has; `pycma_cmaes` is
CMA-ES where pygmo has no wheel. Both search the unit box, and `dfols` residuals divided by their first size.
"""

import logging
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any, ClassVar, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Array, Objective, OfBox, Reason, Traits, registry, with_restarts
from calibench.optimizers.scipy import ROUNDING, Lost, Units


@final
@dataclass(frozen=True)
class DFOLS:
    """DFO-LS: linear models of the residuals in a trust region, without derivatives (Cartis, Roberts et al. 2019).

    `rhobeg` is the first trust region in widths of the box, and `npt` the points of a model; null: dim + 1. Its first
    directions are those of the coordinates. It ends where its trust region is at rounding.
    """

    rhobeg: Annotated[float, Range(0, 0.5, above=True, unit="widths of the box")] = 0.1
    npt: Annotated[int | None, Range(2)] = None
    restarts: bool = False

    name: ClassVar[str] = "dfols"
    library: ClassVar[str] = "DFO-LS"

    def __post_init__(self) -> None:
        registry.check("dfols", vars(self))

    @property
    def traits(self) -> Traits:
        return Traits(
            stochastic=self.restarts, uses_residuals=True, self_terminating=not self.restarts,
            minimum_budget_per_dimension=1, needs_finite_bounds=True, package="dfols",
        )  # fmt: skip

    compile = staticmethod(partial(import_module, "dfols"))

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        import dfols

        most = objective.remaining + 2 * objective.dimension + 10

        def descend(start: Array) -> None:
            units = Units(objective, start, scaled=True, bounded=True)
            first: list[float] = []

            def residuals(u: Array) -> Array:
                r = objective.residuals(units.point(u))
                first.append(float(np.linalg.norm(r)) or 1.0) if not first else None
                return r / first[0]

            if not units.free.any():
                objective.residuals(start)
                return
            with suppress(Lost), warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                dfols.solve(
                    residuals, units.start, bounds=(units.lower, units.upper), rhobeg=self.rhobeg, rhoend=ROUNDING,
                    npt=self.npt, maxfun=most, do_logging=False, user_params={
                        "model.abs_tol": 0.0, "model.rel_tol": 0.0, "init.random_initial_directions": False,
                        "slow.max_slow_iters": most,
                    },
                )  # fmt: skip

        return with_restarts(descend, objective, self.restarts)


@final
@dataclass(frozen=True)
class CMAES:
    """CMA-ES by its author (Hansen 2016), from the start, in a box; `sigma0` in its widths.

    `popsize` null: 4 + 3 ln(dim). Its tolerances are off; where it can go no further it begins again at random.
    """

    sigma0: OfBox = 0.3
    popsize: Annotated[int | None, Range(2)] = None

    name: ClassVar[str] = "pycma_cmaes"
    library: ClassVar[str] = "cma"

    def __post_init__(self) -> None:
        registry.check("pycma_cmaes", vars(self))

    @property
    def traits(self) -> Traits:
        return Traits(
            stochastic=True, minimum_budget=4 if self.popsize is None else self.popsize, needs_finite_bounds=True,
            batches=True, package="cma",
        )  # fmt: skip

    compile = staticmethod(partial(import_module, "cma"))

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Evolve from the start, and from random points of the box, until the objective stops it."""
        import cma

        logging.getLogger("cma").setLevel(logging.ERROR)

        def evolve(start: Array) -> None:
            units = Units(objective, start, scaled=True, bounded=True)
            if not units.free.any():
                objective(start)
                return
            off = dict.fromkeys(("tolfun", "tolfunhist", "tolfunrel", "tolx", "tolxstagnation"), 0)
            options: dict[str, Any] = {
                "bounds": [0.0, 1.0], "randn": lambda *shape: rng.standard_normal(shape), "seed": np.nan,
                "verbose": -9, "popsize": self.popsize, "maxiter": np.inf, "tolstagnation": 0, "tolflatfitness": np.inf,
                **off,
            }  # fmt: skip
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                search = cma.CMAEvolutionStrategy(units.start, self.sigma0, options)
                while not search.stop():
                    members = search.ask()
                    values = units.batch(np.array(members).T)
                    search.tell(members, [min(value, 1e100) for value in values.tolist()])

        return with_restarts(evolve, objective, restarts=True)


if find_spec("dfols"):
    registry.register("dfols")(DFOLS)
if find_spec("cma"):
    registry.register("pycma_cmaes")(CMAES)
