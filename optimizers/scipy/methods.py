"""SciPy's methods in the registry, each with its options under SciPy's names and with SciPy's defaults.

`scaled`: search the unit box, on the value divided by its first size; false leaves both as they are.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from calibench.optimizers.base import registry
from calibench.optimizers.scipy.adapter import SciPy, Units, optimize
from calibench.optimizers.scipy.settings import DESCENT, EQUAL, ROUNDING, SETTINGS

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
