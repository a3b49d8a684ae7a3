"""What each method of SciPy is given, with reasons: the tests that may end it, and what it asks for.

The table is static, so that listing needs no SciPy. docs/optimizers.md shows it; the tests hold its claims. A tolerance
of 0 is off. Options of SciPy that are ours to choose for a user are those of `methods`, under SciPy's names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

ROUNDING = 1e-15
EQUAL = 1e-300  # only equal values differ by less; 0 would let SLSQP go on from them for ever
DESCENT = {"ftol": 0.0, "gtol": 0.0}  # of an L-BFGS-B inside another method: on to rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One method: `given` are options of SciPy's that are fixed, and `why`.

    `word` is SciPy's name of a method of `minimize`, "" where the method is a function of its own. `stops`: may end by
    itself. `together`: each value comes with its gradient. `hessian`: as products with a direction, or whole. `counts`:
    SciPy's options that limit iterations or evaluations; the wall is the objective's. `first_per_dimension`:
    evaluations of its first model, a dimension.
    """

    why: str
    word: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)
    counts: tuple[str, ...] = ("maxiter",)
    stops: bool = True
    stochastic: bool = False
    gradient: bool = False
    together: bool = False
    hessian: Literal["products", "whole"] | None = None
    bounded: bool = True
    uses_start: bool = True
    needs_finite_bounds: bool = False
    batches: bool = False
    first_per_dimension: int = 0
    minimum_dimension: int = 1
    maximum_dimension: int | None = None


def _newton(word: str, given: Mapping[str, Any], hessian: Literal["products", "whole"], why: str) -> Setting:
    return Setting(
        word=word, given=given, gradient=True, hessian=hessian, bounded=False, first_per_dimension=1, why=why
    )


_UNBOUNDED = "It takes no bounds."
SETTINGS: dict[str, Setting] = {
    "nelder_mead": Setting(
        word="Nelder-Mead", given={"xatol": ROUNDING, "fatol": float("inf")}, counts=("maxiter", "maxfev"),
        first_per_dimension=1, why="It ends where its simplex is at rounding in every coordinate, whatever the values.",
    ),
    "powell": Setting(
        word="Powell", given={"xtol": 0.0, "ftol": 0.0}, counts=("maxiter", "maxfev"),
        why="It ends where a round of line searches gains nothing, or less than SciPy's fixed 1e-20.",
    ),
    "cg": Setting(
        word="CG", given={"gtol": 0.0}, gradient=True, bounded=False, first_per_dimension=1,
        why=f"{_UNBOUNDED} It ends where a line search finds nothing lower.",
    ),
    "bfgs": Setting(
        word="BFGS", given={"gtol": 0.0, "xrtol": 0.0}, gradient=True, bounded=False, first_per_dimension=1,
        why=f"{_UNBOUNDED} It ends where a line search finds nothing lower.",
    ),
    "l_bfgs_b": Setting(
        word="L-BFGS-B", given=DESCENT, counts=("maxiter", "maxfun"), gradient=True, together=True,
        first_per_dimension=1, why="It ends where a line search finds nothing lower.",
    ),
    "tnc": Setting(
        word="TNC", given={"ftol": 0.0, "xtol": 0.0, "gtol": 0.0}, counts=("maxfun",), gradient=True, together=True,
        first_per_dimension=1, why="It ends where a line search finds nothing lower.",
    ),
    "cobyla": Setting(
        word="COBYLA", given={"tol": ROUNDING}, bounded=False, first_per_dimension=1,
        why="Bounds are constraints to it, which it may break on the way. It ends with its trust region at rounding.",
    ),
    "cobyqa": Setting(
        word="COBYQA", given={"final_tr_radius": ROUNDING}, counts=("maxiter", "maxfev"), first_per_dimension=2,
        why="It ends with its trust region at rounding.",
    ),
    "slsqp": Setting(
        word="SLSQP", given={"ftol": EQUAL}, gradient=True, first_per_dimension=1,
        why="It ends where a line search finds nothing lower, or the same value.",
    ),
    "trust_constr": Setting(
        word="trust-constr", given={"gtol": 0.0, "xtol": ROUNDING, "barrier_tol": ROUNDING}, gradient=True,
        first_per_dimension=1, why="It ends with its trust region and its barrier at rounding.",
    ),
    "newton_cg": _newton(
        "Newton-CG", {"xtol": 0.0}, "products",
        f"{_UNBOUNDED} It ends where the curvature along its step is below SciPy's fixed 7e-16, which comes early.",
    ),
    "trust_ncg": _newton("trust-ncg", {"gtol": 0.0}, "products", f"{_UNBOUNDED} It ends where no step gains."),
    "trust_exact": _newton("trust-exact", {"gtol": 0.0}, "whole", f"{_UNBOUNDED} It ends where no step gains."),
    "dogleg": _newton(
        "dogleg", {"gtol": 0.0}, "whole", f"{_UNBOUNDED} It ends where the Hessian is not positive definite."
    ),
    "differential_evolution": Setting(
        given={"tol": -1.0, "atol": -1.0, "polish": False, "updating": "deferred", "vectorized": True}, stops=False,
        stochastic=True, uses_start=False, needs_finite_bounds=True, batches=True,
        why="Its test of a flat population is off; SciPy's last descent comes after the end, and there is none here. A"
        " generation is one batch, so members change together.",
    ),
    "dual_annealing": Setting(
        counts=("maxiter", "maxfun"), stops=False, stochastic=True, gradient=True, needs_finite_bounds=True,
        why="Its inner descents, L-BFGS-B, go on to rounding.",
    ),
    "basinhopping": Setting(
        given={"niter_success": None}, counts=("niter",), stops=False, stochastic=True, gradient=True,
        needs_finite_bounds=True, first_per_dimension=1, why="Its inner descents, L-BFGS-B, go on to rounding.",
    ),
    "shgo": Setting(
        counts=(), stops=False, gradient=True, uses_start=False, needs_finite_bounds=True, maximum_dimension=8,
        why="Its inner descents, SLSQP, go on to rounding. Its complex has 2^d corners: 1000 evaluations take 2 s in 8"
        " dimensions, 7 s in 10, more than 25 s in 12. It begins again with twice the points.",
    ),
    "direct": Setting(
        given={"vol_tol": 0.0, "len_tol": 0.0}, counts=("maxfun", "maxiter"), stops=False, uses_start=False,
        needs_finite_bounds=True, why="It ends by no test of its own.",
    ),
    "brute": Setting(
        counts=(), stops=False, uses_start=False, needs_finite_bounds=True, maximum_dimension=16,
        why="The grid is held in memory before the first evaluation, 2^d points at least. SciPy's simplex goes on from"
        " its best point. It begins again with one point more a coordinate.",
    ),
}  # fmt: skip
