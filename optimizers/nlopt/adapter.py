"""Run one NLopt algorithm through the gate: scaling, tolerances, restarts.

The search runs in the unit box and on the value divided by its first size, as J in mm^4 with rad and mm side by side
breaks most of them by scale alone. Nothing may be raised inside NLopt's callback (some algorithms hang, others change
the exception): it is kept, NLopt is asked to stop, and it is raised again outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, with_restarts
from calibench.optimizers.derivatives import value_and_gradient
from calibench.optimizers.nlopt._table import ALGORITHMS
from calibench.optimizers.nlopt.settings import ROUNDING, SETTING_OF

_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN


def _nothing(_point: Array, _gradient: Array) -> float:
    """Be the objective of a search that is over."""
    return 0.0


@final
@dataclass(frozen=True)
class NLopt:
    """One NLopt algorithm, its tolerances off, with the options of its family."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    algorithm: str
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        for option, least in (("population", 1), ("storage", 1)):
            value = self.options.get(option)
            if value is not None and value < least:
                raise ValueError(f"{self.name}.{option}={value}: must be {least} or more, or null for NLopt's own")
        step = self.options.get("initial_step")
        if step is not None and not 0 < step <= 1:
            raise ValueError(f"{self.name}.initial_step={step:g}: must lie in 0 .. 1 (widths of the box), above 0")
        tolerance = self.options.get("local_tolerance")
        if tolerance is not None and not 0 < tolerance < 1:
            raise ValueError(f"{self.name}.local_tolerance={tolerance:g}: must lie between 0 and 1")

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"nlopt_{self.algorithm}"

    @property
    def library(self) -> str:
        """Return the package that does the work."""
        return "nlopt"

    @property
    def traits(self) -> Traits:
        """Return the traits that the table holds; with `restarts` it goes on, at random, until it is stopped."""
        known, restarts = ALGORITHMS[self.algorithm], self.options.get("restarts", False)
        local = self.options.get("local", self.algorithm)
        population = self.options.get("population")
        return Traits(
            stochastic=known.stochastic or restarts,
            uses_gradient=local[1] == "D",
            bounded=known.bounded,
            self_terminating=known.stops and not restarts,
            uses_start=known.uses_start,
            minimum_budget=known.first if population is None else population,
            minimum_budget_per_dimension=known.first_per_dimension if population is None else 0,
            minimum_dimension=known.minimum_dimension,
            maximum_dimension=known.maximum_dimension,
            needs_finite_bounds=True,
            may_hang=known.may_hang,
        )

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, or where it ends against its habit, again from random points."""
        import nlopt

        nlopt.srand(int(rng.integers(1, 2**31)))
        again = not self.traits.self_terminating
        return with_restarts(lambda start: self._descend(objective, start), objective, again)

    def _descend(self, objective: Objective, start: Array) -> None:
        import nlopt

        lower, width = objective.lower, objective.upper - objective.lower
        width = np.where(width > 0, width, 1.0)
        clipped = ALGORITHMS[self.algorithm].bounded  # what keeps to its box may miss it by rounding
        search = self._search(objective)
        caught: list[BaseException | None] = []  # why it was asked to stop; None: it lost its way
        size: list[float] = []

        def stop(gradient: Array, reason: BaseException | None) -> float:
            caught.append(reason)
            if size:  # GN_ORIG_DIRECT crashes where it is stopped by its first value: the next call stops it
                search.force_stop()
            gradient[:] = 0.0
            return _LARGEST

        def function(u: Array, gradient: Array) -> float:
            try:
                if caught:  # some go on calling after they were asked to stop
                    search.force_stop()
                    gradient[:] = 0.0
                    return _LARGEST
                norm = u.dot(u)
                if norm != norm:  # COBYLA at the rounding floor asks for NaN: there is nothing to evaluate
                    return stop(gradient, None)
                x = lower + u * width
                x = x.clip(objective.lower, objective.upper) if clipped else x  # np.clip takes twice as long
                if gradient.size:
                    value, slope = value_and_gradient(objective, x)
                else:
                    value = objective(x)
                if not size:
                    scaled = self.options["scale_value"] and np.isfinite(value) and value
                    size.append(abs(value) if scaled else 1.0)
                if gradient.size:
                    gradient[:] = np.nan_to_num(slope * width / size[0], posinf=0.0, neginf=0.0)
                return min(value / size[0], _LARGEST)
            except BaseException as error:  # anything, Ctrl-C too: raised again below, outside NLopt
                return stop(gradient, error)

        search.set_min_objective(function)
        try:
            search.optimize(np.clip((start - lower) / width, 0.0, 1.0))
        except (nlopt.ForcedStop, nlopt.RoundoffLimited, RuntimeError, getattr(nlopt, "runtime_error", RuntimeError)):
            pass  # told apart by what was caught; a bare failure at the rounding floor is the end of a descent
        except getattr(nlopt, "invalid_argument", ValueError) as error:
            raise ValueError(
                f"{self.name}: NLopt refuses {self.options} in {objective.dimension} dimensions"
            ) from error
        finally:
            search.set_min_objective(
                _nothing
            )  # each holds the other, which Python cannot see: they would stay for ever
        if caught and caught[0] is not None:
            raise caught[0]

    def _search(self, objective: Objective) -> Any:
        """Return NLopt's own object in the unit box, with the options of this algorithm."""
        import nlopt

        search = nlopt.opt(getattr(nlopt, self.algorithm), objective.dimension)
        search.set_lower_bounds(np.zeros(objective.dimension))
        search.set_upper_bounds(np.where(objective.upper > objective.lower, 1.0, 0.0))
        search.set_maxeval(objective.remaining + 1)  # the wall is the objective's; this one ends what ignores a stop
        setting = SETTING_OF[self.algorithm]
        for name, value in setting.parameters.items():
            search.set_param(name, value)
        if setting.step_ends == "always" or (setting.step_ends == "restarted" and self.options.get("restarts")):
            search.set_xtol_rel(ROUNDING)
        if self.options.get("initial_step") is not None:
            search.set_initial_step(self.options["initial_step"])
        if self.options.get("population") is not None:
            search.set_population(self.options["population"])
        if self.options.get("storage") is not None:
            search.set_vector_storage(self.options["storage"])
        if "local" in self.options:
            local = nlopt.opt(getattr(nlopt, self.options["local"]), objective.dimension)
            local.set_ftol_rel(self.options["local_tolerance"])
            local.set_xtol_rel(self.options["local_tolerance"])
            search.set_local_optimizer(local)
        return search
