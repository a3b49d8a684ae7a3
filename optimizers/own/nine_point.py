"""`nine_point`: the search of Cong et al. 2008, section 2.4: look around, go to the best, look closer where none is.

The paper moves an end-effector over a plane: a point and its eight neighbours at distance d are a 3 x 3 grid (step 5
prints one corner twice and leaves two sides out). Nothing in it is tied to two unknowns, so here it is for any number.
"""

from dataclasses import dataclass
from itertools import product
from typing import ClassVar, Literal, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Positive, Reason, Traits, registry, with_restarts

_GRID_UP_TO = 3  # unknowns: 26 neighbours; 4 would be 80, and 12 half a million


@registry.register("nine_point")
@final
@dataclass(frozen=True)
class NinePoint:
    """Pattern search on a grid that is halved where its centre is best; ends below `lower_limit` (steps 5 to 7).

    `step` is d, `lower_limit` where it ends; both in units of each coordinate, or with ``x_scale="box"`` in widths of
    the box, which suits unknowns of several units. The limit is the paper's, in mm; its d is lost in print, so 8 (mm,
    as for "several millimeter error") is ours. One round below the limit is still made, so that the last d is between
    half the limit and the limit. `pattern`: "grid" of 3^dim points (up to three unknowns) or "star" of 2 dim + 1 on the
    axes; by default the grid where it may be. Neighbours outside the box are not visited.
    """

    step: Positive = 8.0
    lower_limit: Positive = 0.125
    x_scale: Literal["unit", "box"] = "unit"
    pattern: Literal["grid", "star"] | None = None
    restarts: bool = False

    name: ClassVar[str] = "nine_point"

    def __post_init__(self) -> None:
        registry.check("nine_point", vars(self))

    @property
    def traits(self) -> Traits:
        return Traits(
            stochastic=self.restarts, self_terminating=not self.restarts,
            needs_finite_bounds=self.restarts or self.x_scale == "box", batches=True,
        )  # fmt: skip

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Search from the start; with `restarts`, again from random points of the box."""
        lower, upper, dimension = objective.lower, objective.upper, objective.dimension
        pattern = self.pattern or ("grid" if dimension <= _GRID_UP_TO else "star")
        if pattern == "grid" and dimension > _GRID_UP_TO:
            raise ValueError(
                f"nine_point.pattern=grid: {dimension} unknowns would make {3**dimension - 1} neighbours a round; "
                f"it is for {_GRID_UP_TO} at most, take pattern=star"
            )
        # directions of the neighbours, shape (k, dim), without the centre, which is known
        neighbours = np.vstack([np.eye(dimension), -np.eye(dimension)])
        if pattern == "grid":
            neighbours = np.array([point for point in product((1.0, 0.0, -1.0), repeat=dimension) if any(point)])
        neighbours = neighbours * (np.ones(dimension) if self.x_scale == "unit" else upper - lower)

        def descend(start: Array) -> None:
            centre, value, d = start, objective(start), self.step
            while True:
                around = centre + d * neighbours  # step 5
                around = around[((lower <= around) & (around <= upper)).all(axis=1)]
                values = objective.batch(around) if len(around) else np.array([np.inf])
                best = int(np.argmin(values))
                if values[best] < value:  # step 6
                    centre, value = around[best], float(values[best])
                elif d < self.lower_limit:  # step 7
                    return
                else:
                    d /= 2

        return with_restarts(descend, objective, self.restarts)
