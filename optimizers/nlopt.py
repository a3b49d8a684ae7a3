"""NLopt's algorithms, each under its own name: ``nlopt_LN_BOBYQA`` is NLopt's LN_BOBYQA.

docs/optimizers.md says what each is given and why; listing needs no NLopt. The search runs in the unit box and on the
value divided by its first size. Nothing may be raised inside NLopt's callback: it is kept, and raised again outside.
"""

from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, final

import numpy as np

from calibench.core.options import Range
from calibench.optimizers.base import Array, CountOrNull, Objective, Reason, Traits, registry, with_restarts
from calibench.optimizers.derivatives import value_and_gradient

ROUNDING = 1e-15
_NO_GRADIENT_TEST = 1e-30  # 0 would mean NLopt's own 1e-8, an absolute slope, which after the division comes early
_LARGEST = 1e100  # stands for an infinite value: models built through inf become NaN
_NOTHING: Any = lambda _point, _gradient: 0.0  # noqa: E731  (the objective of a search that is over)


@final
@dataclass(frozen=True)
class NLopt:
    """One NLopt algorithm, its tolerances off, with the options of its family."""

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    algorithm: str
    options: Mapping[str, Any]
    library: ClassVar[str] = "nlopt"

    @property
    def name(self) -> str:
        return f"nlopt_{self.algorithm}"

    @property
    def traits(self) -> Traits:
        known, restarts = ALGORITHMS[self.algorithm], self.options.get("restarts", False)
        population = self.options.get("population")
        return Traits(
            stochastic=known.stochastic or restarts, bounded=known.bounded,
            uses_gradient=self.options.get("local", self.algorithm)[1] == "D",
            self_terminating=known.stops and not restarts, uses_start=known.uses_start,
            minimum_budget=known.first if population is None else population,
            minimum_budget_per_dimension=known.first_per_dimension if population is None else 0,
            minimum_dimension=known.minimum_dimension, maximum_dimension=known.maximum_dimension,
            needs_finite_bounds=True, may_hang=known.may_hang,
        )  # fmt: skip

    def minimize(self, objective: Objective, rng: np.random.Generator) -> Reason:
        """Run from the start; with `restarts`, or where it ends against its habit, again from random points."""
        import nlopt

        nlopt.srand(int(rng.integers(1, 2**31)))
        again = not self.traits.self_terminating
        return with_restarts(lambda start: self._descend(nlopt, objective, start), objective, again)

    def _descend(self, nlopt: Any, objective: Objective, start: Array) -> None:
        lower, width = objective.lower, objective.upper - objective.lower
        width = np.where(width > 0, width, 1.0)
        clipped = ALGORITHMS[self.algorithm].bounded  # what keeps to its box may miss it by rounding
        search = self._search(nlopt, objective)
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
                value, slope = value_and_gradient(objective, x) if gradient.size else (objective(x), gradient)
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
            refused = f"{self.name}: NLopt refuses {self.options} in {objective.dimension} dimensions"
            raise ValueError(refused) from error
        finally:  # each holds the other, which Python cannot see: they would stay for ever
            search.set_min_objective(_NOTHING)
        if caught and caught[0] is not None:
            raise caught[0]

    def _search(self, nlopt: Any, objective: Objective) -> Any:
        options = self.options
        search = nlopt.opt(getattr(nlopt, self.algorithm), objective.dimension)
        search.set_lower_bounds(np.zeros(objective.dimension))
        search.set_upper_bounds(np.where(objective.upper > objective.lower, 1.0, 0.0))
        search.set_maxeval(objective.remaining + 1)  # the wall is the objective's; this one ends what ignores a stop
        if ALGORITHMS[self.algorithm].family == "limited_memory":
            search.set_param("tolg", _NO_GRADIENT_TEST)
        if options.get("restarts") or self.algorithm == "LN_NEWUOA_BOUND":  # some never end by themselves
            search.set_xtol_rel(ROUNDING)
        for option, set_it in (
            ("initial_step", search.set_initial_step), ("population", search.set_population),
            ("storage", search.set_vector_storage),
        ):  # fmt: skip
            if options.get(option) is not None:
                set_it(options[option])
        if "local" in options:
            local = nlopt.opt(getattr(nlopt, options["local"]), objective.dimension)
            local.set_ftol_rel(options["local_tolerance"])
            local.set_xtol_rel(options["local_tolerance"])
            search.set_local_optimizer(local)
        return search


Family = Literal[
    "global", "population", "derivative_free", "gradient", "limited_memory", "mlsl_free", "mlsl_gradient", "mlsl_any",
    "auglag_free", "auglag_gradient", "auglag_any",
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
    about += " (Jones, Perttunen, Stuckman 1993); ignores the start."
    return Algorithm("global", about, stochastic, uses_start=False, maximum_dimension=most)


_free = partial(Algorithm, "derivative_free", stops=True)
_limited = partial(Algorithm, "limited_memory", stops=True, first_per_dimension=1)
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
    "LN_COBYLA": _free("Linear models on a simplex (Powell 1994).", first_per_dimension=1),
    "LN_BOBYQA": _free("Quadratic models in a box (Powell 2009).", first_per_dimension=2),
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
    "LN_NELDERMEAD": _free("The simplex of Nelder and Mead (1965), kept in the box.", first_per_dimension=1),
    "LN_SBPLX": _free("Nelder-Mead on subspaces (after Rowan 1990).", first_per_dimension=0),
    "LN_PRAXIS": Algorithm(
        "derivative_free", "Principal axes (Brent 1972); draws random steps where it is stuck.",
        stochastic=True, stops=True,
    ),
    "LD_SLSQP": Algorithm(
        "gradient", "Sequential quadratic programming (Kraft 1994).", stops=True, first_per_dimension=1
    ),
    "LD_LBFGS": _limited("Limited-memory BFGS (Luksan's)."),
    "LD_VAR1": _limited("Limited-memory variable metric, rank 1 (Vlcek, Luksan)."),
    "LD_VAR2": _limited("Limited-memory variable metric, rank 2 (Vlcek, Luksan)."),
    "LD_TNEWTON": _limited("Truncated Newton (Dembo, Steihaug 1983)."),
    "LD_TNEWTON_RESTART": _limited("Truncated Newton with restarts along the gradient."),
    "LD_TNEWTON_PRECOND": _limited("Truncated Newton, preconditioned by BFGS."),
    "LD_TNEWTON_PRECOND_RESTART": _limited("Truncated Newton, preconditioned, with restarts along the gradient."),
    "LD_MMA": Algorithm("gradient", "Moving asymptotes (Svanberg 2002).", first_per_dimension=1),
    "LD_CCSAQ": Algorithm("gradient", "Convex separable quadratic models (Svanberg 2002).", first_per_dimension=1),
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

_Free = Literal["LN_BOBYQA", "LN_COBYLA", "LN_NELDERMEAD", "LN_SBPLX"]
_Gradient = Literal["LD_SLSQP", "LD_MMA", "LD_CCSAQ"]
_Any = Literal["LD_SLSQP", "LD_MMA", "LD_CCSAQ", "LN_BOBYQA", "LN_COBYLA", "LN_NELDERMEAD", "LN_SBPLX"]
_SCALED, _RESTARTS = ("scale_value", bool, True), ("restarts", bool, False)
_POPULATION, _STORAGE = ("population", CountOrNull, None), ("storage", CountOrNull, None)  # null: NLopt's own
_STEP = ("initial_step", Annotated[float | None, Range(0, 1, above=True, unit="widths of the box")], None)
_INNER = ("local_tolerance", Annotated[float, Range(0, 1, above=True)], ROUNDING)
FAMILIES: dict[Family, tuple[tuple[str, Any, Any], ...]] = {  # the options of each: name, type, default
    "global": (_SCALED,),
    "population": (_POPULATION, _SCALED),
    "derivative_free": (_STEP, _SCALED, _RESTARTS),
    "gradient": (_SCALED, _RESTARTS),
    "limited_memory": (_STORAGE, _SCALED, _RESTARTS),
    "mlsl_free": (("local", _Free, "LN_BOBYQA"), _INNER, _POPULATION, _SCALED),
    "mlsl_gradient": (("local", _Gradient, "LD_SLSQP"), _INNER, _POPULATION, _SCALED),
    "mlsl_any": (("local", _Any, "LD_SLSQP"), _INNER, _POPULATION, _SCALED),
    "auglag_free": (("local", _Free, "LN_BOBYQA"), _INNER, _SCALED, _RESTARTS),
    "auglag_gradient": (("local", _Gradient, "LD_SLSQP"), _INNER, _SCALED, _RESTARTS),
    "auglag_any": (("local", _Any, "LD_SLSQP"), _INNER, _SCALED, _RESTARTS),
}


def _build(algorithm: str, **chosen: Any) -> NLopt:
    return NLopt(algorithm, {name: default for name, _, default in FAMILIES[ALGORITHMS[algorithm].family]} | chosen)


for _name, _known in ALGORITHMS.items():
    _entry = partial(_build, _name)
    _entry.__doc__ = _known.about
    registry.register(f"nlopt_{_name}", options=make_dataclass(_known.family, FAMILIES[_known.family]))(_entry)
registry.exclude("nlopt_LD_LBFGS_NOCEDAL", EXCLUDED["LD_LBFGS_NOCEDAL"])
