"""NLopt's algorithms, each under its own name: ``nlopt_LN_BOBYQA`` is NLopt's LN_BOBYQA.

`_table` has the traits of each, `settings` the parameters of each and the reasons, `adapter` runs one, `algorithms`
registers them with the options of their family.

NLopt's algorithms in the registry, each with the options of its family and the traits of the table.

Methods inside another (`local`) are those that never failed at the rounding floor: a failure there would end the method
around them too.

Run one NLopt algorithm through the gate: scaling, tolerances, restarts.

The search runs in the unit box and on the value divided by its first size, as J in mm^4 with rad and mm side by side
breaks most of them by scale alone. Nothing may be raised inside NLopt's callback (some algorithms hang, others change
the exception): it is kept, NLopt is asked to stop, and it is raised again outside.

The settings of each NLopt algorithm, with reasons: scaling, tolerances, memory, population.

Every algorithm searches the unit box: rad and mm side by side become shares of their own range. What differs is what
the value's size, a tolerance or a store changes. docs/optimizers.md shows the table; the tests hold its claims.

The traits of NLopt's algorithms, measured with NLopt 2.11, tolerances off, on nine test functions.

The table is static, so that listing needs no NLopt. `stops`: was seen to end by itself before its evaluations were
spent (converged, or failed at the rounding floor). `uses_start`: proposes other points from another start. `first` and
`first_per_dimension`: evaluations of its first sample or model, which it chooses before it has learnt anything.
`maximum_dimension` is measured (``python -m benchmarks.dimensions``): beyond it the DIRECT of Gablonsky writes outside
its arrays, and the population of ISRES takes more than a gigabyte.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.optimizers.base import Array, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import value_and_gradient

_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN


def _nothing(_point: Array, _gradient: Array) -> float:
    """Be the objective of a search that is over."""
    return 0.0


@final
@dataclass(frozen=True)
class NLopt:
    """One NLopt algorithm, its tolerances off, with the options of its family."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    algorithm: str
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        for option, least in (("population", 1), ("storage", 1)):
            value = self.options.get(option)
            if value is not None and value < least:
                raise ValueError(f"{self.name}.{option}={value}: must be {least} or more, or null for NLopt's own")
        step = self.options.get("initial_step")
        if step is not None and not 0 < step <= 1:
            raise ValueError(f"{self.name}.initial_step={step:g}: must lie in 0 .. 1 (widths of the box), above 0")
        tolerance = self.options.get("local_tolerance")
        if tolerance is not None and not 0 < tolerance < 1:
            raise ValueError(f"{self.name}.local_tolerance={tolerance:g}: must lie between 0 and 1")

    @property
    def name(self) -> str:
        """Return the name in the registry."""
        return f"nlopt_{self.algorithm}"

    @property
    def library(self) -> str:
        """Return the package that does the work."""
        return "nlopt"

    @property
    def traits(self) -> Traits:
        """Return the traits that the table holds; with `restarts` it goes on, at random, until it is stopped."""
        known, restarts = ALGORITHMS[self.algorithm], self.options.get("restarts", False)
        local = self.options.get("local", self.algorithm)
        population = self.options.get("population")
        return Traits(
            stochastic=known.stochastic or restarts,
            uses_gradient=local[1] == "D",
            bounded=known.bounded,
            self_terminating=known.stops and not restarts,
            uses_start=known.uses_start,
            minimum_budget=known.first if population is None else population,
            minimum_budget_per_dimension=known.first_per_dimension if population is None else 0,
            minimum_dimension=known.minimum_dimension,
            maximum_dimension=known.maximum_dimension,
            needs_finite_bounds=True,
            may_hang=known.may_hang,
        )

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, or where it ends against its habit, again from random points."""
        import nlopt

        nlopt.srand(int(rng.integers(1, 2**31)))
        again = not self.traits.self_terminating
        return with_restarts(lambda start: self._descend(objective, start), objective, again)

    def _descend(self, objective: Objective, start: Array) -> None:
        import nlopt

        lower, width = objective.lower, objective.upper - objective.lower
        width = np.where(width > 0, width, 1.0)
        clipped = ALGORITHMS[self.algorithm].bounded  # what keeps to its box may miss it by rounding
        search = self._search(objective)
        caught: list[BaseException | None] = []  # why it was asked to stop; None: it lost its way
        size: list[float] = []

        def stop(gradient: Array, reason: BaseException | None) -> float:
            caught.append(reason)
            if size:  # GN_ORIG_DIRECT crashes where it is stopped by its first value: the next call stops it
                search.force_stop()
            gradient[:] = 0.0
            return _LARGEST

        def function(u: Array, gradient: Array) -> float:
            try:
                if caught:  # some go on calling after they were asked to stop
                    search.force_stop()
                    gradient[:] = 0.0
                    return _LARGEST
                norm = u.dot(u)
                if norm != norm:  # COBYLA at the rounding floor asks for NaN: there is nothing to evaluate
                    return stop(gradient, None)
                x = lower + u * width
                x = x.clip(objective.lower, objective.upper) if clipped else x  # np.clip takes twice as long
                if gradient.size:
                    value, slope = value_and_gradient(objective, x)
                else:
                    value = objective(x)
                if not size:
                    scaled = self.options["scale_value"] and np.isfinite(value) and value
                    size.append(abs(value) if scaled else 1.0)
                if gradient.size:
                    gradient[:] = np.nan_to_num(slope * width / size[0], posinf=0.0, neginf=0.0)
                return min(value / size[0], _LARGEST)
            except BaseException as error:  # anything, Ctrl-C too: raised again below, outside NLopt
                return stop(gradient, error)

        search.set_min_objective(function)
        try:
            search.optimize(np.clip((start - lower) / width, 0.0, 1.0))
        except (nlopt.ForcedStop, nlopt.RoundoffLimited, RuntimeError, getattr(nlopt, "runtime_error", RuntimeError)):
            pass  # told apart by what was caught; a bare failure at the rounding floor is the end of a descent
        except getattr(nlopt, "invalid_argument", ValueError) as error:
            raise ValueError(
                f"{self.name}: NLopt refuses {self.options} in {objective.dimension} dimensions"
            ) from error
        finally:
            search.set_min_objective(
                _nothing
            )  # each holds the other, which Python cannot see: they would stay for ever
        if caught and caught[0] is not None:
            raise caught[0]

    def _search(self, objective: Objective) -> Any:
        """Return NLopt's own object in the unit box, with the options of this algorithm."""
        import nlopt

        search = nlopt.opt(getattr(nlopt, self.algorithm), objective.dimension)
        search.set_lower_bounds(np.zeros(objective.dimension))
        search.set_upper_bounds(np.where(objective.upper > objective.lower, 1.0, 0.0))
        search.set_maxeval(objective.remaining + 1)  # the wall is the objective's; this one ends what ignores a stop
        setting = SETTING_OF[self.algorithm]
        for name, value in setting.parameters.items():
            search.set_param(name, value)
        if setting.step_ends == "always" or (setting.step_ends == "restarted" and self.options.get("restarts")):
            search.set_xtol_rel(ROUNDING)
        if self.options.get("initial_step") is not None:
            search.set_initial_step(self.options["initial_step"])
        if self.options.get("population") is not None:
            search.set_population(self.options["population"])
        if self.options.get("storage") is not None:
            search.set_vector_storage(self.options["storage"])
        if "local" in self.options:
            local = nlopt.opt(getattr(nlopt, self.options["local"]), objective.dimension)
            local.set_ftol_rel(self.options["local_tolerance"])
            local.set_xtol_rel(self.options["local_tolerance"])
            search.set_local_optimizer(local)
        return search


ROUNDING = 1e-15
NO_GRADIENT_TEST = 1e-30  # 0 would mean NLopt's own 1e-8


@dataclass(frozen=True, slots=True)
class Setting:
    """How `algorithms` are set, and `why`.

    `size_matters`: the candidates depend on the size of the value, so that the division by its first size is needed;
    where not, it changes no candidate. `parameters` go to NLopt's `set_param`. `step_ends`: when a step below 1e-15
    of the point ends a descent: never, with restarts, or always. `memory`, `population`: in words.
    """

    algorithms: tuple[str, ...]
    why: str
    size_matters: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    step_ends: Literal["never", "restarted", "always"] = "never"
    inner_tolerance: float | None = None
    memory: str = "none to choose"
    population: str = "none"

    @property
    def tolerances(self) -> str:
        """Return the tests that may end a search, in words."""
        tests = [f"`{name}` = {value:g}" for name, value in self.parameters.items()]
        if self.inner_tolerance is not None:
            tests.append(f"`local_tolerance` = {self.inner_tolerance:g} (ftol_rel and xtol_rel of the inner method)")
        if self.step_ends != "never":
            only = " with restarts" if self.step_ends == "restarted" else ""
            tests.append(f"`xtol_rel` = {ROUNDING:g}{only}")
        return ", ".join(tests) if tests else "none"


_RESTARTED = "With `restarts` a step at rounding ends a descent, as some never end by themselves."

SETTINGS = (
    Setting(
        ("GN_DIRECT", "GN_DIRECT_L", "GN_DIRECT_L_RAND", "GN_DIRECT_NOSCAL", "GN_DIRECT_L_NOSCAL",
         "GN_DIRECT_L_RAND_NOSCAL", "GN_ORIG_DIRECT_L"),
        "Rectangles are compared by value and size: a factor on the value changes nothing.",
    ),
    Setting(
        ("GN_ORIG_DIRECT",),
        "Gablonsky's code without the local bias chooses other rectangles when the value is multiplied.",
        size_matters=True,
    ),
    Setting(
        ("GN_CRS2_LM",), "Values are only compared. The population is that of Kaelo and Ali.",
        population="10 (dim + 1)",
    ),
    Setting(
        ("GN_ISRES",), "Values are only compared. The population is NLopt's: it follows the dimension, where Runarsson"
        " and Yao took 200 for all.", population="20 (dim + 1)",
    ),
    Setting(
        ("GN_ESCH",), "Values are only compared. The population is its authors'.", population="40, and 60 children",
    ),
    Setting(("GN_AGS",), "It divides by its own estimate of the slope: a factor on the value changes nothing."),
    Setting(
        ("GD_STOGO", "GD_STOGO_RAND"),
        "Its local search proposes other points when the value is multiplied.",
        size_matters=True,
    ),
    Setting(
        ("GD_MLSL", "GD_MLSL_LDS", "G_MLSL", "G_MLSL_LDS"),
        "A descent that ends at 1e-8 ends above our goals, and the next begins elsewhere: at 1e-15 each goes on to"
        " rounding. The inner method is SLSQP, which needs a value near 1.",
        size_matters=True, inner_tolerance=ROUNDING, population="4 new points a round",
    ),
    Setting(
        ("GN_MLSL", "GN_MLSL_LDS"),
        "As above; the inner method is BOBYQA, whose candidates no factor on the value changes.",
        inner_tolerance=ROUNDING, population="4 new points a round",
    ),
    Setting(
        ("LN_COBYLA", "LN_BOBYQA", "LN_NEWUOA", "LN_NELDERMEAD", "LN_SBPLX"),
        f"Models and simplices scale with the value: a factor on it changes nothing. {_RESTARTED}",
        step_ends="restarted",
    ),
    Setting(
        ("LN_NEWUOA_BOUND",),
        "Its models are minimised by an NLopt method inside, to which the size of the value matters, and which never"
        " ends without a tolerance.",
        size_matters=True, step_ends="always",
    ),
    Setting(
        ("LN_PRAXIS",), f"Its steps change where the value is far below 1. {_RESTARTED}",
        size_matters=True, step_ends="restarted",
    ),
    Setting(
        ("LD_SLSQP",),
        f"Undivided, a value of 1e9 ends it after one evaluation. {_RESTARTED}",
        size_matters=True, step_ends="restarted", memory="the whole Hessian, dim x dim",
    ),
    Setting(
        ("LD_LBFGS", "LD_VAR1", "LD_VAR2", "LD_TNEWTON", "LD_TNEWTON_RESTART", "LD_TNEWTON_PRECOND",
         "LD_TNEWTON_PRECOND_RESTART"),
        "Luksan's codes end where no slope is above `tolg`, an absolute 1e-8: after the division that is far above"
        " rounding, so it is switched off. Undivided, large values bring bad first steps. `storage` null: NLopt keeps"
        f" as many gradients as fit 10 MB or the budget, so none is forgotten. {_RESTARTED}",
        size_matters=True, parameters={"tolg": NO_GRADIENT_TEST}, step_ends="restarted",
        memory="all gradients; `storage` sets fewer",
    ),
    Setting(
        ("LD_MMA", "LD_CCSAQ"),
        "Their first penalty is 1, a size of the value. They end by no test of their own; with `restarts` a step at"
        " rounding ends a descent.",
        size_matters=True, step_ends="restarted",
    ),
    Setting(
        ("AUGLAG", "AUGLAG_EQ", "LD_AUGLAG", "LD_AUGLAG_EQ"),
        f"Without constraints each is its inner method, SLSQP, run to rounding. {_RESTARTED}",
        size_matters=True, inner_tolerance=ROUNDING, step_ends="restarted", memory="the inner method's",
    ),
    Setting(
        ("LN_AUGLAG", "LN_AUGLAG_EQ"),
        f"Without constraints each is its inner method, BOBYQA, run to rounding. {_RESTARTED}",
        inner_tolerance=ROUNDING, step_ends="restarted",
    ),
)  # fmt: skip

SETTING_OF: dict[str, Setting] = {algorithm: setting for setting in SETTINGS for algorithm in setting.algorithms}


Family = Literal[
    "global", "population", "derivative_free", "gradient", "limited_memory", "endless_gradient",
    "mlsl_free", "mlsl_gradient", "mlsl_any", "auglag_free", "auglag_gradient", "auglag_any",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Algorithm:
    """One line of the table; `family` says which options it has."""

    family: Family
    about: str
    stochastic: bool = False
    stops: bool = False
    bounded: bool = True
    may_hang: bool = False
    uses_start: bool = True
    first: int = 1
    first_per_dimension: int = 0
    minimum_dimension: int = 1
    maximum_dimension: int | None = None


def _direct(about: str, stochastic: bool = False, most: int | None = None) -> Algorithm:
    source = "(Jones, Perttunen, Stuckman 1993); ignores the start."
    return Algorithm("global", f"{about} {source}", stochastic, uses_start=False, maximum_dimension=most)


def _free(about: str, first_per_dimension: int) -> Algorithm:
    return Algorithm("derivative_free", about, stops=True, first_per_dimension=first_per_dimension)


def _with_gradient(about: str, family: Family = "limited_memory", stops: bool = True) -> Algorithm:
    return Algorithm(family, about, stops=stops, first_per_dimension=1)


ALGORITHMS: dict[str, Algorithm] = {
    "GN_DIRECT": _direct("Divide the box into rectangles"),
    "GN_DIRECT_L": _direct("Divide the box, biased to local search (Gablonsky, Kelley 2001)"),
    "GN_DIRECT_L_RAND": _direct("Divide the box, biased to local search, ties broken at random", stochastic=True),
    "GN_DIRECT_NOSCAL": _direct("Divide the box into rectangles, the box not rescaled"),
    "GN_DIRECT_L_NOSCAL": _direct("Divide the box, biased to local search, the box not rescaled"),
    "GN_DIRECT_L_RAND_NOSCAL": _direct("Divide the box, biased to local search, randomised, the box not rescaled"),
    "GN_ORIG_DIRECT": _direct("Divide the box into rectangles, Gablonsky's Fortran", most=500),
    "GN_ORIG_DIRECT_L": _direct("Divide the box, biased to local search, Gablonsky's Fortran", most=700),
    "GN_CRS2_LM": Algorithm(
        "population", "Controlled random search with local mutation (Kaelo, Ali 2006); population: 10 (dim + 1).",
        stochastic=True, first=10, first_per_dimension=10,
    ),
    "GN_ISRES": Algorithm(
        "population", "Evolution strategy with stochastic ranking (Runarsson, Yao 2005); population: 20 (dim + 1).",
        stochastic=True, first=20, first_per_dimension=20, maximum_dimension=1900,
    ),
    "GN_ESCH": Algorithm(
        "population", "Evolution strategy with Cauchy mutation (da Silva Santos 2010); population: 40.",
        stochastic=True, first=40,
    ),
    "GN_AGS": Algorithm(
        "global", "Adaptive search along a space-filling curve (Sergeyev, Strongin); 10 dimensions at most.",
        uses_start=False, maximum_dimension=10,
    ),
    "GD_STOGO": Algorithm(
        "global", "Branch and bound with gradients (Madsen, Zertchaninov 1998).",
        uses_start=False, first_per_dimension=1,
    ),
    "GD_STOGO_RAND": Algorithm(
        "global", "Branch and bound with gradients, randomised.",
        stochastic=True, uses_start=False, first_per_dimension=1,
    ),
    "GN_MLSL": Algorithm("mlsl_free", "Multi-level single linkage over a local method.", stochastic=True, first=5),
    "GD_MLSL": Algorithm(
        "mlsl_gradient", "Multi-level single linkage over a local method with gradients.", stochastic=True, first=5
    ),
    "GN_MLSL_LDS": Algorithm("mlsl_free", "Multi-level single linkage from a low-discrepancy sequence.", first=5),
    "GD_MLSL_LDS": Algorithm(
        "mlsl_gradient", "Multi-level single linkage with gradients, from a low-discrepancy sequence.", first=5
    ),
    "G_MLSL": Algorithm("mlsl_any", "Multi-level single linkage over any local method.", stochastic=True, first=5),
    "G_MLSL_LDS": Algorithm("mlsl_any", "Multi-level single linkage over any, low-discrepancy starts.", first=5),
    "LN_COBYLA": _free("Linear models on a simplex (Powell 1994).", 1),
    "LN_BOBYQA": _free("Quadratic models in a box (Powell 2009).", 2),
    "LN_NEWUOA": Algorithm(
        "derivative_free", "Quadratic models without bounds (Powell 2004): evaluates outside the box.",
        stops=True, bounded=False, first_per_dimension=2, minimum_dimension=2,
    ),
    "LN_NEWUOA_BOUND": Algorithm(
        "derivative_free",
        "NEWUOA's models minimised in a box; the MMA inside can loop for ever (NLopt's issue 117): a glob takes it with"
        " `time_limit` only.",
        stops=True, may_hang=True, first_per_dimension=2, minimum_dimension=2,
    ),
    "LN_NELDERMEAD": _free("The simplex of Nelder and Mead (1965), kept in the box.", 1),
    "LN_SBPLX": _free("Nelder-Mead on subspaces (after Rowan 1990).", 0),
    "LN_PRAXIS": Algorithm(
        "derivative_free", "Principal axes (Brent 1972); draws random steps where it is stuck.",
        stochastic=True, stops=True,
    ),
    "LD_SLSQP": _with_gradient("Sequential quadratic programming (Kraft 1994).", "gradient"),
    "LD_LBFGS": _with_gradient("Limited-memory BFGS (Luksan's)."),
    "LD_VAR1": _with_gradient("Limited-memory variable metric, rank 1 (Vlcek, Luksan)."),
    "LD_VAR2": _with_gradient("Limited-memory variable metric, rank 2 (Vlcek, Luksan)."),
    "LD_TNEWTON": _with_gradient("Truncated Newton (Dembo, Steihaug 1983)."),
    "LD_TNEWTON_RESTART": _with_gradient("Truncated Newton with restarts along the gradient."),
    "LD_TNEWTON_PRECOND": _with_gradient("Truncated Newton, preconditioned by BFGS."),
    "LD_TNEWTON_PRECOND_RESTART": _with_gradient("Truncated Newton, preconditioned, with restarts along the gradient."),
    "LD_MMA": _with_gradient("Moving asymptotes (Svanberg 2002).", "endless_gradient", stops=False),
    "LD_CCSAQ": _with_gradient("Convex separable quadratic models (Svanberg 2002).", "endless_gradient", stops=False),
    "AUGLAG": Algorithm("auglag_any", "Augmented Lagrangian: without constraints, its local method.", stops=True),
    "AUGLAG_EQ": Algorithm("auglag_any", "Augmented Lagrangian for equalities: here its local method.", stops=True),
    "LN_AUGLAG": Algorithm("auglag_free", "Augmented Lagrangian: without constraints, its local method.", stops=True),
    "LN_AUGLAG_EQ": Algorithm("auglag_free", "Augmented Lagrangian for equalities: here its local method.", stops=True),
    "LD_AUGLAG": Algorithm(
        "auglag_gradient", "Augmented Lagrangian: without constraints, its local method.",
        stops=True, first_per_dimension=1,
    ),
    "LD_AUGLAG_EQ": Algorithm(
        "auglag_gradient", "Augmented Lagrangian for equalities: here its local method.",
        stops=True, first_per_dimension=1,
    ),
}  # fmt: skip

EXCLUDED: dict[str, str] = {
    "LD_LBFGS_NOCEDAL": "NLopt is built without Nocedal's code: every call ends as an invalid argument",
}


FreeLocal = Literal["LN_BOBYQA", "LN_COBYLA", "LN_NELDERMEAD", "LN_SBPLX"]
GradientLocal = Literal["LD_SLSQP", "LD_MMA", "LD_CCSAQ"]
AnyLocal = Literal["LD_SLSQP", "LD_MMA", "LD_CCSAQ", "LN_BOBYQA", "LN_COBYLA", "LN_NELDERMEAD", "LN_SBPLX"]


def _global(algorithm: str, scale_value: bool = True) -> NLopt:
    """Search the box until the budget is spent."""
    return NLopt(algorithm, {"scale_value": scale_value})


def _population(algorithm: str, population: int | None = None, scale_value: bool = True) -> NLopt:
    """Search with a `population`; null leaves its size to NLopt."""
    return NLopt(algorithm, {"population": population, "scale_value": scale_value})


def _derivative_free(
    algorithm: str, initial_step: float | None = None, scale_value: bool = True, restarts: bool = False
) -> NLopt:
    """Descend without derivatives; `initial_step` in widths of the box, null leaves it to NLopt."""
    return NLopt(algorithm, {"initial_step": initial_step, "scale_value": scale_value, "restarts": restarts})


def _gradient(algorithm: str, scale_value: bool = True, restarts: bool = False) -> NLopt:
    """Descend along gradients."""
    return NLopt(algorithm, {"scale_value": scale_value, "restarts": restarts})


def _limited_memory(
    algorithm: str, storage: int | None = None, scale_value: bool = True, restarts: bool = False
) -> NLopt:
    """Descend along gradients, remembering `storage` of them; null leaves the number to NLopt."""
    return NLopt(algorithm, {"storage": storage, "scale_value": scale_value, "restarts": restarts})


def _endless(algorithm: str, scale_value: bool = True, restarts: bool = False) -> NLopt:
    """Descend along gradients, without an end unless there are `restarts`."""
    return NLopt(algorithm, {"scale_value": scale_value, "restarts": restarts})


def _mlsl_free(
    algorithm: str,
    local: FreeLocal = "LN_BOBYQA",
    local_tolerance: float = ROUNDING,
    population: int | None = None,
    scale_value: bool = True,
) -> NLopt:
    """Start `local` from the best of `population` (null: 4) new random points, again and again."""
    return _mlsl_any(algorithm, local, local_tolerance, population, scale_value)


def _mlsl_gradient(
    algorithm: str,
    local: GradientLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    population: int | None = None,
    scale_value: bool = True,
) -> NLopt:
    """Start `local` from the best of `population` (null: 4) new random points, again and again."""
    return _mlsl_any(algorithm, local, local_tolerance, population, scale_value)


def _mlsl_any(
    algorithm: str,
    local: AnyLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    population: int | None = None,
    scale_value: bool = True,
) -> NLopt:
    """Start `local` from the best of `population` (null: 4) new random points, again and again."""
    chosen = {"local": local, "local_tolerance": local_tolerance, "population": population}
    return NLopt(algorithm, {**chosen, "scale_value": scale_value})


def _auglag_free(
    algorithm: str,
    local: FreeLocal = "LN_BOBYQA",
    local_tolerance: float = ROUNDING,
    scale_value: bool = True,
    restarts: bool = False,
) -> NLopt:
    """Run `local` inside the augmented Lagrangian."""
    return _auglag_any(algorithm, local, local_tolerance, scale_value, restarts)


def _auglag_gradient(
    algorithm: str,
    local: GradientLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    scale_value: bool = True,
    restarts: bool = False,
) -> NLopt:
    """Run `local` inside the augmented Lagrangian."""
    return _auglag_any(algorithm, local, local_tolerance, scale_value, restarts)


def _auglag_any(
    algorithm: str,
    local: AnyLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    scale_value: bool = True,
    restarts: bool = False,
) -> NLopt:
    """Run `local` inside the augmented Lagrangian."""
    chosen = {"local": local, "local_tolerance": local_tolerance}
    return NLopt(algorithm, {**chosen, "scale_value": scale_value, "restarts": restarts})


_FAMILIES: dict[str, Callable[..., NLopt]] = {
    "global": _global, "population": _population, "derivative_free": _derivative_free, "gradient": _gradient,
    "limited_memory": _limited_memory, "endless_gradient": _endless, "mlsl_free": _mlsl_free,
    "mlsl_gradient": _mlsl_gradient, "mlsl_any": _mlsl_any, "auglag_free": _auglag_free,
    "auglag_gradient": _auglag_gradient, "auglag_any": _auglag_any,
}  # fmt: skip

for _name, _known in ALGORITHMS.items():
    _entry = functools.partial(_FAMILIES[_known.family], _name)
    _entry.__doc__ = _known.about
    registry.register(f"nlopt_{_name}")(_entry)
for _name, _reason in EXCLUDED.items():
    registry.exclude(f"nlopt_{_name}", _reason)
