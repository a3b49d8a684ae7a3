"""SciPy's minimisers, each by SciPy's own name in lower case: ``scipy_l_bfgs_b`` is L-BFGS-B.

`settings` says what each is given and why, `adapter` runs one, `methods` registers them. Its least squares, which take
residuals, are `calibench.optimizers.least_squares`.

SciPy's methods in the registry, each with its options under SciPy's names and with SciPy's defaults.

`scaled`: search the unit box, on the value divided by its first size; false leaves both as they are.

Run one method of SciPy through the gate: units, tolerances, derivatives, restarts.

SciPy owns the loop and lets our exceptions pass. A search that is `scaled` runs in the unit box and on the value
divided by its first size, so that rad and mm side by side become shares of their own range; otherwise SciPy gets
coordinates and values as they are. A coordinate whose bounds are equal is held, and is no variable to SciPy.

What each method of SciPy is given, with reasons: the tests that may end it, and what it asks for.

The table is static, so that listing needs no SciPy. docs/optimizers.md shows it; the tests hold its claims. A tolerance
of 0 is off. Options of SciPy that are ours to choose for a user are those of `methods`, under SciPy's names.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import Memoized, value_and_gradient

_MOST_AT_ONCE = 2_000_000  # evaluations that DIRECT holds memory for, 50 bytes each and more


def _minimize(method: str, options: Mapping[str, Any], scaled: bool, restarts: bool) -> SciPy:
    """Return a method of SciPy's `minimize`."""
    known = SETTINGS[method]

    def search(units: Units, _rng: np.random.Generator, _turn: int) -> None:
        scipy = optimize()
        asked: dict[str, Any] = {"method": known.word, "options": {**options, **_limits(method, units), **known.given}}
        value: Any = units.remembered if known.gradient else units.value
        if known.gradient:
            asked["jac"] = True if known.together else units.gradient
        if known.hessian is not None:
            asked |= {"hessp": units.product} if known.hessian == "products" else {"hess": units.hessian}
        if known.bounded or method == "cobyla":
            asked["bounds"] = scipy.Bounds(units.lower, units.upper, keep_feasible=method == "trust_constr")
        scipy.minimize(units.both if known.together else value, units.start, **asked)

    return SciPy(method, {**options, "scaled": scaled, "restarts": restarts}, search)


def _limits(method: str, units: Units) -> dict[str, int]:
    """Return limits that are never reached: the objective's wall comes before."""
    return dict.fromkeys(SETTINGS[method].counts, units.remaining + 1)


@registry.register("scipy_nelder_mead")
def scipy_nelder_mead(adaptive: bool = False, scaled: bool = True, restarts: bool = False) -> SciPy:
    """Nelder-Mead's simplex, its points clipped to the box; `adaptive`: coefficients that follow the dimension."""
    return _minimize("nelder_mead", {"adaptive": adaptive}, scaled, restarts)


@registry.register("scipy_powell")
def scipy_powell(scaled: bool = True, restarts: bool = False) -> SciPy:
    """Powell's method of conjugate directions, one line search after another."""
    return _minimize("powell", {}, scaled, restarts)


@registry.register("scipy_cg")
def scipy_cg(c1: float = 1e-4, c2: float = 0.4, scaled: bool = True, restarts: bool = False) -> SciPy:
    """Conjugate gradients of Polak and Ribiere, without bounds; `c1`, `c2` of the Wolfe conditions."""
    _wolfe("scipy_cg", c1, c2)
    return _minimize("cg", {"c1": c1, "c2": c2}, scaled, restarts)


@registry.register("scipy_bfgs")
def scipy_bfgs(c1: float = 1e-4, c2: float = 0.9, scaled: bool = True, restarts: bool = False) -> SciPy:
    """BFGS, without bounds; `c1`, `c2` of the Wolfe conditions."""
    _wolfe("scipy_bfgs", c1, c2)
    return _minimize("bfgs", {"c1": c1, "c2": c2}, scaled, restarts)


@registry.register("scipy_l_bfgs_b")
def scipy_l_bfgs_b(maxcor: int = 10, maxls: int = 20, scaled: bool = True, restarts: bool = False) -> SciPy:
    """BFGS in a box with limited memory (Byrd, Lu, Nocedal, Zhu 1995).

    `maxcor` steps are remembered, and a line search has `maxls` evaluations.
    """
    _least("scipy_l_bfgs_b", 1, maxcor=maxcor, maxls=maxls)
    return _minimize("l_bfgs_b", {"maxcor": maxcor, "maxls": maxls}, scaled, restarts)


@registry.register("scipy_tnc")
def scipy_tnc(
    maxCGit: int = -1, eta: float = -1.0, rescale: float = -1.0, scaled: bool = True, restarts: bool = False
) -> SciPy:
    """Truncated Newton in a box (Nash 1984); -1 leaves an option to SciPy."""
    return _minimize("tnc", {"maxCGit": maxCGit, "eta": eta, "rescale": rescale}, scaled, restarts)


@registry.register("scipy_cobyla")
def scipy_cobyla(rhobeg: float = 1.0, scaled: bool = True, restarts: bool = False) -> SciPy:
    """Linear models over a simplex (Powell 1994, in PRIMA's Python); may leave the box on its way.

    `rhobeg` is the first trust region, in widths of the box where it is `scaled`.
    """
    _above("scipy_cobyla", rhobeg=rhobeg)
    return _minimize("cobyla", {"rhobeg": rhobeg}, scaled, restarts)


@registry.register("scipy_cobyqa")
def scipy_cobyqa(initial_tr_radius: float = 1.0, scaled: bool = True, restarts: bool = False) -> SciPy:
    """Quadratic models in a box, without derivatives (Ragonneau 2022).

    `initial_tr_radius` is the first trust region, in widths of the box where it is `scaled`.
    """
    _above("scipy_cobyqa", initial_tr_radius=initial_tr_radius)
    return _minimize("cobyqa", {"initial_tr_radius": initial_tr_radius}, scaled, restarts)


@registry.register("scipy_slsqp")
def scipy_slsqp(scaled: bool = True, restarts: bool = False) -> SciPy:
    """Sequential least-squares programming (Kraft 1988)."""
    return _minimize("slsqp", {}, scaled, restarts)


@registry.register("scipy_trust_constr")
def scipy_trust_constr(
    initial_tr_radius: float = 1.0,
    initial_barrier_parameter: float = 0.1,
    scaled: bool = True,
    restarts: bool = False,
) -> SciPy:
    """Interior point with trust regions, strictly inside the box (Byrd, Hribar, Nocedal 1999)."""
    chosen = {"initial_tr_radius": initial_tr_radius, "initial_barrier_parameter": initial_barrier_parameter}
    _above("scipy_trust_constr", **chosen)
    return _minimize("trust_constr", chosen, scaled, restarts)


@registry.register("scipy_newton_cg")
def scipy_newton_cg(c1: float = 1e-4, c2: float = 0.9, scaled: bool = True, restarts: bool = False) -> SciPy:
    """Newton's method with conjugate gradients and a line search, without bounds."""
    _wolfe("scipy_newton_cg", c1, c2)
    return _minimize("newton_cg", {"c1": c1, "c2": c2}, scaled, restarts)


@registry.register("scipy_trust_ncg")
def scipy_trust_ncg(
    initial_trust_radius: float = 1.0, max_trust_radius: float = 1000.0, eta: float = 0.15, scaled: bool = True,
    restarts: bool = False,
) -> SciPy:  # fmt: skip
    """Newton with conjugate gradients in a trust region (Steihaug 1983), without bounds."""
    return _trust("trust_ncg", initial_trust_radius, max_trust_radius, eta, scaled, restarts)


@registry.register("scipy_trust_exact")
def scipy_trust_exact(
    initial_trust_radius: float = 1.0, max_trust_radius: float = 1000.0, eta: float = 0.15, scaled: bool = True,
    restarts: bool = False,
) -> SciPy:  # fmt: skip
    """Newton in a trust region that is solved exactly (More, Sorensen 1983), without bounds."""
    return _trust("trust_exact", initial_trust_radius, max_trust_radius, eta, scaled, restarts)


@registry.register("scipy_dogleg")
def scipy_dogleg(
    initial_trust_radius: float = 1.0, max_trust_radius: float = 1000.0, eta: float = 0.15, scaled: bool = True,
    restarts: bool = False,
) -> SciPy:  # fmt: skip
    """Powell's dogleg between the steepest descent and Newton's step, without bounds."""
    return _trust("dogleg", initial_trust_radius, max_trust_radius, eta, scaled, restarts)


def _trust(method: str, first: float, most: float, eta: float, scaled: bool, restarts: bool) -> SciPy:
    chosen = {"initial_trust_radius": first, "max_trust_radius": most, "eta": eta}
    if not 0 < first < most:
        raise ValueError(
            f"scipy_{method}.initial_trust_radius={first:g}: must be above 0 and below max_trust_radius={most:g}"
        )
    if not 0 <= eta < 0.25:
        raise ValueError(f"scipy_{method}.eta={eta:g}: must lie in 0 .. 0.25")
    return _minimize(method, chosen, scaled, restarts)


@registry.register("scipy_differential_evolution")
def scipy_differential_evolution(
    strategy: Literal[
        "best1bin", "best1exp", "rand1bin", "rand1exp", "rand2bin", "rand2exp", "randtobest1bin", "randtobest1exp",
        "currenttobest1bin", "currenttobest1exp", "best2bin", "best2exp",
    ] = "best1bin",
    popsize: int = 15,
    mutation: tuple[float, ...] = (0.5, 1.0),
    recombination: float = 0.7,
    init: Literal["latinhypercube", "sobol", "halton", "random"] = "latinhypercube",
) -> SciPy:  # fmt: skip
    """Differential evolution (Storn, Price 1997), a generation of `popsize` x dim members at a time.

    `mutation`: one factor, or the two ends of what each generation draws its own from.
    """
    _least("scipy_differential_evolution", 1, popsize=popsize)
    if len(mutation) not in (1, 2) or not all(0 <= one < 2 for one in mutation):
        raise ValueError(f"scipy_differential_evolution.mutation={list(mutation)}: one or two numbers in 0 .. 2")
    if not 0 <= recombination <= 1:
        raise ValueError(f"scipy_differential_evolution.recombination={recombination:g}: must lie in 0 .. 1")
    chosen = {"strategy": strategy, "popsize": popsize, "recombination": recombination, "init": init}
    factor = mutation[0] if len(mutation) == 1 else mutation

    def search(units: Units, rng: np.random.Generator, _turn: int) -> None:
        scipy = optimize()
        options = {**chosen, **_limits("differential_evolution", units), **SETTINGS["differential_evolution"].given}
        box = scipy.Bounds(units.lower, units.upper)
        scipy.differential_evolution(units.batch, box, mutation=factor, rng=rng, **options)

    return SciPy("differential_evolution", {**chosen, "mutation": mutation}, search)


@registry.register("scipy_dual_annealing")
def scipy_dual_annealing(
    initial_temp: float = 5230.0,
    restart_temp_ratio: float = 2e-5,
    visit: float = 2.62,
    accept: float = -5.0,
    no_local_search: bool = False,
    scaled: bool = True,
) -> SciPy:
    """Generalised annealing with descents between (Xiang et al. 1997)."""
    for option, value, low, high in (
        ("initial_temp", initial_temp, 0.01, 5e4), ("restart_temp_ratio", restart_temp_ratio, 0.0, 1.0),
        ("visit", visit, 1.0, 3.0), ("accept", accept, -1e4, -5.0),
    ):  # fmt: skip
        if not low < value < high and value not in (5e4, 3.0, -5.0):  # SciPy's ranges hold these ends
            raise ValueError(f"scipy_dual_annealing.{option}={value:g}: must lie in {low:g} .. {high:g}")
    chosen = {
        "initial_temp": initial_temp, "restart_temp_ratio": restart_temp_ratio, "visit": visit, "accept": accept,
        "no_local_search": no_local_search,
    }  # fmt: skip

    def search(units: Units, rng: np.random.Generator, _turn: int) -> None:
        scipy = optimize()
        box = scipy.Bounds(units.lower, units.upper)
        descent = {"method": "L-BFGS-B", "jac": units.gradient, "bounds": box, "options": {**DESCENT}}
        scipy.dual_annealing(
            units.remembered, box, minimizer_kwargs=descent, x0=units.start, rng=rng, **chosen,
            **_limits("dual_annealing", units),
        )  # fmt: skip

    return SciPy("dual_annealing", {**chosen, "scaled": scaled}, search)


@registry.register("scipy_basinhopping")
def scipy_basinhopping(T: float = 1.0, stepsize: float = 0.5, interval: int = 50, scaled: bool = True) -> SciPy:
    """Basin hopping (Wales, Doye 1997): descents by L-BFGS-B from points moved at random.

    `stepsize` in widths of the box and `T` in values of the start, where it is `scaled`.
    """
    _above("scipy_basinhopping", stepsize=stepsize)
    _least("scipy_basinhopping", 1, interval=interval)
    if T < 0:
        raise ValueError(f"scipy_basinhopping.T={T:g}: must be 0 or more")
    chosen = {"T": T, "stepsize": stepsize, "interval": interval}

    def search(units: Units, rng: np.random.Generator, _turn: int) -> None:
        scipy = optimize()
        box = scipy.Bounds(units.lower, units.upper)
        descent = {"method": "L-BFGS-B", "jac": True, "bounds": box, "options": {**DESCENT}}
        options = {**chosen, **_limits("basinhopping", units), **SETTINGS["basinhopping"].given}
        scipy.basinhopping(units.both, units.start, minimizer_kwargs=descent, rng=rng, **options)

    return SciPy("basinhopping", {**chosen, "scaled": scaled}, search)


@registry.register("scipy_shgo")
def scipy_shgo(
    n: int = 100,
    iters: int = 1,
    sampling_method: Literal["simplicial", "halton", "sobol"] = "simplicial",
    scaled: bool = True,
) -> SciPy:
    """Simplicial homology (Endres, Sandrock, Focke 2018): descents from the minima of a complex of `n` points."""
    _least("scipy_shgo", 1, n=n, iters=iters)
    chosen: dict[str, Any] = {"n": n, "iters": iters, "sampling_method": sampling_method}

    def search(units: Units, _rng: np.random.Generator, turn: int) -> None:
        scipy = optimize()
        box = scipy.Bounds(units.lower, units.upper)
        descent = {"method": "SLSQP", "options": {"ftol": EQUAL, "maxiter": units.remaining + 1}}
        finer = {**chosen, "n": n * 2**turn}
        handlers = logging.root.handlers[:]
        try:
            scipy.shgo(units.remembered, box, minimizer_kwargs=descent, options={"jac": units.gradient}, **finer)
        finally:
            logging.root.handlers[:] = handlers  # it logs by functions that give the root one

    return SciPy("shgo", {**chosen, "scaled": scaled}, search)


@registry.register("scipy_direct")
def scipy_direct(eps: float = 1e-4, locally_biased: bool = True) -> SciPy:
    """Divide the box into rectangles (Jones et al. 1993; `locally_biased`: Gablonsky, Kelley 2001)."""
    _above("scipy_direct", eps=eps)
    chosen = {"eps": eps, "locally_biased": locally_biased}

    def search(units: Units, _rng: np.random.Generator, _turn: int) -> None:
        scipy = optimize()
        limits = {key: min(most, _MOST_AT_ONCE) for key, most in _limits("direct", units).items()}
        scipy.direct(
            units.value, scipy.Bounds(units.lower, units.upper), **chosen, **limits, **SETTINGS["direct"].given
        )

    return SciPy("direct", chosen, search)


@registry.register("scipy_brute")
def scipy_brute(Ns: int | None = None, scaled: bool = True) -> SciPy:
    """A grid of `Ns` points a coordinate, then a simplex from the best; null: what two thirds of the budget hold."""
    if Ns is not None:
        _least("scipy_brute", 2, Ns=Ns)

    def search(units: Units, _rng: np.random.Generator, turn: int) -> None:
        scipy = optimize()

        def finish(function: Any, x0: Any, args: Any = (), **_quiet: Any) -> Any:
            limits = dict.fromkeys(("maxiter", "maxfun"), units.remaining + 1)
            tolerances = {"xtol": ROUNDING, "ftol": np.inf}
            return scipy.fmin(function, x0, args=args, full_output=True, disp=False, **tolerances, **limits)

        held = int(min(units.remaining * 2 / 3, _MOST_AT_ONCE) ** (1 / len(units.lower)))
        points = (max(2, held) if Ns is None else Ns) + turn
        ranges = tuple(zip(units.lower, units.upper, strict=True))
        scipy.brute(units.value, ranges, Ns=points, full_output=True, finish=finish)

    return SciPy("brute", {"Ns": Ns, "scaled": scaled}, search)


def _above(name: str, **options: float) -> None:
    for option, value in options.items():
        if not 0 < value < np.inf:
            raise ValueError(f"{name}.{option}={value:g}: must be above 0")


def _least(name: str, least: int, **options: int) -> None:
    for option, value in options.items():
        if value < least:
            raise ValueError(f"{name}.{option}={value}: must be {least} or more")


def _wolfe(name: str, c1: float, c2: float) -> None:
    if not 0 < c1 < c2 < 1:
        raise ValueError(f"{name}.c1={c1:g}: must be above 0 and below c2={c2:g}, and that below 1")


EXCLUDED = {
    "trust_krylov": "the same search from the same point goes another way (SciPy 1.17: five runs, two different ends)",
    "leastsq": "it is `lm` here", "least_squares": "it is `lm`, `trf` and `dogbox` here",
    "minimize_scalar": "it is for one variable", "linprog": "it is for linear programs",
    "milp": "it is for whole numbers", "custom": "a method of your own is FILE.py:CLASS",
}  # fmt: skip
for _name, _reason in EXCLUDED.items():
    registry.exclude(f"scipy_{_name}", _reason)


_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN
_EPS = float(np.finfo(float).eps)


class _Lost(Exception):
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
        self.lower, self.upper = (self._of(x) for x in (lower, upper))
        self.start = np.clip(self._of(start), self.lower, self.upper)
        self._size = 0.0 if scaled else 1.0
        self._memo = Memoized(objective, analytic=True, kind="forward", bounded=bounded)
        self._slopes: tuple[Array, Array] | None = None  # where a gradient was asked for last, and what it was
        self.exact = objective.has_gradient or (objective.has_residuals and objective.has_jacobian)

    @property
    def remaining(self) -> int:
        """Return what is left of the budget, in the int of SciPy's compiled parts."""
        return min(self._objective.remaining, 2**31 - 2)

    def value(self, u: Array) -> float:
        """Return the value, of a method that asks for nothing else."""
        return self._sized(self._objective(self._point(u)))

    def remembered(self, u: Array) -> float:
        """Return the value, and keep what a gradient at the same point will need."""
        return self._sized(self._memo.value(self._point(u)))

    def gradient(self, u: Array) -> Array:
        """Return the gradient, shape (n,)."""
        slopes = self._scaled(self._memo.gradient(self._point(u)))
        self._slopes = np.array(u), slopes
        return slopes

    def both(self, u: Array) -> tuple[float, Array]:
        """Return the value and the gradient, which one call of the problem may give."""
        value, slopes = value_and_gradient(self._objective, self._point(u))
        return self._sized(value), self._scaled(slopes)

    def batch(self, columns: Array) -> Array:
        """Return the values of points (n, k), as SciPy stands them."""
        points = np.tile(self._start, (columns.shape[1], 1))
        points[:, self.free] = self._origin + columns.T * self._width
        return self._objective.batch(points.clip(self._objective.lower, self._objective.upper))

    def product(self, u: Array, direction: Array) -> Array:
        """Return the Hessian at u times a direction: of 2 J^T J where there is a Jacobian, else of two gradients."""
        curvature = self._memo.curvature(self._point(u))
        if curvature is not None:
            scale = np.outer(self._width, self._width) / self._size
            product: Array = (curvature[np.ix_(self.free, self.free)] * scale) @ direction
            return product
        base = self._slopes[1] if self._slopes and np.array_equal(self._slopes[0], u) else self.gradient(u)
        length = float(np.linalg.norm(direction))
        if not length:
            return np.zeros(len(u))
        step = _EPS ** (1 / 2 if self.exact else 1 / 4) * max(1.0, float(np.abs(u).max())) / length
        ahead = self._scaled(self._memo.gradient(self._point(u + step * direction)))
        change: Array = (ahead - base) / step
        return change

    def hessian(self, u: Array) -> Array:
        """Return the Hessian at u, shape (n, n), a product a column, made symmetric."""
        columns = np.array([self.product(u, unit) for unit in np.eye(len(u))])
        whole: Array = 0.5 * (columns + columns.T)
        return whole

    def _of(self, x: Array) -> Array:
        return (x[self.free] - self._origin) / self._width

    def _point(self, u: Array) -> Array:
        """Return SciPy's point in ours; some miss the box by rounding."""
        norm = u.dot(u)
        if norm != norm:
            raise _Lost
        x = np.array(self._start)
        x[self.free] = self._origin + u * self._width
        return x.clip(self._objective.lower, self._objective.upper) if self._bounded else x

    def _sized(self, value: float) -> float:
        if not self._size:
            self._size = abs(value) if np.isfinite(value) and value else 1.0
        return min(value / self._size, _LARGEST)

    def _scaled(self, slopes: Array) -> Array:
        return np.nan_to_num(slopes[self.free] * self._width / (self._size or 1.0), posinf=0.0, neginf=0.0)


# (the objective in SciPy's coordinates, a generator, which of the restarts this is): run SciPy once
Search = Callable[[Units, np.random.Generator, int], object]


@final
@dataclass(frozen=True)
class SciPy:
    """One method of SciPy with its options, and `search`, which calls SciPy."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    method: str
    options: Mapping[str, Any]
    search: Search = field(repr=False, compare=False)

    library: ClassVar[str] = "scipy"

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"scipy_{self.method}"

    @property
    def traits(self) -> Traits:
        """Return the traits that the table holds; with `restarts` it goes on, at random, until it is stopped."""
        known, restarts = SETTINGS[self.method], self.options.get("restarts", False)
        population = self.options.get("popsize", 0)
        return Traits(
            stochastic=known.stochastic or (restarts and known.uses_start),
            uses_gradient=known.gradient,
            bounded=known.bounded,
            self_terminating=known.stops and not restarts,
            uses_start=known.uses_start,
            minimum_budget=self.options.get("n", 1),
            minimum_budget_per_dimension=population or known.first_per_dimension,
            minimum_dimension=known.minimum_dimension,
            maximum_dimension=known.maximum_dimension,
            needs_finite_bounds=known.needs_finite_bounds or restarts,
            batches=known.batches,
        )

    def compile(self) -> None:
        """Import SciPy's part, so that no clock sees it."""
        optimize()

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, or where it ends against its habit, again from random points."""
        known, turns = SETTINGS[self.method], count()

        def descend(start: Array) -> None:
            units = Units(objective, start, self.options.get("scaled", False), known.bounded)
            if not units.free.any():
                objective(start)
                return
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # overflow far outside the box, a line search without an end
                try:
                    self.search(units, rng, next(turns))
                except _Lost:
                    pass

        return with_restarts(descend, objective, restarts=not self.traits.self_terminating)


def optimize() -> Any:
    """Return the module `scipy.optimize`; its stubs know no options that are collected in a mapping."""
    import scipy.optimize

    return scipy.optimize


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
