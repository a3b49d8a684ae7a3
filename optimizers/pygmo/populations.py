"""pygmo's population methods: a random population in the box, evolved until the budget is spent.

The start is ignored. Defaults are pygmo's own, but for the population, which pygmo leaves to its user: a rule of
`population_sizes` gives it, whose formula is the default (d: dimension, B: budget), and null too. Ranges are checked
here, at construction, so that the sentence names the option and not a line of C++.
"""

from __future__ import annotations

from typing import Any, Literal

from calibench.optimizers.base import registry
from calibench.optimizers.pygmo.adapter import Pygmo, evolved, require, within
from calibench.optimizers.pygmo.population_sizes import RULES

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
