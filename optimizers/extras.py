"""Methods of packages that are an extra: ``pip install 'calibench[methods]'``. Where one is missing, so is its method.

`dfols` fits residuals without their derivatives, which is what the calibration of a simulator has; `pycma_cmaes` is
CMA-ES where pygmo has no wheel. Both search the unit box, and `dfols` residuals divided by their first size.
"""

import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Annotated, Any, ClassVar, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Array, Objective, OfBox, Reason, Traits, registry, with_restarts

_ROUNDING = 1e-15


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

    def compile(self) -> None:
        import dfols  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        import dfols

        most = objective.remaining + 2 * objective.dimension + 10

        def descend(start: Array) -> None:
            u0, outside = _of_the_unit_box(objective, start)
            first: list[float] = []

            def residuals(u: Array) -> Array:
                r = objective.residuals(outside(u))
                first.append(float(np.linalg.norm(r)) or 1.0) if not first else None
                return r / first[0]

            if not u0.size:
                objective.residuals(start)
                return
            zeros = np.zeros(len(u0))
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                dfols.solve(
                    residuals, u0, bounds=(zeros, zeros + 1.0), rhobeg=self.rhobeg, rhoend=_ROUNDING, npt=self.npt,
                    maxfun=most, do_logging=False, user_params={
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

    def compile(self) -> None:
        import cma  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Evolve from the start, and from random points of the box, until the objective stops it."""
        import cma

        logging.getLogger("cma").setLevel(logging.ERROR)

        def evolve(start: Array) -> None:
            u0, outside = _of_the_unit_box(objective, start)
            if not u0.size:
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
                search = cma.CMAEvolutionStrategy(u0, self.sigma0, options)
                while not search.stop():
                    members = search.ask()
                    values = objective.batch(np.array([outside(u) for u in members]))
                    search.tell(members, [min(value, 1e100) for value in values.tolist()])

        return with_restarts(evolve, objective, restarts=True)


def _of_the_unit_box(objective: Objective, start: Array) -> tuple[Array, Callable[[Array], Array]]:
    """Return the start in shares of the widths that are free, and a function of such shares: the point of the box."""
    free = objective.lower < objective.upper
    lower, width = objective.lower[free], (objective.upper - objective.lower)[free]

    def outside(u: Array) -> Array:
        x = np.array(start)
        x[free] = lower + np.asarray(u) * width
        return x.clip(objective.lower, objective.upper)

    return ((start - objective.lower) / (objective.upper - objective.lower + ~free))[free], outside


if find_spec("dfols"):
    registry.register("dfols")(DFOLS)
if find_spec("cma"):
    registry.register("pycma_cmaes")(CMAES)
