"""`lm`, `trf`, `dogbox`: SciPy's nonlinear least squares, on the residuals and, where there is one, the Jacobian.

Tolerances stand at rounding and are relative, so that double precision ends a run. `lm` (MINPACK) knows no bounds: its
answer may lie outside the box, and the row says so. `trf` and `dogbox` hold a coordinate whose bounds are equal.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts

_EPS = float(np.finfo(float).eps)
_MINPACK_FACTOR = 100.0
Tolerance = Annotated[float, Range(_EPS, 1)]  # from rounding on


@final
@dataclass(frozen=True)
class LeastSquares:
    """One method of SciPy's `least_squares` with its options."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    name: Literal["lm", "trf", "dogbox"]
    options: Mapping[str, Any]
    library: ClassVar[str] = "scipy"

    @property
    def traits(self) -> Traits:
        restarts = self.options["restarts"]
        return Traits(
            stochastic=restarts, uses_residuals=True, uses_gradient=True, bounded=self.name != "lm",
            self_terminating=not restarts, needs_finite_bounds=restarts,
        )  # fmt: skip

    compile = staticmethod(partial(import_module, "scipy.optimize"))

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Descend from the start; with `restarts`, again from random points of the box."""
        return with_restarts(partial(self._descend, objective), objective, self.options["restarts"])

    def _descend(self, objective: Objective, start: Array) -> None:
        from scipy.optimize import least_squares

        options, tolerance, method = self.options, self.options["tolerance"], self.name
        width = objective.upper - objective.lower  # the size of the start where the box is open
        width = np.where(np.isfinite(width) & (width > 0), width, np.maximum(np.abs(start), 1.0))
        if method == "lm":
            # MINPACK's first radius is its factor where the point is zero: so zero is the start, a unit first_step/100
            unit = width * options["first_step"] / _MINPACK_FACTOR
            jac = _remembering(lambda y: objective.jacobian(start + y * unit) * unit)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # overflow far outside the box is a refused step
                least_squares(
                    _remembering(lambda y: objective.residuals(start + y * unit)), np.zeros(objective.dimension),
                    jac=jac if objective.has_jacobian else "2-point", method="lm", x_scale=1.0,
                    ftol=tolerance, xtol=tolerance, gtol=tolerance, max_nfev=objective.remaining + 1,
                )  # fmt: skip
            return
        free = objective.lower < objective.upper  # SciPy refuses a bound that holds its variable: it is no variable
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

        scale: Any = {"box": width[free], "jac": "jac", "unit": 1.0}[options["x_scale"]]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # overflow far outside the box is a refused step
            least_squares(
                _remembering(lambda y: objective.residuals(whole(y))), start[free],
                jac=_remembering(slope) if objective.has_jacobian else "2-point",
                bounds=(objective.lower[free], objective.upper[free]), method=method,
                x_scale=scale, ftol=tolerance, xtol=tolerance,
                gtol=None,  # absolute: it would end a search of small residuals early
                loss=options["loss"], f_scale=options["f_scale"],
                max_nfev=objective.remaining + 1,  # the wall is the objective's, not SciPy's default
            )  # fmt: skip


@registry.register("lm")
def lm(
    first_step: Annotated[float, Range(0, above=True, unit="widths of the box")] = 0.5, tolerance: Tolerance = 1e-15,
    restarts: bool = False,
) -> LeastSquares:  # fmt: skip
    """Levenberg-Marquardt without bounds (MINPACK).

    `first_step` is the radius of the first trust region in widths of the box. MINPACK's own choice, a hundred times the
    norm of x, lets a first step leave for another valley in one start of fifty; half a box never did in 800 starts.
    """
    return LeastSquares("lm", {"first_step": first_step, "tolerance": tolerance, "restarts": restarts})


def _in_the_box(
    name: Literal["trf", "dogbox"], x_scale: Literal["box", "jac", "unit"] = "box", tolerance: Tolerance = 1e-15,
    restarts: bool = False, loss: Literal["linear", "soft_l1", "huber", "cauchy", "arctan"] = "linear",
    f_scale: Annotated[float, Range(0, above=True, unit="in the unit of the residuals")] = 1.0,
) -> LeastSquares:  # fmt: skip
    chosen = {"x_scale": x_scale, "tolerance": tolerance, "restarts": restarts, "loss": loss, "f_scale": f_scale}
    return LeastSquares(name, chosen)


_LOSS = """

With a `loss` it searches the least sum of f_scale^2 rho((r / f_scale)^2), in which residuals above `f_scale`, in their
own unit, count less. The run's value stays r @ r, of which that answer is not the minimum.
"""
_trf, _dogbox = partial(_in_the_box, "trf"), partial(_in_the_box, "dogbox")
_trf.__doc__ = f"Trust region reflective: bounded (Branch, Coleman, Li 1999).{_LOSS}"
_dogbox.__doc__ = f"Dogleg in a rectangular trust region: bounded (Voglis, Lagaris 2004).{_LOSS}"
registry.register("trf")(_trf)
registry.register("dogbox")(_dogbox)


def _remembering(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Cache the last answer: SciPy gives MINPACK the start that it has just evaluated."""
    last: list[Array] = []

    def ask(x: Array) -> Array:
        if not (last and np.array_equal(last[0], x)):
            last[:] = [x.copy(), function(x)]
        return last[1]

    return ask
