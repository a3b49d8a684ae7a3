"""pygmo's algorithms, each under its own name: ``pygmo_de`` is pygmo's de.

Defaults are pygmo's, but for the population, which `RULES` gives from the dimension d and the budget B
(docs/optimizers.md). pygmo owns the loop: every member passes our objective. What stops all the same begins again.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, make_dataclass
from functools import partial, wraps
from math import floor, log, sqrt
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import (
    Array,
    Count,
    CountOrNull,
    Objective,
    Positive,
    Reason,
    Share,
    Traits,
    registry,
    with_restarts,
)
from calibench.optimizers.derivatives import Memoized


@final
@dataclass(frozen=True)
class Pygmo:
    """One pygmo algorithm with its options; `population` is a number, or the formula of the rule that gives one."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    algorithm: str
    options: Mapping[str, Any]
    library: ClassVar[str] = "pygmo"

    def __post_init__(self) -> None:
        population = self.options.get("population")
        members = population if isinstance(population, int) else RULES[self.algorithm].least if population else 1
        known = {**self.options, "members": members}
        for option, holds, rule in _CONDITIONS.get(self.algorithm, ()):
            if not holds(known):
                value = self.options[option]
                shown = list(value) if isinstance(value, tuple) else value
                raise ValueError(f"{self.name}.{option}={shown}: {rule.format(**known)}")

    @property
    def name(self) -> str:
        return f"pygmo_{self.algorithm}"

    @property
    def traits(self) -> Traits:
        """Return the traits; the first sample is one population, of which a rule gives the most."""
        known, restarts = METHODS[self.algorithm], self.options.get("restarts", False)
        population = self.options.get("population", 1)
        first, per_dimension = (population, 0) if isinstance(population, int) else RULES[self.algorithm].most
        return Traits(
            stochastic=known.stochastic or restarts, uses_gradient=self._uses_gradient,
            self_terminating=known.stops and not restarts, uses_start=known.from_start, minimum_budget=first,
            minimum_budget_per_dimension=per_dimension + self._uses_gradient, needs_finite_bounds=True,
            batches=known.batches, package="pygmo",
        )  # fmt: skip

    @property
    def _uses_gradient(self) -> bool:
        return "ipopt" in (self.algorithm, self.options.get("inner"))

    def members(self, dimension: int, budget: int) -> int:
        """Return the size of the population in `dimension` dimensions with `budget` evaluations left."""
        population = self.options.get("population", 1)
        return population if isinstance(population, int) else RULES[self.algorithm].size(dimension, budget)

    def compile(self) -> None:
        """Import pygmo, so that no clock sees it; raise `ValueError` where it is not there."""
        try:
            import pygmo  # noqa: F401
        except ImportError as error:
            raise ValueError(
                f"pygmo cannot be imported ({error}): its wheels exist for Linux only, here is {sys.platform}; "
                "choose an optimizer that does not begin with pygmo_"
            ) from None

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Evolve until the objective stops it; what stops by itself begins again, if its options say so."""
        self.compile()
        import pygmo

        known = METHODS[self.algorithm]
        scaled = self._uses_gradient or self.algorithm == "simulated_annealing"

        def evolve(start: Array) -> None:
            size = self.members(objective.dimension, objective.remaining)
            method = self._method(pygmo, objective, size)
            if known.batches:
                method.set_bfe(pygmo.bfe(pygmo.member_bfe()))
            algorithm = pygmo.algorithm(method)
            if algorithm.has_set_seed():
                algorithm.set_seed(int(rng.integers(2**31)))
            fitness = _Fitness(objective, scaled, self._uses_gradient)
            try:
                problem, seed = pygmo.problem(fitness), int(rng.integers(2**31))
                first = pygmo.population(problem, size=0 if known.from_start else size, seed=seed)
                if known.from_start:
                    first.push_back(fitness.inside(start))
                algorithm.evolve(first)
            finally:
                caught = fitness.caught
                fitness.__dict__.clear()  # pygmo's objects hold it unseen by Python
            if caught is not None:  # ipopt swallows what a callback raises
                raise caught

        return with_restarts(evolve, objective, restarts=not self.traits.self_terminating)

    def _method(self, pygmo: Any, objective: Objective, size: int) -> Any:
        """Return pygmo's own object for what is left to spend, with `size` members."""
        beyond, known = objective.remaining + 1, METHODS[self.algorithm]
        options = {key: value for key, value in self.options.items() if key not in ("population", "restarts")}
        if self.algorithm == "ipopt":
            return _ipopt(pygmo, objective, options["tolerance"], options["memory"])
        if self.algorithm == "compass_search":
            return pygmo.compass_search(max_fevals=beyond, **options)
        if self.algorithm == "mbh":
            end = options["inner_tolerance"]
            if options["inner"] == "ipopt":
                local = _ipopt(pygmo, objective, end)
            else:
                local = pygmo.compass_search(max_fevals=beyond, start_range=0.1, stop_range=end, reduction_coeff=0.5)
            return pygmo.mbh(algo=pygmo.algorithm(local), stop=beyond, perturb=options["perturb"])
        if self.algorithm == "simulated_annealing":
            each = options["n_range_adj"] * options["bin_size"] * objective.dimension
            options["n_T_adj"] = options["n_T_adj"] or max(1, objective.remaining // each)
            return pygmo.simulated_annealing(**options)
        if self.algorithm == "gaco" and options["ker"] is None:
            options["ker"] = min(63, size)
        if self.algorithm == "xnes":
            options["sigma0"] = options["sigma0"] or -1.0  # leaves it to pygmo
        if "allowed_variants" in options:
            options["allowed_variants"] = list(options["allowed_variants"])
        # some plan their course by the number of generations
        cost = {"bee_colony": 2 * size, "ihs": 1, "sea": 1}.get(self.algorithm, size)
        return getattr(pygmo, self.algorithm)(gen=objective.remaining // cost + 1, **options, **known.fixed)


def _keeping(call: Callable[[_Fitness, Array], Any]) -> Callable[[_Fitness, Array], Any]:
    """Let `call` keep what it raises as `caught`, and raise that again where it is called once more."""

    @wraps(call)
    def asked(self: _Fitness, u: Array) -> Any:
        try:
            if self.caught is not None:
                raise self.caught
            return call(self, u)
        except BaseException as error:
            self.caught = error
            raise

    return asked


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

    @_keeping
    def fitness(self, u: Array) -> list[float]:
        x = self._outside(u)
        value = self._objective(x) if self._slope is None else self._slope.value(x)
        if not self._scaled:
            return [value]
        if not self._size:
            self._size = abs(value) if np.isfinite(value) and value else 1.0
        return [value / self._size]

    @_keeping
    def batch_fitness(self, flat: Array) -> Array:
        """Return the values of points laid end to end; only where the search is not scaled."""
        return self._objective.batch(self._outside(flat.reshape(-1, self._objective.dimension)))

    @_keeping
    def gradient(self, u: Array) -> Array:
        assert self._slope is not None
        slope = self._slope.gradient(self._outside(u)) * self._width / (self._size or 1.0)
        return np.nan_to_num(slope, posinf=0.0, neginf=0.0)

    def has_gradient(self) -> bool:
        return self._slope is not None

    def get_bounds(self) -> tuple[Array, Array]:
        return self.inside(self._objective.lower), self.inside(self._objective.upper)

    def inside(self, x: Array) -> Array:
        return (x - self._origin) / self._width if self._scaled else x

    def _outside(self, u: Array) -> Array:
        """Return pygmo's point in ours, never outside the box: some miss it by rounding, ipopt on purpose by 1e-8."""
        x = self._origin + u * self._width if self._scaled else u
        return x.clip(self._objective.lower, self._objective.upper)  # np.clip takes twice as long

    def __deepcopy__(self, _memo: object) -> _Fitness:
        return self


def _ipopt(pygmo: Any, objective: Objective, tolerance: float, memory: int | None = None) -> Any:
    ipopt = pygmo.ipopt()
    ipopt.set_string_option("sb", "yes")  # no banner
    for name, count in (
        ("print_level", 0), ("max_iter", objective.remaining + 1), ("acceptable_iter", 0),  # no second, looser test
        ("limited_memory_max_history", memory or max(6, objective.dimension)),
    ):  # fmt: skip
        ipopt.set_integer_option(name, count)
    for name in ("tol", "dual_inf_tol", "compl_inf_tol"):
        ipopt.set_numeric_option(name, tolerance)
    ipopt.set_numeric_option("bound_relax_factor", 0.0)
    return ipopt


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


@dataclass(frozen=True, slots=True)
class PopulationRule:
    """How many members a method has, ``size(d, B)`` for d dimensions and B evaluations left.

    `name` is the formula as options and rows show it; never are there fewer than `least`, nor more than a + b d with
    (a, b) = `most`. docs/optimizers.md has its source.
    """

    name: str
    size: Callable[[int, int], int]
    most: tuple[int, int]
    least: int

    @property
    def default(self) -> int | str:
        """Return what the option `population` is unless it is given: the formula, or the number where it is one."""
        return int(self.name) if self.name.isdigit() else self.name


def _number(size: int) -> PopulationRule:
    return PopulationRule(str(size), lambda d, B: size, most=(size, 0), least=size)


_adaptive = PopulationRule("min(100,B/500)", lambda d, B: max(10, min(100, B // 500)), most=(100, 0), least=10)
_swarm = PopulationRule("10+2sqrt(d)", lambda d, B: 10 + floor(2 * sqrt(d)), most=(11, 1), least=12)
RULES: dict[str, PopulationRule] = {
    "de": PopulationRule("min(10d,B/500)", lambda d, B: max(10, min(10 * d, B // 500)), most=(0, 10), least=10),
    "sade": _adaptive,
    "de1220": _adaptive,
    "cmaes": PopulationRule("4+3ln(d)", lambda d, B: max(5, 4 + floor(3 * log(d))), most=(4, 1), least=5),
    "xnes": PopulationRule("4+3ln(d)", lambda d, B: 4 + floor(3 * log(d)), most=(4, 1), least=4),
    "pso": _swarm,
    "pso_gen": _swarm,
    "sga": PopulationRule("min(200,B/25)", lambda d, B: max(10, min(200, B // 25)) // 2 * 2, most=(200, 0), least=10),
    "bee_colony": _number(62),
    "gaco": PopulationRule("min(50,B/250)", lambda d, B: max(20, min(50, B // 250)), most=(50, 0), least=20),
    "gwo": _number(30),
    "ihs": _number(5),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One method: its `options` (name, type, default), and `fixed`, those of pygmo's that are not ours to choose.

    `from_start`: one member at the start, instead of a random population; the trait `uses_start` is just this. `stops`:
    may end by itself; then `restarts` decides whether it begins again. `batches`: takes the values of a generation at
    once, which changes no candidate and saves most of the calls.
    """

    about: str
    options: tuple[tuple[str, Any, Any], ...] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)
    from_start: bool = False
    stops: bool = False
    batches: bool = False
    stochastic: bool = True


def _members(method: str, least: int) -> tuple[str, Any, Any]:
    """Return the option `population`: a number, or the rule of `method`, which null is too."""
    default = RULES[method].default
    kind = int | None if isinstance(default, int) else int | Literal[default] | None
    return "population", Annotated[kind, Range(least)], default


_NEVER: dict[str, Any] = {"ftol": 0.0, "xtol": 0.0}
_IN_THE_BOX = {**_NEVER, "force_bounds": True}
_Part = Annotated[float, Range(1e-300, 1)]
_AtLeast0 = Annotated[float, Range(0)]
_TwoWays, _OfTen, _OfEighteen = (Annotated[int, Range(1, most)] for most in (2, 10, 18))
_Pull = Annotated[float, Range(0, 4)]
_SWARM = (
    ("omega", Share, 0.7298), ("eta1", _Pull, 2.05), ("eta2", _Pull, 2.05), ("max_vel", _Part, 0.5),
    ("variant", Annotated[int, Range(1, 6)], 5), ("neighb_type", Annotated[int, Range(1, 4)], 2),
    ("neighb_param", Count, 4),
)  # fmt: skip
_RESTARTS = ("restarts", bool, False)
_CROSSOVER = Literal["exponential", "binomial", "single", "sbx"]
_MUTATION, _SELECTION = Literal["gaussian", "polynomial", "uniform"], Literal["tournament", "truncated"]
METHODS: dict[str, Method] = {
    "de": Method(
        about="Differential evolution; `variant` 1-10 as pygmo numbers them (2 is rand/1/exp).",
        options=(_members("de", 5), ("F", Share, 0.8), ("CR", Share, 0.9), ("variant", _OfTen, 2)), fixed=_NEVER,
    ),
    "sade": Method(
        about="Self-adaptive differential evolution; `variant` 1-18, `variant_adptv` 1 (jDE) or 2 (iDE).",
        options=(_members("sade", 7), ("variant", _OfEighteen, 2), ("variant_adptv", _TwoWays, 1)), fixed=_NEVER,
    ),
    "de1220": Method(
        about="Differential evolution that adapts its variant too, out of `allowed_variants` (each 1-18).",
        options=(
            _members("de1220", 7), ("allowed_variants", tuple[int, ...], (2, 3, 7, 10, 13, 14, 15, 16)),
            ("variant_adptv", _TwoWays, 1),
        ),
        fixed=_NEVER,
    ),
    "pso": Method(
        about="Particle swarm; `variant` 1-6 (5: constriction), `neighb_type` 1-4 (2: ring of `neighb_param`).",
        options=(_members("pso", 2), *_SWARM),
    ),
    "pso_gen": Method(
        about="Particle swarm whose particles move all at once, a generation at a time; options as pygmo_pso.",
        options=(_members("pso_gen", 2), *_SWARM), batches=True,
    ),
    "sga": Method(
        about="Simple genetic algorithm; probabilities `cr`, `m`, and the parameters of its three operators.",
        options=(
            _members("sga", 2), ("cr", Share, 0.9), ("eta_c", Annotated[float, Range(1, 100)], 1.0), ("m", Share, 0.02),
            ("param_m", float, 1.0),
            ("param_s", int, 2), ("crossover", _CROSSOVER, "exponential"), ("mutation", _MUTATION, "polynomial"),
            ("selection", _SELECTION, "tournament"),
        ),
    ),
    "bee_colony": Method(
        about="Artificial bee colony; a source that did not improve `limit` times is left.\n\nA generation costs two"
        " populations.",
        options=(_members("bee_colony", 2), ("limit", Count, 20)),
    ),
    "gaco": Method(
        about="Extended ant colony; `ker` solutions are remembered, `q` weighs the better ones, `focus` narrows the"
        " search.\n\n`ker` null: pygmo's 63, or the whole population where it is smaller.\n\n`acc` is the least"
        " distance between what is remembered. pygmo's two stops by count are switched off.",
        options=(
            _members("gaco", 2), ("ker", int | None, None), ("q", _AtLeast0, 1.0), ("acc", _AtLeast0, 0.01),
            ("focus", _AtLeast0, 0.0),
        ),
        fixed={"impstop": 2**31 - 1, "evalstop": 2**31 - 1}, batches=True,
    ),
    "gwo": Method(
        about="Grey wolf optimiser: it narrows over the generations, of which it is given as many as the budget holds.",
        options=(_members("gwo", 3),),
    ),
    "cmaes": Method(
        about="Covariance matrix adaptation; `sigma0` is the first step size in shares of the box.",
        options=(_members("cmaes", 5), ("sigma0", Positive, 0.5)), fixed=_IN_THE_BOX, batches=True,
    ),
    "xnes": Method(
        about="Exponential natural evolution strategy; `sigma0` is the first step size, null leaves it to pygmo.",
        fixed=_IN_THE_BOX,
        options=(_members("xnes", 4), ("sigma0", Annotated[float | None, Range(0, 1, above=True)], None)),
    ),
    "ihs": Method(
        about="Improved harmony search: one new harmony an iteration; `ppar` rises and `bw` falls over the budget.",
        options=(
            _members("ihs", 1), ("phmcr", Share, 0.85), ("ppar_min", Share, 0.35), ("ppar_max", Share, 0.99),
            ("bw_min", float, 1e-5), ("bw_max", float, 1.0),
        ),
    ),
    "compass_search": Method(
        about="Compass search: steps along the axes, in shares of the box, which shrink from `start_range` to"
        " `stop_range`.",
        options=(
            ("start_range", _Part, 0.1), ("stop_range", float, 1e-16),
            ("reduction_coeff", Annotated[float, Range(1e-3, 1 - 1e-3)], 0.5), _RESTARTS,
        ),
        from_start=True, stops=True, stochastic=False,
    ),
    "simulated_annealing": Method(
        about="Corana's annealing from temperature `Ts` to `Tf`, in units of the value at the start.\n\n`n_T_adj`"
        " temperatures; null: as many as the budget holds. When the schedule is over it begins again at random.",
        options=(
            ("Ts", float, 0.1), ("Tf", float, 1e-8), ("n_T_adj", CountOrNull, None), ("n_range_adj", Count, 1),
            ("bin_size", Count, 20), ("start_range", _Part, 1.0),
        ),
        from_start=True,
    ),
    "sea": Method(
        about="(1+1) evolution strategy: some coordinates drawn anew in the box, kept if better.", from_start=True,
    ),
    "ipopt": Method(
        about="Ipopt: interior point with limited-memory curvature (Waechter, Biegler 2006); `tolerance` of"
        " optimality.\n\n`memory`: steps that the curvature remembers; null: the dimension, and at least Ipopt's own 6."
        " With fewer steps than dimensions it crawls where the condition is high. The value is divided by its first"
        " size, so that the tolerance is relative: 1e-15 is the goal of a calibration, and below it a descent ends by"
        " Ipopt's own smallest step.",
        options=(("tolerance", _Part, 1e-15), ("memory", CountOrNull, None), _RESTARTS),
        from_start=True, stops=True, stochastic=False,
    ),
    "mbh": Method(
        about="Monotonic basin hopping: `inner` from the best point, moved at random by up to `perturb` of the box, for"
        " ever.\n\n`inner_tolerance` ends a descent: the stop range of compass search, the tolerance of Ipopt.",
        options=(
            ("inner", Literal["compass_search", "ipopt"], "compass_search"), ("perturb", _Part, 0.01),
            ("inner_tolerance", Annotated[float, Range(1e-300, 0.1)], 1e-8),
        ),
        from_start=True,
    ),
}  # fmt: skip

Condition = tuple[str, Callable[[dict[str, Any]], Any], str]  # an option, whether it is right, the rule
_CONDITIONS: dict[str, tuple[Condition, ...]] = {
    "de1220": ((
        "allowed_variants", lambda o: o["allowed_variants"] and all(1 <= each <= 18 for each in o["allowed_variants"]),
        "one or more whole numbers in 1 .. 18 are needed",
    ),),
    "sga": (
        ("param_m", lambda o: o["mutation"] != "polynomial" or 1 <= o["param_m"] <= 100, "must lie in 1 .. 100"),
        ("param_m", lambda o: o["mutation"] == "polynomial" or 0 <= o["param_m"] <= 1, "must lie in 0 .. 1"),
        ("population", lambda o: o["crossover"] != "sbx" or o["members"] % 2 == 0,
         "sbx mates pairs: an even number is needed"),
        ("param_s", lambda o: 1 <= o["param_s"] <= o["members"], "must lie in 1 .. {members:g}"),
    ),
    "gaco": (("ker", lambda o: o["ker"] is None or 2 <= o["ker"] <= o["members"], "must lie in 2 .. {members:g}"),),
    "ihs": (
        ("ppar_min", lambda o: o["ppar_min"] < o["ppar_max"], "must be below ppar_max={ppar_max:g}"),
        ("bw_min", lambda o: 0 < o["bw_min"] < o["bw_max"], "must be above 0 and below bw_max={bw_max:g}"),
    ),
    "compass_search": ((
        "stop_range", lambda o: 1e-300 <= o["stop_range"] <= o["start_range"], "must lie in 1e-300 .. {start_range:g}",
    ),),
    "simulated_annealing": (("Tf", lambda o: 0 < o["Tf"] < o["Ts"], "must be above 0 and below Ts={Ts:g}"),),
}  # fmt: skip


def _build(algorithm: str, **chosen: Any) -> Pygmo:
    options = {name: default for name, _, default in METHODS[algorithm].options} | chosen
    if "population" in options and options["population"] is None:
        options["population"] = RULES[algorithm].default
    return Pygmo(algorithm, options)


for _name, _known in METHODS.items():
    _entry = partial(_build, _name)
    _entry.__doc__ = _known.about
    registry.register(f"pygmo_{_name}", options=make_dataclass(_name, _known.options))(_entry)
