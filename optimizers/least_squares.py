"""`lm`, `trf`, `dogbox`: SciPy's nonlinear least squares, on the residuals and, where there is one, the Jacobian.

Tolerances stand at rounding and are relative, so that a run ends where double precision does, whatever the unit of the
residuals. `lm` (MINPACK) knows no bounds: its answer
may lie outside the box, and the row says so. A coordinate whose bounds are equal is held by `trf` and `dogbox`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts

Scale = Literal["box", "jac", "unit"]
Loss = Literal["linear", "soft_l1", "huber", "cauchy", "arctan"]


@registry.register("lm")
@final
@dataclass(frozen=True)
class LevenbergMarquardt:
    """Levenberg-Marquardt without bounds (MINPACK).

    `first_step` is the radius of the first trust region in widths of the box. MINPACK's own choice, a hundred times the
    norm of x, lets a first step leave for another valley in one start of fifty; half a box never did in 800 starts.
    """

    first_step: float = 0.5
    tolerance: float = 1e-15
    restarts: bool = False

    name: ClassVar[str] = "lm"
    library: ClassVar[str] = "scipy"

    def __post_init__(self) -> None:
        if not 0 < self.first_step < np.inf:
            raise ValueError(f"lm.first_step={self.first_step:g}: must be above 0 (widths of the box)")
        _check_tolerance(self.name, self.tolerance)

    @property
    def traits(self) -> Traits:
        """Return the traits; with `restarts` it goes on, at random, until it is stopped."""
        return _traits(self.restarts, bounded=False)

    def compile(self) -> None:
        """Import SciPy's part, so that no clock sees it."""
        import scipy.optimize  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        return with_restarts(lambda start: self._descend(objective, start), objective, self.restarts)

    def _descend(self, objective: Objective, start: Array) -> None:
        from scipy.optimize import least_squares

        # MINPACK's first radius is its factor where the point is zero: so zero is the start, and a unit first_step/100
        unit = _box_width(objective, start) * self.first_step / _MINPACK_FACTOR
        slope = _remembering(lambda y: objective.jacobian(start + y * unit) * unit)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # overflow far outside the box is a refused step
            least_squares(
                _remembering(lambda y: objective.residuals(start + y * unit)),
                np.zeros(objective.dimension),
                jac=slope if objective.has_jacobian else "2-point",
                method="lm",
                x_scale=1.0,
                ftol=self.tolerance,
                xtol=self.tolerance,
                gtol=self.tolerance,
                max_nfev=objective.remaining + 1,
            )


@registry.register("trf")
@final
@dataclass(frozen=True)
class TrustRegionReflective:
    """Trust region reflective: bounded (Branch, Coleman, Li 1999).

    With a `loss` it searches the least sum of f_scale^2 rho((r / f_scale)^2), in which residuals above `f_scale`, in
    their own unit, count less. The run's value stays r @ r, of which that answer is not the minimum.
    """

    x_scale: Scale = "box"
    tolerance: float = 1e-15
    restarts: bool = False
    loss: Loss = "linear"
    f_scale: float = 1.0

    name: ClassVar[str] = "trf"
    library: ClassVar[str] = "scipy"

    def __post_init__(self) -> None:
        _check_tolerance(self.name, self.tolerance)
        if not 0 < self.f_scale < np.inf:
            raise ValueError(f"{self.name}.f_scale={self.f_scale:g}: must be above 0 (in the unit of the residuals)")

    @property
    def traits(self) -> Traits:
        """Return the traits; with `restarts` it goes on, at random, until it is stopped."""
        return _traits(self.restarts)

    def compile(self) -> None:
        """Import SciPy's part, so that no clock sees it."""
        import scipy.optimize  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        return _minimize("trf", self, objective)


@registry.register("dogbox")
@final
@dataclass(frozen=True)
class Dogbox:
    """Dogleg in a rectangular trust region: bounded (Voglis, Lagaris 2004).

    With a `loss` it searches the least sum of f_scale^2 rho((r / f_scale)^2), in which residuals above `f_scale`, in
    their own unit, count less. The run's value stays r @ r, of which that answer is not the minimum.
    """

    x_scale: Scale = "box"
    tolerance: float = 1e-15
    restarts: bool = False
    loss: Loss = "linear"
    f_scale: float = 1.0

    name: ClassVar[str] = "dogbox"
    library: ClassVar[str] = "scipy"

    def __post_init__(self) -> None:
        _check_tolerance(self.name, self.tolerance)
        if not 0 < self.f_scale < np.inf:
            raise ValueError(f"{self.name}.f_scale={self.f_scale:g}: must be above 0 (in the unit of the residuals)")

    @property
    def traits(self) -> Traits:
        """Return the traits; with `restarts` it goes on, at random, until it is stopped."""
        return _traits(self.restarts)

    def compile(self) -> None:
        """Import SciPy's part, so that no clock sees it."""
        import scipy.optimize  # noqa: F401

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        return _minimize("dogbox", self, objective)


def _check_tolerance(name: str, tolerance: float) -> None:
    if not _EPS <= tolerance < 1:
        raise ValueError(f"{name}.tolerance={tolerance:g}: must lie between rounding, {_EPS:.3g}, and 1")


def _traits(restarts: bool, bounded: bool = True) -> Traits:
    return Traits(
        stochastic=restarts,
        uses_residuals=True,
        uses_gradient=True,
        bounded=bounded,
        self_terminating=not restarts,
        needs_finite_bounds=restarts,
    )


_EPS = float(np.finfo(float).eps)
_MINPACK_FACTOR = 100.0


def _minimize(
    method: Literal["trf", "dogbox"], options: TrustRegionReflective | Dogbox, objective: Objective
) -> Reason:
    from scipy.optimize import least_squares

    free = objective.lower < objective.upper  # SciPy refuses a bound that holds its variable: it is no variable here

    def descend(start: Array) -> None:
        if not free.any():
            objective.residuals(start)
            return

        def whole(y: Array) -> Array:
            if free.all():
                return y
            x = np.array(start)
            x[free] = y
            return x

        def slope(y: Array) -> Array:
            every = objective.jacobian(whole(y))
            return every if free.all() else every[:, free]

        scale: Any = {"box": _box_width(objective, start)[free], "jac": "jac", "unit": 1.0}[options.x_scale]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # overflow far outside the box is a refused step
            least_squares(
                _remembering(lambda y: objective.residuals(whole(y))),
                start[free],
                jac=_remembering(slope) if objective.has_jacobian else "2-point",
                bounds=(objective.lower[free], objective.upper[free]),
                method=method,
                x_scale=scale,
                ftol=options.tolerance,
                xtol=options.tolerance,
                gtol=None,  # absolute: it would end a search of small residuals early
                loss=options.loss,
                f_scale=options.f_scale,
                max_nfev=objective.remaining + 1,  # the wall is the objective's, not SciPy's default
            )

    return with_restarts(descend, objective, options.restarts)


def _box_width(objective: Objective, start: Array) -> Array:
    """Return the width of the box, shape (dim,); the size of the start where the box is open."""
    width = objective.upper - objective.lower
    return np.where(np.isfinite(width) & (width > 0), width, np.maximum(np.abs(start), 1.0))


def _remembering(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Cache the last answer: SciPy gives MINPACK the start that it has just evaluated."""
    last: list[Array] = []

    def ask(x: Array) -> Array:
        if not (last and np.array_equal(last[0], x)):
            last[:] = [x.copy(), function(x)]
        return last[1]

    return ask
