"""SciPy's minimisers, each by SciPy's own name in lower case: ``scipy_l_bfgs_b`` is L-BFGS-B.

`SETTINGS` has the options of each, under SciPy's names and with its defaults, and what it is given besides;
docs/optimizers.md says why. A search that is `scaled` runs in the unit box and on the value divided by its first size.
Equal bounds hold a coordinate.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, make_dataclass
from functools import partial
from importlib import import_module
from itertools import count
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Array, Count, Objective, Positive, Reason, Share, Traits, registry, with_restarts
from calibench.optimizers.derivatives import Memoized, value_and_gradient

_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN
_EPS = float(np.finfo(float).eps)
_MOST_AT_ONCE = 2_000_000  # evaluations that DIRECT holds memory for, 50 bytes each and more
ROUNDING = 1e-15
EQUAL = 1e-300  # only equal values differ by less; 0 would let SLSQP go on from them for ever
DESCENT = {"ftol": 0.0, "gtol": 0.0}  # of an L-BFGS-B inside another method: on to rounding


@final
@dataclass(frozen=True)
class SciPy:
    """One method of SciPy with its options."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    method: str
    options: Mapping[str, Any]
    library: ClassVar[str] = "scipy"

    def __post_init__(self) -> None:
        chosen: dict[str, Any] = {option: value for option, value in self.options.items() if value is not None}
        if "c1" in chosen and not 0 < chosen["c1"] < chosen["c2"] < 1:
            rule = f"must be above 0 and below c2={chosen['c2']:g}, and that below 1"
            raise ValueError(f"{self.name}.c1={chosen['c1']:g}: {rule}")
        if "max_trust_radius" in chosen:
            first, most = chosen["initial_trust_radius"], chosen["max_trust_radius"]
            if not 0 < first < most:
                rule = f"must be above 0 and below max_trust_radius={most:g}"
                raise ValueError(f"{self.name}.initial_trust_radius={first:g}: {rule}")
        mutation = chosen.get("mutation", (0,))
        if len(mutation) not in (1, 2) or not all(0 <= one < 2 for one in mutation):
            raise ValueError(f"{self.name}.mutation={list(mutation)}: one or two numbers in 0 .. 2")

    @property
    def name(self) -> str:
        return f"scipy_{self.method}"

    @property
    def traits(self) -> Traits:
        known, restarts = SETTINGS[self.method], self.options.get("restarts", False)
        return Traits(
            stochastic=known.stochastic or (restarts and known.uses_start), uses_gradient=known.gradient,
            bounded=known.bounded, self_terminating=known.stops and not restarts, uses_start=known.uses_start,
            minimum_budget=self.options.get("n", 1),
            minimum_budget_per_dimension=self.options.get("popsize", 0) or known.first_per_dimension,
            maximum_dimension=known.maximum_dimension,
            needs_finite_bounds=known.needs_finite_bounds or restarts, batches=known.batches,
        )  # fmt: skip

    compile = staticmethod(partial(import_module, "scipy.optimize"))

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, or where it ends against its habit, again from random points."""
        turns = count()

        def descend(start: Array) -> None:
            units = Units(objective, start, self.options.get("scaled", False), SETTINGS[self.method].bounded)
            if not units.free.any():
                objective(start)
                return
            with suppress(Lost), warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # overflow far outside the box, a line search without an end
                self._search(units, rng, next(turns))

        return with_restarts(descend, objective, restarts=not self.traits.self_terminating)

    def _search(self, units: Units, rng: np.random.Generator, turn: int) -> None:
        from scipy import optimize

        scipy: Any = optimize  # its stubs know no options that are collected in a mapping
        known, box = SETTINGS[self.method], optimize.Bounds(units.lower, units.upper)
        chosen = {key: value for key, value in self.options.items() if key not in ("scaled", "restarts")}
        limits = dict.fromkeys(known.counts, units.beyond)
        descent: dict[str, Any] = {"method": "L-BFGS-B", "jac": True, "bounds": box, "options": {**DESCENT}}
        if self.method == "differential_evolution":
            one, *other = chosen["mutation"]
            chosen["mutation"] = (one, *other) if other else one
            scipy.differential_evolution(units.batch, box, rng=rng, **chosen, **limits, **known.given)
        elif self.method == "dual_annealing":
            descent["jac"] = units.gradient
            chosen |= limits
            scipy.dual_annealing(units.remembered, box, minimizer_kwargs=descent, x0=units.start, rng=rng, **chosen)
        elif self.method == "basinhopping":
            chosen |= {**limits, **known.given}
            scipy.basinhopping(units.both, units.start, minimizer_kwargs=descent, rng=rng, **chosen)
        elif self.method == "shgo":
            descent = {"method": "SLSQP", "options": {"ftol": EQUAL, "maxiter": units.beyond}}
            chosen["n"] *= 2**turn
            handlers = logging.root.handlers[:]
            try:
                scipy.shgo(units.remembered, box, minimizer_kwargs=descent, options={"jac": units.gradient}, **chosen)
            finally:
                logging.root.handlers[:] = handlers  # it logs by functions that give the root one
        elif self.method == "direct":
            limits = {key: min(most, _MOST_AT_ONCE) for key, most in limits.items()}
            scipy.direct(units.value, box, **chosen, **limits, **known.given)
        elif self.method == "brute":
            on_the_grid = int(min((units.beyond - 1) * 2 / 3, _MOST_AT_ONCE) ** (1 / len(units.lower)))
            points = (max(2, on_the_grid) if chosen["Ns"] is None else chosen["Ns"]) + turn
            ranges = tuple(zip(units.lower, units.upper, strict=True))

            def finish(function: Any, x0: Any, args: Any = (), **_quiet: Any) -> Any:
                ends = {"xtol": ROUNDING, "ftol": np.inf, "maxiter": units.beyond, "maxfun": units.beyond}
                return scipy.fmin(function, x0, args=args, full_output=True, disp=False, **ends)

            scipy.brute(units.value, ranges, Ns=points, full_output=True, finish=finish)
        else:
            asked: dict[str, Any] = {"method": known.word, "options": {**chosen, **limits, **known.given}}
            value: Any = units.remembered if known.gradient else units.value
            if known.gradient:
                asked["jac"] = True if known.together else units.gradient
            if known.hessian is not None:
                asked |= {"hessp": units.product} if known.hessian == "products" else {"hess": units.hessian}
            if known.bounded or self.method == "cobyla":
                asked["bounds"] = scipy.Bounds(units.lower, units.upper, keep_feasible=self.method == "trust_constr")
            scipy.minimize(units.both if known.together else value, units.start, **asked)


class Lost(Exception):
    """The method asks for a point that is no number: there is nothing to evaluate, and its descent is over."""


@final
class Units:
    """The objective in SciPy's coordinates u, shape (n,), for the n variables that are free."""

    def __init__(self, objective: Objective, start: Array, scaled: bool, bounded: bool) -> None:
        lower, upper = objective.lower, objective.upper
        self._objective, self._start, self._bounded = objective, start, bounded
        self.free = lower < upper
        width = np.where(np.isfinite(upper - lower), upper - lower, np.maximum(np.abs(start), 1.0))
        origin = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - width, start - 0.5 * width))
        self._width = (width if scaled else np.ones(len(width)))[self.free]
        self._origin = (origin if scaled else np.zeros(len(width)))[self.free]
        self.lower, self.upper, first = ((x[self.free] - self._origin) / self._width for x in (lower, upper, start))
        self.start = np.clip(first, self.lower, self.upper)
        self._size = 0.0 if scaled else 1.0
        self._memo = Memoized(objective, analytic=True, kind="forward", bounded=bounded)
        self._slopes: tuple[Array, Array] | None = None  # where a gradient was asked for last, and what it was
        self.exact = objective.has_gradient or (objective.has_residuals and objective.has_jacobian)

    @property
    def beyond(self) -> int:
        """Return one more than what is left of the budget, in the int of SciPy's compiled parts: never reached."""
        return min(self._objective.remaining, 2**31 - 2) + 1

    def value(self, u: Array) -> float:
        return self._sized(self._objective(self.point(u)))

    def remembered(self, u: Array) -> float:
        """Return the value, and keep what a gradient at the same point will need."""
        return self._sized(self._memo.value(self.point(u)))

    def gradient(self, u: Array) -> Array:
        slopes = self._scaled(self._memo.gradient(self.point(u)))
        self._slopes = np.array(u), slopes
        return slopes

    def both(self, u: Array) -> tuple[float, Array]:
        """Return the value and the gradient, which one call of the problem may give."""
        value, slopes = value_and_gradient(self._objective, self.point(u))
        return self._sized(value), self._scaled(slopes)

    def batch(self, columns: Array) -> Array:
        """Return the values of points (n, k), as SciPy stands them."""
        points = np.tile(self._start, (columns.shape[1], 1))
        points[:, self.free] = self._origin + columns.T * self._width
        return self._objective.batch(points.clip(self._objective.lower, self._objective.upper))

    def product(self, u: Array, direction: Array) -> Array:
        """Return the Hessian at u times a direction: of 2 J^T J where there is a Jacobian, else of two gradients."""
        curvature = self._memo.curvature(self.point(u))
        if curvature is not None:
            scale = np.outer(self._width, self._width) / self._size
            return np.asarray((curvature[np.ix_(self.free, self.free)] * scale) @ direction)
        base = self._slopes[1] if self._slopes and np.array_equal(self._slopes[0], u) else self.gradient(u)
        length = float(np.linalg.norm(direction))
        if not length:
            return np.zeros(len(u))
        step = _EPS ** (1 / 2 if self.exact else 1 / 4) * max(1.0, float(np.abs(u).max())) / length
        ahead = self._scaled(self._memo.gradient(self.point(u + step * direction)))
        return np.asarray((ahead - base) / step)

    def hessian(self, u: Array) -> Array:
        """Return the Hessian at u, shape (n, n), a product a column, made symmetric."""
        columns = np.array([self.product(u, unit) for unit in np.eye(len(u))])
        return np.asarray(0.5 * (columns + columns.T))

    def point(self, u: Array) -> Array:
        """Return SciPy's point in ours; some miss the box by rounding."""
        norm = u.dot(u)
        if norm != norm:
            raise Lost
        x = np.array(self._start)
        x[self.free] = self._origin + u * self._width
        return x.clip(self._objective.lower, self._objective.upper) if self._bounded else x

    def _sized(self, value: float) -> float:
        if not self._size:
            self._size = abs(value) if np.isfinite(value) and value else 1.0
        return min(value / self._size, _LARGEST)

    def _scaled(self, slopes: Array) -> Array:
        return np.nan_to_num(slopes[self.free] * self._width / (self._size or 1.0), posinf=0.0, neginf=0.0)


EXCLUDED = {
    "trust_krylov": "the same search from the same point goes another way (SciPy 1.17: five runs, two different ends)",
    "leastsq": "it is `lm` here", "least_squares": "it is `lm`, `trf` and `dogbox` here",
    "minimize_scalar": "it is for one variable", "linprog": "it is for linear programs",
    "milp": "it is for whole numbers", "custom": "a method of your own is FILE.py:CLASS",
}  # fmt: skip
for _name, _reason in EXCLUDED.items():
    registry.exclude(f"scipy_{_name}", _reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One method: its `options` (name, type, default), and options of SciPy's that are fixed (`given`).

    `word` is SciPy's name of a method of `minimize`, "" where the method is a function of its own. `stops`: may end by
    itself. `together`: each value comes with its gradient. `hessian`: as products with a direction, or whole. `counts`:
    SciPy's options that limit iterations or evaluations; the wall is the objective's. `first_per_dimension`:
    evaluations of its first model, a dimension.
    """

    about: str
    options: tuple[tuple[str, Any, Any], ...] = ()
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
    maximum_dimension: int | None = None


_SCALED: tuple[str, Any, Any] = ("scaled", bool, True)
_GO_ON: tuple[tuple[str, Any, Any], ...] = (_SCALED, ("restarts", bool, False))
_WOLFE = (("c1", float, 1e-4), ("c2", float, 0.9), *_GO_ON)
_ETA = Annotated[float, Range(0, np.nextafter(0.25, 0))]
_TRUST = (("initial_trust_radius", float, 1.0), ("max_trust_radius", float, 1000.0), ("eta", _ETA, 0.15), *_GO_ON)
_newton = partial(
    Setting, options=_TRUST, given={"gtol": 0.0}, gradient=True, bounded=False, first_per_dimension=1
)  # in a trust region
_STRATEGY = Literal[
    "best1bin", "best1exp", "rand1bin", "rand1exp", "rand2bin", "rand2exp", "randtobest1bin", "randtobest1exp",
    "currenttobest1bin", "currenttobest1exp", "best2bin", "best2exp",
]  # fmt: skip
_INIT, _SAMPLING = Literal["latinhypercube", "sobol", "halton", "random"], Literal["simplicial", "halton", "sobol"]
SETTINGS: dict[str, Setting] = {
    "nelder_mead": Setting(
        about="Nelder-Mead's simplex, its points clipped to the box; `adaptive`: coefficients that follow the"
        " dimension.",
        options=(("adaptive", bool, False), *_GO_ON), word="Nelder-Mead",
        given={"xatol": ROUNDING, "fatol": float("inf")}, counts=("maxiter", "maxfev"), first_per_dimension=1,
    ),
    "powell": Setting(
        about="Powell's method of conjugate directions, one line search after another.",
        options=_GO_ON, word="Powell", given={"xtol": 0.0, "ftol": 0.0}, counts=("maxiter", "maxfev"),
    ),
    "cg": Setting(
        about="Conjugate gradients of Polak and Ribiere, without bounds; `c1`, `c2` of the Wolfe conditions.",
        options=(_WOLFE[0], ("c2", float, 0.4), *_GO_ON), word="CG", given={"gtol": 0.0}, gradient=True, bounded=False,
        first_per_dimension=1,
    ),
    "bfgs": Setting(
        about="BFGS, without bounds; `c1`, `c2` of the Wolfe conditions.",
        options=_WOLFE, word="BFGS", given={"gtol": 0.0, "xrtol": 0.0}, gradient=True, bounded=False,
        first_per_dimension=1,
    ),
    "l_bfgs_b": Setting(
        about="BFGS in a box with limited memory (Byrd, Lu, Nocedal, Zhu 1995).\n\n`maxcor` steps are remembered, and a"
        " line search has `maxls` evaluations.",
        options=(("maxcor", Count, 10), ("maxls", Count, 20), *_GO_ON), word="L-BFGS-B", given=DESCENT,
        counts=("maxiter", "maxfun"), gradient=True, together=True, first_per_dimension=1,
    ),
    "tnc": Setting(
        about="Truncated Newton in a box (Nash 1984); -1 leaves an option to SciPy.",
        options=(("maxCGit", int, -1), ("eta", float, -1.0), ("rescale", float, -1.0), *_GO_ON), word="TNC",
        given={"ftol": 0.0, "xtol": 0.0, "gtol": 0.0}, counts=("maxfun",), gradient=True, together=True,
        first_per_dimension=1,
    ),
    "cobyla": Setting(
        about="Linear models over a simplex (Powell 1994, in PRIMA's Python); may leave the box on its way.\n\n`rhobeg`"
        " is the first trust region, in widths of the box where it is `scaled`.",
        options=(("rhobeg", Positive, 1.0), *_GO_ON), word="COBYLA", given={"tol": ROUNDING}, bounded=False,
        first_per_dimension=1,
    ),
    "cobyqa": Setting(
        about="Quadratic models in a box, without derivatives (Ragonneau 2022).\n\n`initial_tr_radius` is the first"
        " trust region, in widths of the box where it is `scaled`.",
        options=(("initial_tr_radius", Positive, 1.0), *_GO_ON), word="COBYQA", given={"final_tr_radius": ROUNDING},
        counts=("maxiter", "maxfev"), first_per_dimension=2,
    ),
    "slsqp": Setting(
        about="Sequential least-squares programming (Kraft 1988).", options=_GO_ON,
        word="SLSQP", given={"ftol": EQUAL}, gradient=True, first_per_dimension=1,
    ),
    "trust_constr": Setting(
        about="Interior point with trust regions, strictly inside the box (Byrd, Hribar, Nocedal 1999).",
        options=(("initial_tr_radius", Positive, 1.0), ("initial_barrier_parameter", Positive, 0.1), *_GO_ON),
        word="trust-constr", given={"gtol": 0.0, "xtol": ROUNDING, "barrier_tol": ROUNDING}, gradient=True,
        first_per_dimension=1,
    ),
    "newton_cg": Setting(
        about="Newton's method with conjugate gradients and a line search, without bounds.",
        options=_WOLFE, word="Newton-CG", given={"xtol": 0.0}, gradient=True, hessian="products", bounded=False,
        first_per_dimension=1,
    ),
    "trust_ncg": _newton(
        about="Newton with conjugate gradients in a trust region (Steihaug 1983), without bounds.",
        word="trust-ncg", hessian="products",
    ),
    "trust_exact": _newton(
        about="Newton in a trust region that is solved exactly (More, Sorensen 1983), without bounds.",
        word="trust-exact", hessian="whole",
    ),
    "dogleg": _newton(
        about="Powell's dogleg between the steepest descent and Newton's step, without bounds.",
        word="dogleg", hessian="whole",
    ),
    "differential_evolution": Setting(
        about="Differential evolution (Storn, Price 1997), a generation of `popsize` x dim members at a time.\n\n"
        "`mutation`: one factor, or the two ends of what each generation draws its own from.",
        options=(
            ("strategy", _STRATEGY, "best1bin"), ("popsize", Count, 15), ("mutation", tuple[float, ...], (0.5, 1.0)),
            ("recombination", Share, 0.7), ("init", _INIT, "latinhypercube"),
        ),
        given={"tol": -1.0, "atol": -1.0, "polish": False, "updating": "deferred", "vectorized": True}, stops=False,
        stochastic=True, uses_start=False, needs_finite_bounds=True, batches=True,
    ),
    "dual_annealing": Setting(
        about="Generalised annealing with descents between (Xiang et al. 1997).",
        options=(
            ("initial_temp", Annotated[float, Range(0.01, 5e4, above=True)], 5230.0),
            ("restart_temp_ratio", Annotated[float, Range(0, np.nextafter(1, 0), above=True)], 2e-5),
            ("visit", Annotated[float, Range(1, 3, above=True)], 2.62),
            ("accept", Annotated[float, Range(-1e4, -5, above=True)], -5.0), ("no_local_search", bool, False), _SCALED,
        ),
        counts=("maxiter", "maxfun"), stops=False, stochastic=True, gradient=True, needs_finite_bounds=True,
    ),
    "basinhopping": Setting(
        about="Basin hopping (Wales, Doye 1997): descents by L-BFGS-B from points moved at random.\n\n`stepsize` in"
        " widths of the box and `T` in values of the start, where it is `scaled`.",
        options=(("T", Annotated[float, Range(0)], 1.0), ("stepsize", Positive, 0.5), ("interval", Count, 50), _SCALED),
        given={"niter_success": None}, counts=("niter",), stops=False, stochastic=True, gradient=True,
        needs_finite_bounds=True, first_per_dimension=1,
    ),
    "shgo": Setting(
        about="Simplicial homology (Endres, Sandrock, Focke 2018): descents from the minima of a complex of `n`"
        " points.",
        options=(("n", Count, 100), ("iters", Count, 1), ("sampling_method", _SAMPLING, "simplicial"), _SCALED),
        counts=(), stops=False, gradient=True, uses_start=False, needs_finite_bounds=True,
        maximum_dimension=8,  # its complex has 2^d corners
    ),
    "direct": Setting(
        about="Divide the box into rectangles (Jones et al. 1993; `locally_biased`: Gablonsky, Kelley 2001).",
        options=(("eps", Positive, 1e-4), ("locally_biased", bool, True)), given={"vol_tol": 0.0, "len_tol": 0.0},
        counts=("maxfun", "maxiter"), stops=False, uses_start=False, needs_finite_bounds=True,
    ),
    "brute": Setting(
        about="A grid of `Ns` points a coordinate, then a simplex from the best; null: what two thirds of the budget"
        " hold.",
        options=(("Ns", Annotated[int | None, Range(2)], None), _SCALED),
        counts=(), stops=False, uses_start=False, needs_finite_bounds=True, maximum_dimension=16,
    ),
}  # fmt: skip


def _build(method: str, **chosen: Any) -> SciPy:
    return SciPy(method, {name: default for name, _, default in SETTINGS[method].options} | chosen)


for _name, _known in SETTINGS.items():
    _entry = partial(_build, _name)
    _entry.__doc__ = _known.about
    registry.register(f"scipy_{_name}", options=make_dataclass(_name, _known.options))(_entry)
