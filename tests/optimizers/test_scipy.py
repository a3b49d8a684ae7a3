"""SciPy's methods: whole, each the same as a direct call, and open about what is left out."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
import scipy.optimize as so

from calibench import optimizers
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Stop
from calibench.optimizers.scipy import SETTINGS
from tests.optimizers.page import table_of

NAMES = [n for n in optimizers.names() if n.startswith("scipy_")]
BUDGET = 120


class Valley:
    """Rosenbrock's function in an uneven box, with its gradient; keeps its points, and ends after `BUDGET`."""

    lower, upper, start = np.array([-2.0, -1.0, -3.0]), np.array([2.5, 3.0, 2.0]), np.array([-1.2, 1.0, 0.5])

    def __init__(self) -> None:
        self.asked: list[np.ndarray] = []

    def __call__(self, x: np.ndarray) -> float:
        if len(self.asked) == BUDGET:
            raise Stop
        self.asked.append(np.array(x))
        return float(so.rosen(x))

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(so.rosen_der(x))


class Walled:
    """The same, for a direct call: SciPy's coordinates u, the box, and the valley behind them."""

    def __init__(self, scaled: bool, bounded: bool) -> None:
        self.valley, self._bounded = Valley(), bounded
        self.width = self.valley.upper - self.valley.lower if scaled else np.ones(3)
        self.origin = self.valley.lower if scaled else np.zeros(3)
        self.size = 0.0 if scaled else 1.0
        self.low, self.high, self.start = (
            (x - self.origin) / self.width for x in (self.valley.lower, self.valley.upper, self.valley.start)
        )
        self.box = so.Bounds(self.low, self.high)

    def point(self, u: np.ndarray) -> np.ndarray:
        x = self.origin + u * self.width
        if np.isnan(x).any():  # the end of a descent at rounding, which no evaluation can tell anything
            raise Stop
        return x.clip(self.valley.lower, self.valley.upper) if self._bounded else x

    def value(self, u: np.ndarray) -> float:
        value = self.valley(self.point(u))
        self.size = self.size or value
        return value / self.size

    def first_seen(self, u: np.ndarray) -> float:
        """Return the value; a point that comes twice in a row, for its gradient, is one evaluation."""
        x = self.point(u)
        if self.valley.asked and np.array_equal(x, self.valley.asked[-1]):
            return float(so.rosen(x)) / self.size
        return self.value(u)

    def slopes(self, u: np.ndarray) -> np.ndarray:
        return np.asarray(so.rosen_der(self.point(u)) * self.width / self.size)

    def both(self, u: np.ndarray) -> tuple[float, np.ndarray]:
        return self.value(u), self.slopes(u)

    def product(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        if not p.any():
            return np.zeros(3)
        step = np.finfo(float).eps ** 0.5 * max(1.0, np.abs(u).max()) / np.linalg.norm(p)
        return np.asarray((self.slopes(u + step * p) - self.slopes(u)) / step)

    def hessian(self, u: np.ndarray) -> np.ndarray:
        columns = np.array([self.product(u, unit) for unit in np.eye(3)])
        return 0.5 * (columns + columns.T)


def minimized(word: str, derivatives: str = "", bounds: bool = True, **options: Any) -> Callable[[Walled, Any], Any]:
    def call(f: Walled, _rng: Any) -> Any:
        given: dict[str, Any] = {"bounds": f.box} if bounds else {}
        if word == "trust-constr":
            given["bounds"] = so.Bounds(f.low, f.high, keep_feasible=True)
        given |= {"jac": True} if "both" in derivatives else {"jac": f.slopes} if derivatives else {}
        given |= {"hessp": f.product} if "p" in derivatives else {"hess": f.hessian} if "H" in derivatives else {}
        function = f.both if "both" in derivatives else f.first_seen if derivatives else f.value
        return so.minimize(function, f.start, method=word, options=options, **given)

    return call


INNER = {"ftol": 0.0, "gtol": 0.0}
MOST = 10_000
CALLS: dict[str, Callable[[Walled, Any], Any]] = {
    "nelder_mead": minimized("Nelder-Mead", xatol=1e-15, fatol=np.inf, maxiter=MOST),
    "powell": minimized("Powell", xtol=0.0, ftol=0.0, maxiter=MOST),
    "cg": minimized("CG", "g", bounds=False, gtol=0.0, maxiter=MOST),
    "bfgs": minimized("BFGS", "g", bounds=False, gtol=0.0, maxiter=MOST),
    "l_bfgs_b": minimized("L-BFGS-B", "both", **INNER),
    "tnc": minimized("TNC", "both", ftol=0.0, xtol=0.0, gtol=0.0, maxfun=BUDGET + 1),
    "cobyla": minimized("COBYLA", tol=1e-15, maxiter=BUDGET + 1),
    "cobyqa": minimized("COBYQA", final_tr_radius=1e-15, maxfev=BUDGET + 1, maxiter=BUDGET + 1),
    "slsqp": minimized("SLSQP", "g", ftol=1e-300, maxiter=MOST),
    "trust_constr": minimized("trust-constr", "g", gtol=0.0, xtol=1e-15, barrier_tol=1e-15, maxiter=MOST),
    "newton_cg": minimized("Newton-CG", "gp", bounds=False, xtol=0.0, maxiter=MOST),
    "trust_ncg": minimized("trust-ncg", "gp", bounds=False, gtol=0.0, maxiter=MOST),
    "trust_exact": minimized("trust-exact", "gH", bounds=False, gtol=0.0, maxiter=MOST),
    "dogleg": minimized("dogleg", "gH", bounds=False, gtol=0.0, maxiter=MOST),
    "differential_evolution": lambda f, rng: so.differential_evolution(
        lambda X: np.array([f.value(x) for x in X.T]), f.box, rng=rng, tol=-1, atol=-1, polish=False,
        updating="deferred", vectorized=True,
    ),
    "dual_annealing": lambda f, rng: so.dual_annealing(
        f.first_seen, f.box, x0=f.start, rng=rng, maxiter=MOST,
        minimizer_kwargs={"method": "L-BFGS-B", "jac": f.slopes, "bounds": f.box, "options": {**INNER}},
    ),
    "basinhopping": lambda f, rng: so.basinhopping(
        f.both, f.start, rng=rng, niter=MOST,
        minimizer_kwargs={"method": "L-BFGS-B", "jac": True, "bounds": f.box, "options": {**INNER}},
    ),
    "shgo": lambda f, _: so.shgo(
        f.first_seen, f.box, n=100, options={"jac": f.slopes},
        minimizer_kwargs={"method": "SLSQP", "options": {"ftol": 1e-300, "maxiter": MOST}},
    ),
    "direct": lambda f, _: so.direct(f.value, f.box, maxfun=BUDGET + 1, maxiter=BUDGET + 1, vol_tol=0, len_tol=0),
    "brute": lambda f, _: so.brute(
        f.value, tuple(zip(f.low, f.high, strict=True)), Ns=4, finish=lambda g, x0, **_: so.fmin(
            g, x0, xtol=1e-15, ftol=np.inf, disp=False, maxiter=MOST
        ),
    ),
}  # fmt: skip
CASES = [
    (name, scaled)
    for name in NAMES
    for scaled in ((True, False) if "scaled" in optimizers.registry.options(name) else (False,))
]


@pytest.mark.parametrize(("name", "scaled"), CASES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::scipy.optimize.OptimizeWarning")
def test_every_candidate_is_that_of_a_direct_call(name: str, scaled: bool) -> None:
    ours, options = Valley(), {"scaled": scaled} if "scaled" in optimizers.registry.options(name) else {}
    options |= {"Ns": 4} if name == "scipy_brute" else {}
    method = optimizers.make(name, **options)
    with suppress(Stop):
        method.minimize(Evaluator(ours, 100 * BUDGET), np.random.default_rng(5))
    direct = Walled(scaled, method.traits.bounded)
    with suppress(Stop):
        CALLS[name.removeprefix("scipy_")](direct, np.random.default_rng(5))
    expected = np.array(direct.valley.asked)
    assert len(expected) > 20
    assert np.array_equal(np.array(ours.asked)[: len(expected)], expected)  # ours may begin again


def test_every_method_of_scipy_is_there_or_left_out_with_a_reason() -> None:
    from scipy.optimize._minimize import MINIMIZE_METHODS

    known = {n.removeprefix("scipy_") for n in (*NAMES, *optimizers.registry.left_out) if n.startswith("scipy_")}
    assert {word.replace("-", "_") for word in MINIMIZE_METHODS} <= known
    assert {"differential_evolution", "dual_annealing", "basinhopping", "shgo", "direct", "brute"} <= known
    assert {f"scipy_{name}" for name in SETTINGS} == set(NAMES)


def test_the_page_says_what_each_method_is_given_and_why() -> None:
    for (name, setting), cells in zip(SETTINGS.items(), table_of("scipy"), strict=True):
        given = ", ".join(f"`{option}` = {value}" for option, value in setting.given.items()) or "none"
        assert cells[:3] == [f"`{name}`", setting.word or f"{name}()", given]
        assert cells[3]
