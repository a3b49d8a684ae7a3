"""pygmo's algorithms, each under its own name: ``pygmo_de`` is pygmo's de.

`population_sizes` says how many members each has and why, `adapter` runs one, `populations` and `trajectories` register
them: those that evolve a random population, and those that move one point from the start.

pygmo's population methods: a random population in the box, evolved until the budget is spent.

The start is ignored. Defaults are pygmo's own, but for the population, which pygmo leaves to its user: a rule of
`population_sizes` gives it, whose formula is the default (d: dimension, B: budget), and null too. Ranges are checked
here, at construction, so that the sentence names the option and not a line of C++.

pygmo's methods that move one point: from the start, where the population methods ignore it.

Run one pygmo algorithm through the gate: one problem, one population, one budget.

pygmo owns the loop: it evolves a population of which every member passes our objective. Tolerances are off; a method
that stops all the same begins again with a new population, and the restart stands in the trace. pygmo's own counts are
not used (they miss the differences). Where it can take a generation's values at once, they come from our batch.

The default population size of each pygmo method: a rule for each, with its source.

pygmo leaves the number to its user. A rule gives it from the dimension d of the problem and the budget B that is left:
the number of the method's paper or of its authors' code, and where such a number spends a small budget on too few
generations, at most a share of the budget. What the numbers cost and bring is measured in docs/optimizers.md on our
problems and on functions that are not ours (``python -m benchmarks.populations.sizes``).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import floor, log, sqrt
from typing import Any, ClassVar, Literal, TypeVar, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import Memoized

_NEVER: dict[str, Any] = {"ftol": 0.0, "xtol": 0.0}


@registry.register("pygmo_de")
def pygmo_de(
    population: int | Literal["min(10d,B/500)"] | None = "min(10d,B/500)",
    F: float = 0.8,
    CR: float = 0.9,
    variant: int = 2,
) -> Pygmo:
    """Differential evolution; `variant` 1-10 as pygmo numbers them (2 is rand/1/exp)."""
    within("de", 0, 1, F=F, CR=CR)
    within("de", 1, 10, variant=variant)
    return evolved("de", population, {"F": F, "CR": CR, "variant": variant}, least=5, fixed=_NEVER)


@registry.register("pygmo_sade")
def pygmo_sade(
    population: int | Literal["min(100,B/500)"] | None = "min(100,B/500)", variant: int = 2, variant_adptv: int = 1
) -> Pygmo:
    """Self-adaptive differential evolution; `variant` 1-18, `variant_adptv` 1 (jDE) or 2 (iDE)."""
    within("sade", 1, 18, variant=variant)
    within("sade", 1, 2, variant_adptv=variant_adptv)
    arguments = {"variant": variant, "variant_adptv": variant_adptv}
    return evolved("sade", population, arguments, least=7, fixed=_NEVER)


@registry.register("pygmo_de1220")
def pygmo_de1220(
    population: int | Literal["min(100,B/500)"] | None = "min(100,B/500)",
    allowed_variants: tuple[int, ...] = (2, 3, 7, 10, 13, 14, 15, 16),
    variant_adptv: int = 1,
) -> Pygmo:
    """Differential evolution that adapts its variant too, out of `allowed_variants` (each 1-18)."""
    rule = "one or more whole numbers in 1 .. 18 are needed"
    good = bool(allowed_variants) and all(1 <= variant <= 18 for variant in allowed_variants)
    require("pygmo_de1220.allowed_variants", list(allowed_variants), good, rule)
    within("de1220", 1, 2, variant_adptv=variant_adptv)
    arguments = {"allowed_variants": list(allowed_variants), "variant_adptv": variant_adptv}
    return evolved("de1220", population, arguments, least=7, fixed=_NEVER)


def _swarm(algorithm: str, population: int | str | None, arguments: dict[str, Any]) -> Pygmo:
    within(algorithm, 0, 1, omega=arguments["omega"])
    within(algorithm, 0, 4, eta1=arguments["eta1"], eta2=arguments["eta2"])
    within(algorithm, 1e-300, 1, max_vel=arguments["max_vel"])
    within(algorithm, 1, 6, variant=arguments["variant"])
    within(algorithm, 1, 4, neighb_type=arguments["neighb_type"])
    require(
        f"pygmo_{algorithm}.neighb_param",
        arguments["neighb_param"],
        arguments["neighb_param"] >= 1,
        "must be 1 or more",
    )
    return evolved(algorithm, population, arguments, least=2, batches=algorithm == "pso_gen")


@registry.register("pygmo_pso")
def pygmo_pso(
    population: int | Literal["10+2sqrt(d)"] | None = "10+2sqrt(d)",
    omega: float = 0.7298,
    eta1: float = 2.05,
    eta2: float = 2.05,
    max_vel: float = 0.5,
    variant: int = 5,
    neighb_type: int = 2,
    neighb_param: int = 4,
) -> Pygmo:
    """Particle swarm; `variant` 1-6 (5: constriction), `neighb_type` 1-4 (2: ring of `neighb_param`)."""
    options = dict(omega=omega, eta1=eta1, eta2=eta2, max_vel=max_vel)
    topology = dict(variant=variant, neighb_type=neighb_type, neighb_param=neighb_param)
    return _swarm("pso", population, {**options, **topology})


@registry.register("pygmo_pso_gen")
def pygmo_pso_gen(
    population: int | Literal["10+2sqrt(d)"] | None = "10+2sqrt(d)",
    omega: float = 0.7298,
    eta1: float = 2.05,
    eta2: float = 2.05,
    max_vel: float = 0.5,
    variant: int = 5,
    neighb_type: int = 2,
    neighb_param: int = 4,
) -> Pygmo:
    """Particle swarm whose particles move all at once, a generation at a time; options as pygmo_pso."""
    options = dict(omega=omega, eta1=eta1, eta2=eta2, max_vel=max_vel)
    topology = dict(variant=variant, neighb_type=neighb_type, neighb_param=neighb_param)
    return _swarm("pso_gen", population, {**options, **topology})


@registry.register("pygmo_sga")
def pygmo_sga(
    population: int | Literal["min(200,B/25)"] | None = "min(200,B/25)",
    cr: float = 0.9,
    eta_c: float = 1.0,
    m: float = 0.02,
    param_m: float = 1.0,
    param_s: int = 2,
    crossover: Literal["exponential", "binomial", "single", "sbx"] = "exponential",
    mutation: Literal["gaussian", "polynomial", "uniform"] = "polynomial",
    selection: Literal["tournament", "truncated"] = "tournament",
) -> Pygmo:
    """Simple genetic algorithm; probabilities `cr`, `m`, and the parameters of its three operators."""
    within("sga", 0, 1, cr=cr, m=m)
    within("sga", 1, 100, eta_c=eta_c)
    low, high = (1.0, 100.0) if mutation == "polynomial" else (0.0, 1.0)
    within("sga", low, high, param_m=param_m)
    even = crossover != "sbx" or not isinstance(population, int) or population % 2 == 0
    require("pygmo_sga.population", population, even, "sbx mates pairs: an even number is needed")
    within("sga", 1, population if isinstance(population, int) else RULES["sga"].least, param_s=param_s)
    operators = dict(crossover=crossover, mutation=mutation, selection=selection)
    numbers = dict(cr=cr, eta_c=eta_c, m=m, param_m=param_m, param_s=param_s)
    return evolved("sga", population, {**numbers, **operators}, least=2)


@registry.register("pygmo_bee_colony")
def pygmo_bee_colony(population: int | None = 62, limit: int = 20) -> Pygmo:
    """Artificial bee colony; a source that did not improve `limit` times is left.

    A generation costs two populations.
    """
    require("pygmo_bee_colony.limit", limit, limit >= 1, "must be 1 or more")
    return evolved("bee_colony", population, {"limit": limit}, least=2, per_generation=lambda size: 2 * size)


@registry.register("pygmo_gaco")
def pygmo_gaco(
    population: int | Literal["min(50,B/250)"] | None = "min(50,B/250)",
    ker: int | None = None,
    q: float = 1.0,
    acc: float = 0.01,
    focus: float = 0.0,
) -> Pygmo:
    """Extended ant colony; `ker` solutions are remembered, `q` weighs the better ones, `focus` narrows the search.

    `ker` null: pygmo's 63, or the whole population where it is smaller.

    `acc` is the least distance between what is remembered. pygmo's two stops by count are switched off.
    """
    smallest = population if isinstance(population, int) else RULES["gaco"].least
    if ker is not None:
        within("gaco", 2, smallest, ker=ker)
    require("pygmo_gaco.q", q, q >= 0, "must be 0 or more")
    require("pygmo_gaco.acc", acc, acc >= 0, "must be 0 or more")
    require("pygmo_gaco.focus", focus, focus >= 0, "must be 0 or more")
    arguments = {"ker": ker, "q": q, "acc": acc, "focus": focus}
    never = {"impstop": 2**31 - 1, "evalstop": 2**31 - 1}
    return evolved("gaco", population, arguments, least=2, batches=True, adapt=_with_kernel, fixed=never)


def _with_kernel(options: dict[str, Any], size: int) -> dict[str, Any]:
    return options if options["ker"] is not None else {**options, "ker": min(63, size)}


@registry.register("pygmo_gwo")
def pygmo_gwo(population: int | None = 30) -> Pygmo:
    """Grey wolf optimiser: it narrows over the generations, of which it is given as many as the budget holds."""
    return evolved("gwo", population, {}, least=3)


@registry.register("pygmo_cmaes")
def pygmo_cmaes(population: int | Literal["4+3ln(d)"] | None = "4+3ln(d)", sigma0: float = 0.5) -> Pygmo:
    """Covariance matrix adaptation; `sigma0` is the first step size in shares of the box."""
    require("pygmo_cmaes.sigma0", sigma0, sigma0 > 0, "must be above 0")
    never = {**_NEVER, "force_bounds": True}
    return evolved("cmaes", population, {"sigma0": sigma0}, least=5, fixed=never, batches=True)


@registry.register("pygmo_xnes")
def pygmo_xnes(population: int | Literal["4+3ln(d)"] | None = "4+3ln(d)", sigma0: float | None = None) -> Pygmo:
    """Exponential natural evolution strategy; `sigma0` is the first step size, null leaves it to pygmo."""
    require("pygmo_xnes.sigma0", sigma0, sigma0 is None or 0 < sigma0 <= 1, "must lie in 0 .. 1, above 0, or null")
    never = {**_NEVER, "force_bounds": True}
    return evolved("xnes", population, {"sigma0": sigma0}, least=4, adapt=_with_width, fixed=never)


def _with_width(options: dict[str, Any], _size: int) -> dict[str, Any]:
    return {**options, "sigma0": options["sigma0"] or -1.0}  # -1 leaves it to pygmo


@registry.register("pygmo_ihs")
def pygmo_ihs(
    population: int | None = 5,
    phmcr: float = 0.85,
    ppar_min: float = 0.35,
    ppar_max: float = 0.99,
    bw_min: float = 1e-5,
    bw_max: float = 1.0,
) -> Pygmo:
    """Improved harmony search: one new harmony an iteration; `ppar` rises and `bw` falls over the budget."""
    within("ihs", 0, 1, phmcr=phmcr, ppar_min=ppar_min, ppar_max=ppar_max)
    require("pygmo_ihs.ppar_min", ppar_min, ppar_min < ppar_max, f"must be below ppar_max={ppar_max:g}")
    require("pygmo_ihs.bw_min", bw_min, 0 < bw_min < bw_max, f"must be above 0 and below bw_max={bw_max:g}")
    arguments = dict(phmcr=phmcr, ppar_min=ppar_min, ppar_max=ppar_max, bw_min=bw_min, bw_max=bw_max)
    return evolved("ihs", population, arguments, least=1, per_generation=lambda _size: 1)


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


# (the module pygmo, the objective, the number of members) -> pygmo's algorithm object
Build = Callable[[Any, Objective, int], Any]
T = TypeVar("T")


@final
@dataclass(frozen=True)
class Pygmo:
    """One pygmo algorithm with its options, and `build`, which makes pygmo's own object for what is left to spend.

    `from_start`: one member at the start, instead of a random population; the trait `uses_start` is just this.
    `scaled`: the search runs in the unit box and on the value divided by its first size. `stops`: may end by itself;
    then `restarts` decides whether it begins again.
    `batches`: takes the values of a generation at once, which changes no candidate and saves most of the calls.
    The option `population` is a number, or the formula of the rule in `population_sizes` that gives one.
    """

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    algorithm: str
    options: Mapping[str, Any]
    build: Build = field(repr=False, compare=False)
    from_start: bool = False
    scaled: bool = False
    stops: bool = False
    batches: bool = False
    stochastic: bool = True
    uses_gradient: bool = False

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"pygmo_{self.algorithm}"

    @property
    def library(self) -> str:
        """Return the package that does the work."""
        return "pygmo"

    @property
    def traits(self) -> Traits:
        """Return the traits; the first sample is one population, of which a rule gives the most."""
        restarts = self.options.get("restarts", False)
        first, per_dimension = (1, int(self.uses_gradient)) if self.from_start else self._most_members()
        return Traits(
            stochastic=self.stochastic or restarts,
            uses_gradient=self.uses_gradient,
            self_terminating=self.stops and not restarts,
            uses_start=self.from_start,
            minimum_budget=first,
            minimum_budget_per_dimension=per_dimension,
            needs_finite_bounds=True,
            batches=self.batches,
            package="pygmo",
        )

    def members(self, dimension: int, budget: int) -> int:
        """Return the size of the population in `dimension` dimensions with `budget` evaluations left."""
        return 1 if self.from_start else members(self.algorithm, self.options["population"], dimension, budget)

    def _most_members(self) -> tuple[int, int]:
        population = self.options["population"]
        return (population, 0) if isinstance(population, int) else RULES[self.algorithm].most

    def compile(self) -> None:
        """Import pygmo, so that no clock sees it."""
        _pygmo()

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Evolve until the objective stops it; what stops by itself begins again, if its options say so."""
        pygmo = _pygmo()

        def evolve(start: Array) -> None:
            size = self.members(objective.dimension, objective.remaining)
            method = self.build(pygmo, objective, size)
            if self.batches:
                method.set_bfe(pygmo.bfe(pygmo.member_bfe()))
            algorithm = pygmo.algorithm(method)
            if algorithm.has_set_seed():
                algorithm.set_seed(int(rng.integers(2**31)))
            fitness = _Fitness(objective, self.scaled, self.uses_gradient)
            try:
                problem, seed = pygmo.problem(fitness), int(rng.integers(2**31))
                if self.from_start:
                    first = pygmo.population(problem, size=0, seed=seed)
                    first.push_back(fitness.inside(start))
                else:
                    first = pygmo.population(problem, size=size, seed=seed)
                algorithm.evolve(first)
            finally:
                caught = fitness.close()
            if caught is not None:  # ipopt swallows what a callback raises
                raise caught

        return with_restarts(evolve, objective, restarts=not self.traits.self_terminating)


class _Fitness:
    """The objective in pygmo's words. pygmo copies its problem; our copy is itself, as the objective's is.

    `caught` is the first exception that came through it, Ctrl-C too, as not every method of pygmo lets it pass.
    """

    def __init__(self, objective: Objective, scaled: bool, has_gradient: bool) -> None:
        self._objective = objective
        self._slope = Memoized(objective, analytic=True, kind="forward") if has_gradient else None
        self._scaled = scaled
        width = objective.upper - objective.lower
        self._width = np.where(width > 0, width, 1.0) if scaled else np.ones(objective.dimension)
        self._origin = objective.lower if scaled else np.zeros(objective.dimension)
        self._size = 0.0
        self.caught: BaseException | None = None

    def close(self) -> BaseException | None:
        """Let all go, as pygmo's objects hold this one unseen by Python; return what was caught."""
        caught = self.caught
        self.__dict__.clear()
        return caught

    def fitness(self, u: Array) -> list[float]:
        return self._ask(self._value, u)

    def batch_fitness(self, flat: Array) -> Array:
        """Return the values of points laid end to end; only where the search is not scaled."""
        return self._ask(self._values, flat)

    def gradient(self, u: Array) -> Array:
        return self._ask(self._gradient, u)

    def _ask(self, function: Callable[[Array], T], u: Array) -> T:
        """Return ``function(u)``, unless something has been raised before."""
        try:
            if self.caught is not None:
                raise self.caught
            return function(u)
        except BaseException as error:
            self.caught = error
            raise

    def _value(self, u: Array) -> list[float]:
        x = self._outside(u)
        value = self._objective(x) if self._slope is None else self._slope.value(x)
        if not self._scaled:
            return [value]
        if not self._size:
            self._size = abs(value) if np.isfinite(value) and value else 1.0
        return [value / self._size]

    def _values(self, flat: Array) -> Array:
        return self._objective.batch(self._outside(flat.reshape(-1, self._objective.dimension)))

    def _gradient(self, u: Array) -> Array:
        assert self._slope is not None
        slope = self._slope.gradient(self._outside(u)) * self._width / (self._size or 1.0)
        return np.nan_to_num(slope, posinf=0.0, neginf=0.0)

    def has_gradient(self) -> bool:
        return self._slope is not None

    def get_bounds(self) -> tuple[Array, Array]:
        return self.inside(self._objective.lower), self.inside(self._objective.upper)

    def inside(self, x: Array) -> Array:
        """Return x in pygmo's coordinates."""
        return (x - self._origin) / self._width if self._scaled else x

    def _outside(self, u: Array) -> Array:
        """Return pygmo's point in ours, never outside the box: some miss it by rounding, ipopt on purpose by 1e-8."""
        x = self._origin + u * self._width if self._scaled else u
        return x.clip(self._objective.lower, self._objective.upper)  # np.clip takes twice as long

    def __copy__(self) -> _Fitness:
        return self

    def __deepcopy__(self, _memo: object) -> _Fitness:
        return self


def evolved(
    algorithm: str,
    population: int | str | None,
    arguments: Mapping[str, Any],
    *,
    least: int,
    fixed: Mapping[str, Any] | None = None,
    batches: bool = False,
    per_generation: Callable[[int], int] = lambda size: size,
    adapt: Callable[[dict[str, Any], int], dict[str, Any]] = lambda options, _size: options,
) -> Pygmo:
    """Return a method that evolves a random population for as long as the budget lasts.

    `population` is a number >= `least`, or the name of the rule of `algorithm`; null is that rule too. `arguments` are
    options of pygmo's constructor, `fixed` those that are not ours to choose, and `adapt` makes what pygmo is given out
    of both once the size is known. `per_generation` is what a generation of a size costs, as some methods plan their
    course by the number of generations.
    """
    population = RULES[algorithm].default if population is None else population
    if isinstance(population, int):
        require(f"pygmo_{algorithm}.population", population, population >= least, f"pygmo asks for {least} or more")

    def build(pygmo: Any, objective: Objective, size: int) -> Any:
        generations = objective.remaining // per_generation(size) + 1
        return getattr(pygmo, algorithm)(gen=generations, **adapt({**arguments, **(fixed or {})}, size))

    return Pygmo(algorithm, {"population": population, **arguments}, build, batches=batches)


def require(option: str, value: Any, holds: bool, rule: str) -> None:
    """Raise `ValueError` with option, value and rule unless the rule `holds`."""
    if not holds:
        raise ValueError(f"{option}={value}: {rule}")


def within(algorithm: str, low: float, high: float, **options: float) -> None:
    """Raise `ValueError` unless each of `options` lies in low .. high."""
    for option, value in options.items():
        require(f"pygmo_{algorithm}.{option}", value, low <= value <= high, f"must lie in {low:g} .. {high:g}")


def _pygmo() -> Any:
    try:
        import pygmo
    except ImportError as error:
        raise ValueError(
            f"pygmo cannot be imported ({error}): its wheels exist for Linux only, here is {sys.platform}; "
            "choose an optimizer that does not begin with pygmo_"
        ) from None
    return pygmo


EXCLUDED = {
    "nlopt": "each of its algorithms stands here under NLopt's own name, nlopt_...",
    "scipy_optimize": "SciPy is called directly here, without a second layer around it",
    "null_algorithm": "it evaluates nothing",
    "cstrs_self_adaptive": "it treats constraints, and a calibration has only its box",
    **dict.fromkeys(
        ("nsga2", "nsga3", "nspso", "moead", "moead_gen", "maco"), "it needs several objectives, and an error is one"
    ),
}
for _name, _reason in EXCLUDED.items():
    registry.exclude(f"pygmo_{_name}", _reason)


@dataclass(frozen=True)
class PopulationRule:
    """constant + floor(per_dimension d + per_root sqrt(d) + per_log ln d), at most B / `generations`, at least `least`.

    `name` is the formula as options and rows show it; `source` is where it is from, `read` where that number has been
    read again (empty: cited as known, the paper was not at hand), `why` tells of a share of the budget. `even`: rounded
    down to an even number.
    """

    method: str
    name: str
    source: str
    why: str = ""
    read: str = ""
    constant: int = 0
    per_dimension: int = 0
    per_root: int = 0
    per_log: int = 0
    generations: int | None = None
    least: int = 5
    even: bool = False

    def size(self, dimension: int, budget: int) -> int:
        """Return the number of members in `dimension` dimensions with `budget` evaluations left."""
        d = dimension
        size = self.constant + floor(self.per_dimension * d + self.per_root * sqrt(d) + self.per_log * log(d))
        if self.generations is not None:
            size = min(size, budget // self.generations)
        size = max(size, self.least)
        return size - size % 2 if self.even else size

    @property
    def default(self) -> int | str:
        """Return what the option `population` is unless it is given: the formula, or the number where it is one."""
        return int(self.name) if self.name.isdigit() else self.name

    @property
    def most(self) -> tuple[int, int]:
        """Return (a, b): in d dimensions there are never more than a + b d members, whatever the budget.

        2 sqrt(d) <= 1 + d, and 3 ln d <= .296 + d, so with whole numbers floor(3 ln d) <= d.
        """
        a, b = self.constant, self.per_dimension
        if self.per_root:
            a, b = a + self.per_root - 1, b + 1 if self.per_root <= 2 else b + self.per_root
        if self.per_log:
            a, b = a + max(0, floor(self.per_log * log(self.per_log) - self.per_log)), b + 1
        return max(a, self.least - b), b


_FEW_GENERATIONS = (
    "the number of the paper is for 1e5 evaluations and more; with fewer, more generations of fewer members reach "
    "further, on our problems and on the other functions alike"
)
_ADAPTIVE = "Brest et al. 2006, IEEE TEC 10(6): NP = 100 for jDE, whose adaptation pygmo's {} takes by default"

RULES: dict[str, PopulationRule] = {
    rule.method: rule
    for rule in (
        PopulationRule(
            "de", "min(10d,B/500)", "Storn, Price 1997, J. Global Optim. 11: NP of 5 d to 10 d; here 10 d",
            _FEW_GENERATIONS, per_dimension=10, generations=500, least=10,
        ),
        PopulationRule(
            "sade", "min(100,B/500)", _ADAPTIVE.format("sade"), _FEW_GENERATIONS,
            constant=100, generations=500, least=10,
        ),
        PopulationRule(
            "de1220", "min(100,B/500)", _ADAPTIVE.format("de1220"), _FEW_GENERATIONS,
            constant=100, generations=500, least=10,
        ),
        PopulationRule(
            "cmaes", "4+3ln(d)", "Hansen 2016, arXiv:1604.00772, table 1: lambda = 4 + floor(3 ln d); pygmo needs 5",
            read="DEAP's and libcmaes's defaults", constant=4, per_log=3,
        ),
        PopulationRule(
            "xnes", "4+3ln(d)", "Glasmachers et al. 2010, GECCO, table 1: lambda = 4 + floor(3 ln d); pygmo needs 4",
            constant=4, per_log=3, least=4,
        ),
        PopulationRule(
            "pso", "10+2sqrt(d)", "Clerc, Standard PSO 2006 and 2007: S = 10 + floor(2 sqrt d)",
            read="CRAN's pso, type SPSO2007", constant=10, per_root=2,
        ),
        PopulationRule(
            "pso_gen", "10+2sqrt(d)", "Clerc, Standard PSO 2006 and 2007: S = 10 + floor(2 sqrt d)",
            read="CRAN's pso, type SPSO2007", constant=10, per_root=2,
        ),
        PopulationRule(
            "sga", "min(200,B/25)", "MATLAB's ga: 200 members above five variables (De Jong 1975: 50 to 100)",
            "a thousand evaluations would be five generations of 200. MATLAB's 50 up to five variables is not taken: "
            "on sensor_zero, of three, 150 came lower than 40 and 80", read="MathWorks' answers: PopulationSize of ga",
            constant=200, generations=25, least=10, even=True,
        ),
        PopulationRule(
            "bee_colony", "62", "Karaboga, Basturk 2007, J. Global Optim. 39, as in their code: a colony of 125, half "
            "of it food sources, which are pygmo's members", read="their MATLAB code: NP = 125, and 20", constant=62,
        ),
        PopulationRule(
            "gaco", "min(50,B/250)", "Socha, Dorigo 2008, EJOR 185: an archive of 50; pygmo's archive (its kernel, at "
            "most 63) is at most its population", "pygmo samples a whole population a generation, the paper two ants",
            constant=50, generations=250, least=20,
        ),
        PopulationRule(
            "gwo", "30", "Mirjalili et al. 2014, Adv. Eng. Software 69: 30 search agents",
            read="their MATLAB code", constant=30,
        ),
        PopulationRule(
            "ihs", "5", "Omran, Mahdavi 2008, Appl. Math. Comput. 198: a harmony memory of 5, for improved harmony "
            "search too", constant=5, least=1,
        ),
    )
}  # fmt: skip


def members(method: str, population: int | str | None, dimension: int, budget: int) -> int:
    """Return `population` if it is a number, else what the rule of `method` gives."""
    return population if isinstance(population, int) else RULES[method].size(dimension, budget)
