"""pygmo's methods that move one point: from the start, where the population methods ignore it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from calibench.optimizers.base import Objective, registry
from calibench.optimizers.pygmo.adapter import Build, Pygmo, require, within


@registry.register("pygmo_compass_search")
def pygmo_compass_search(
    start_range: float = 0.1, stop_range: float = 1e-16, reduction_coeff: float = 0.5, restarts: bool = False
) -> Pygmo:
    """Compass search: steps along the axes, in shares of the box, which shrink from `start_range` to `stop_range`."""
    within("compass_search", 1e-300, 1, start_range=start_range)
    within("compass_search", 1e-300, start_range, stop_range=stop_range)
    within("compass_search", 1e-3, 1 - 1e-3, reduction_coeff=reduction_coeff)
    ranges = dict(start_range=start_range, stop_range=stop_range, reduction_coeff=reduction_coeff)
    options = {**ranges, "restarts": restarts}
    return Pygmo("compass_search", options, _compass(ranges), from_start=True, stops=True, stochastic=False)


@registry.register("pygmo_simulated_annealing")
def pygmo_simulated_annealing(
    Ts: float = 0.1,
    Tf: float = 1e-8,
    n_T_adj: int | None = None,
    n_range_adj: int = 1,
    bin_size: int = 20,
    start_range: float = 1.0,
) -> Pygmo:
    """Corana's annealing from temperature `Ts` to `Tf`, in units of the value at the start.

    `n_T_adj` temperatures; null: as many as the budget holds. When the schedule is over it begins again at random.
    """
    require("pygmo_simulated_annealing.Tf", Tf, 0 < Tf < Ts, f"must be above 0 and below Ts={Ts:g}")
    for option, value in (("n_T_adj", n_T_adj), ("n_range_adj", n_range_adj), ("bin_size", bin_size)):
        require(f"pygmo_simulated_annealing.{option}", value, value is None or value >= 1, "must be 1 or more")
    within("simulated_annealing", 1e-300, 1, start_range=start_range)
    rest = dict(n_range_adj=n_range_adj, bin_size=bin_size, start_range=start_range)

    def build(pygmo: Any, objective: Objective, _size: int) -> Any:
        held = max(1, objective.remaining // (n_range_adj * bin_size * objective.dimension))
        return pygmo.simulated_annealing(Ts=Ts, Tf=Tf, n_T_adj=n_T_adj or held, **rest)

    options = {"Ts": Ts, "Tf": Tf, "n_T_adj": n_T_adj, **rest}
    return Pygmo("simulated_annealing", options, build, from_start=True, scaled=True)


@registry.register("pygmo_sea")
def pygmo_sea() -> Pygmo:
    """(1+1) evolution strategy: some coordinates drawn anew in the box, kept if better."""

    def build(pygmo: Any, objective: Objective, _size: int) -> Any:
        return pygmo.sea(gen=objective.remaining + 1)

    return Pygmo("sea", {}, build, from_start=True)


@registry.register("pygmo_ipopt")
def pygmo_ipopt(tolerance: float = 1e-15, memory: int | None = None, restarts: bool = False) -> Pygmo:
    """Ipopt: interior point with limited-memory curvature (Waechter, Biegler 2006); `tolerance` of optimality.

    `memory`: steps that the curvature remembers; null: the dimension, and at least Ipopt's own 6. With fewer steps than
    dimensions it crawls where the condition is high. The value is divided by its first size, so that the tolerance is
    relative: 1e-15 is the goal of a calibration, and below it a descent ends by Ipopt's own smallest step.
    """
    within("ipopt", 1e-300, 1, tolerance=tolerance)
    require("pygmo_ipopt.memory", memory, memory is None or memory >= 1, "must be 1 or more, or null")
    options = {"tolerance": tolerance, "memory": memory, "restarts": restarts}
    build = _ipopt(tolerance, memory)
    return Pygmo(
        "ipopt", options, build, from_start=True, scaled=True, stops=True, stochastic=False, uses_gradient=True
    )


@registry.register("pygmo_mbh")
def pygmo_mbh(
    inner: Literal["compass_search", "ipopt"] = "compass_search", perturb: float = 0.01, inner_tolerance: float = 1e-8
) -> Pygmo:
    """Monotonic basin hopping: `inner` from the best point, moved at random by up to `perturb` of the box, for ever.

    `inner_tolerance` ends a descent: the stop range of compass search, the tolerance of Ipopt.
    """
    within("mbh", 1e-300, 1, perturb=perturb)
    within("mbh", 1e-300, 0.1, inner_tolerance=inner_tolerance)
    ranges = dict(start_range=0.1, stop_range=inner_tolerance, reduction_coeff=0.5)
    descent = _compass(ranges) if inner == "compass_search" else _ipopt(inner_tolerance)

    def build(pygmo: Any, objective: Objective, _size: int) -> Any:
        local = pygmo.algorithm(descent(pygmo, objective, 1))
        return pygmo.mbh(algo=local, stop=objective.remaining + 1, perturb=perturb)

    options = {"inner": inner, "perturb": perturb, "inner_tolerance": inner_tolerance}
    gradient = inner == "ipopt"
    return Pygmo("mbh", options, build, from_start=True, scaled=gradient, uses_gradient=gradient)


def _compass(ranges: Mapping[str, float]) -> Build:
    def build(pygmo: Any, objective: Objective, _size: int) -> Any:
        return pygmo.compass_search(max_fevals=objective.remaining + 1, **ranges)

    return build


def _ipopt(tolerance: float, memory: int | None = None) -> Build:
    def build(pygmo: Any, objective: Objective, _size: int) -> Any:
        ipopt = pygmo.ipopt()
        ipopt.set_string_option("sb", "yes")  # no banner
        ipopt.set_integer_option("print_level", 0)
        ipopt.set_integer_option("max_iter", objective.remaining + 1)
        ipopt.set_integer_option("limited_memory_max_history", memory or max(6, objective.dimension))
        ipopt.set_integer_option("acceptable_iter", 0)  # no second, looser test
        ipopt.set_numeric_option("tol", tolerance)
        for looser in ("dual_inf_tol", "compl_inf_tol"):
            ipopt.set_numeric_option(looser, tolerance)
        ipopt.set_numeric_option("bound_relax_factor", 0.0)
        return ipopt

    return build
