"""The state of one search of `fmincon`, a value: each thing that happens to a search returns the next state.

What happens: a point is tried (`tried`) and its value found (`looked`); a step is taken (`stepped`, `headed`) and ends
at an iterate (`arrived`), or stops short of its gradient (`stopped_at`); SQP begins afresh (`afresh`, `reframed`); the
interior point takes iterates into its matrix (`bent_by`); an iterate is chosen as the answer (`settled`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.frame import Frame, Iterate, Scales

_PATIENCE = 10  # iterates in a row without progress: SLSQP's line search gives up after ten cuts, and goes on


@final
@dataclass(frozen=True, eq=False)
class Seen:
    """The last point at which the objective was called; `defined`: it and the constraints are finite numbers there."""

    x: Array
    value: float
    defined: bool


@final
@dataclass(frozen=True)
class Least:
    """The least value (of feasible iterates), violation and first-order measure so far."""

    value: float = np.inf
    violation: float = np.inf
    first_order: float = np.inf


@final
@dataclass(frozen=True, eq=False)
class State:
    """Where a search is. `path` are its iterates, from the start; x and steps are in the user's units.

    `trial`, shape (n,), is the first point tried after the last iterate, and `direction`, shape (n,), from the iterate
    before to its `trial`, the whole d of the line search that led to the last one. `step` is the norm of the last step,
    `step_length` its part of d. `idle` counts the iterates in a row that brought no progress. `known` is how many
    iterates the interior point's matrix has seen, `bent` whether any of them showed a curvature.
    """

    frame: Frame
    scales: Scales
    seen: Seen
    path: tuple[Iterate, ...] = ()
    trial: Array | None = None
    direction: Array | None = None
    step: float = 0.0
    step_length: float = 0.0
    least: Least = Least()
    idle: int = 0
    known: int = 0
    bent: bool = False
    chosen: Iterate | None = None

    @property
    def iteration(self) -> int:
        """Return the number of the last iterate; the start is 0."""
        return len(self.path) - 1

    @property
    def last(self) -> Iterate:
        """Return the last iterate."""
        return self.path[-1]

    @property
    def answer(self) -> Iterate:
        """Return the iterate that was chosen as the answer; until then the last."""
        return self.path[-1] if self.chosen is None else self.chosen

    @property
    def is_stuck(self) -> bool:
        """Tell whether the last iterates brought no lower value, violation or first-order measure."""
        return self.idle >= _PATIENCE

    def best(self, tolerance: float) -> Iterate:
        """Return the feasible iterate of least merit f + 2 |lambda|_1 violation; without one, the least infeasible.

        By f alone a point outside by less than the tolerance would beat the optimum.
        """
        inside = [i for i in self.path if i.violation <= tolerance]
        if not inside:
            return min(self.path, key=lambda i: i.violation)
        last = inside[-1]
        penalty = 2.0 * float(np.abs(last.inequalities).sum() + np.abs(last.equalities).sum())
        return min(inside, key=lambda i: i.value + penalty * i.violation)

    # ---- transitions

    def tried(self, x: Array) -> State:
        """Note that x is asked about: the first such point away from the last iterate is the trial."""
        if self.trial is not None or np.array_equal(x, self.last.x):
            return self
        return replace(self, trial=x)

    def looked(self, seen: Seen) -> State:
        """Remember what was found at the last point asked."""
        return replace(self, seen=seen)

    def stepped(self, x: Array) -> State:
        """Take the step from the last iterate to x, which is no iterate yet."""
        if not self.path:
            return self
        step = float(np.linalg.norm(x - self.last.x))
        whole = 0.0 if self.trial is None else float(np.linalg.norm(self.trial - self.last.x))
        return replace(self, step=step, step_length=step / whole if whole else 0.0)

    def headed(self) -> State:
        """Fix the direction of the step that was taken."""
        return replace(self, direction=None if self.trial is None else self.trial - self.last.x)

    def arrived(self, iterate: Iterate, tolerance: float) -> State:
        """Make the iterate the last one; it is feasible where its violation is within `tolerance`."""
        feasible, least = iterate.violation <= tolerance, self.least
        progress = (
            (feasible and iterate.value < least.value)
            or iterate.violation < 0.9 * least.violation
            or iterate.first_order < 0.9 * least.first_order
        )
        return replace(
            self,
            path=(*self.path, iterate),
            trial=None,
            idle=0 if progress else self.idle + 1,
            least=Least(
                min(least.value, iterate.value) if feasible else least.value,
                min(least.violation, iterate.violation),
                min(least.first_order, iterate.first_order),
            ),
        )

    def stopped_at(self, x: Array, value: float, violation: float) -> State:
        """Make x the last iterate though its derivatives stay unknown: those of the one before stand for them."""
        return replace(self, path=(*self.path, replace(self.last, x=x, value=value, violation=violation)))

    def afresh(self) -> State:
        """Count iterates without progress from nought."""
        return replace(self, idle=0)

    def reframed(self, frame: Frame, scales: Scales) -> State:
        """Go on in other coordinates and scales."""
        return replace(self, frame=frame, scales=scales)

    def bent_by(self, bend: bool) -> State:
        """Note that the matrix has seen all iterates, and whether the last of them showed a curvature."""
        return replace(self, known=len(self.path), bent=self.bent or bend)

    def settled(self, answer: Iterate) -> State:
        """Choose the answer."""
        return replace(self, chosen=answer)
