"""NLopt's algorithms, each under its own name: ``nlopt_LN_BOBYQA`` is NLopt's LN_BOBYQA.

The search runs in the unit box and on the value divided by its first size, as J in mm^4 with rad and mm side by side
breaks most of them by scale alone. Nothing may be raised inside NLopt's callback (some algorithms hang, others change
the exception): it is kept, NLopt is asked to stop, and it is raised again outside.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from optimizers.derivatives import value_and_gradient

_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN


@final
@dataclass(frozen=True)
class NLopt:
    """One NLopt algorithm, its tolerances off.

    `scale_value` divides the value by its size at the start. With `restarts` a local method that has converged begins
    again from a random point.
    """

    algorithm: str
    scale_value: bool = True
    restarts: bool = False

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"nlopt_{self.algorithm}"

    @property
    def options(self) -> dict[str, Any]:
        """Return the options as they stand in a row."""
        return {"scale_value": self.scale_value, "restarts": self.restarts}

    @property
    def library(self) -> str:
        """Return the package that does the work."""
        return "nlopt"

    @property
    def traits(self) -> Traits:
        """Return the traits that NLopt's own naming tells: G or L, N or D."""
        local, gradient = self.algorithm[0] == "L", self.algorithm[1] == "D"
        return Traits(stochastic=self.restarts, uses_gradient=gradient, self_terminating=local and not self.restarts)

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, again from random points of the box."""
        import nlopt

        nlopt.srand(int(rng.integers(1, 2**31)))
        return with_restarts(lambda start: self._descend(objective, start), objective, rng, self.restarts)

    def _descend(self, objective: Objective, start: Array) -> None:
        import nlopt

        lower, width = objective.lower, objective.upper - objective.lower
        if not np.isfinite(width).all():
            raise ValueError(f"{self.name} searches a box: all bounds must be finite")
        width = np.where(width > 0, width, 1.0)
        search = nlopt.opt(getattr(nlopt, self.algorithm), objective.dimension)
        caught: list[BaseException] = []
        size: list[float] = []

        def function(u: Array, gradient: Array) -> float:
            x = np.clip(lower + u * width, objective.lower, objective.upper)
            try:
                if gradient.size:
                    value, slope = value_and_gradient(objective, x)
                else:
                    value = objective(x)
            except BaseException as error:  # anything: raised again below, outside NLopt
                caught.append(error)
                search.force_stop()
                return _LARGEST
            if not size:
                size.append(abs(value) if self.scale_value and np.isfinite(value) and value else 1.0)
            if gradient.size:
                gradient[:] = slope * width / size[0]
            return min(value / size[0], _LARGEST)

        search.set_min_objective(function)
        search.set_lower_bounds(np.zeros(objective.dimension))
        search.set_upper_bounds(np.where(objective.upper > objective.lower, 1.0, 0.0))
        search.set_maxeval(objective.remaining + 1)  # the wall is the objective's; this one ends what ignores a stop
        try:
            search.optimize(np.clip((start - lower) / width, 0.0, 1.0))
        except (nlopt.ForcedStop, nlopt.RoundoffLimited, RuntimeError):
            pass  # told apart by what was caught; a bare failure at the rounding floor is the end of a descent
        if caught:
            raise caught[0]


for _algorithm in ("LN_BOBYQA", "LD_SLSQP"):
    registry.register(f"nlopt_{_algorithm}")(functools.partial(NLopt, _algorithm))
