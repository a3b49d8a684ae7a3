"""The traits of NLopt's algorithms, measured with NLopt 2.11, tolerances off, on nine test functions.

The table is static, so that listing needs no NLopt. `stops`: was seen to end by itself before its evaluations were
spent (converged, or failed at the rounding floor). `uses_start`: proposes other points from another start. `first` and
`first_per_dimension`: evaluations of its first sample or model, which it chooses before it has learnt anything.
`maximum_dimension` is measured (``python -m benchmarks.dimensions``): beyond it the DIRECT of Gablonsky writes outside
its arrays, and the population of ISRES takes more than a gigabyte.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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


def _gradient(about: str, family: Family = "limited_memory", stops: bool = True) -> Algorithm:
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
    "LD_SLSQP": _gradient("Sequential quadratic programming (Kraft 1994).", "gradient"),
    "LD_LBFGS": _gradient("Limited-memory BFGS (Luksan's)."),
    "LD_VAR1": _gradient("Limited-memory variable metric, rank 1 (Vlcek, Luksan)."),
    "LD_VAR2": _gradient("Limited-memory variable metric, rank 2 (Vlcek, Luksan)."),
    "LD_TNEWTON": _gradient("Truncated Newton (Dembo, Steihaug 1983)."),
    "LD_TNEWTON_RESTART": _gradient("Truncated Newton with restarts along the gradient."),
    "LD_TNEWTON_PRECOND": _gradient("Truncated Newton, preconditioned by BFGS."),
    "LD_TNEWTON_PRECOND_RESTART": _gradient("Truncated Newton, preconditioned, with restarts along the gradient."),
    "LD_MMA": _gradient("Moving asymptotes (Svanberg 2002).", "endless_gradient", stops=False),
    "LD_CCSAQ": _gradient("Convex separable quadratic models (Svanberg 2002).", "endless_gradient", stops=False),
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
