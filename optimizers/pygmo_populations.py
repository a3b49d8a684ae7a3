"""pygmo's population methods: a random population in the box, evolved until the budget is spent.

The start is ignored. Defaults are pygmo's own, but for the population, which pygmo leaves to its user. Ranges are
checked here, at construction, so that the sentence names the option and not a line of C++.
"""

from __future__ import annotations

from typing import Any, Literal

from optimizers.base import registry
from optimizers.from_pygmo import Pygmo, evolved, require, within

_NEVER: dict[str, Any] = {"ftol": 0.0, "xtol": 0.0}


@registry.register("pygmo_de")
def pygmo_de(population: int = 150, F: float = 0.8, CR: float = 0.9, variant: int = 2) -> Pygmo:
    """Differential evolution; `variant` 1-10 as pygmo numbers them (2 is rand/1/exp)."""
    within("de", 0, 1, F=F, CR=CR)
    within("de", 1, 10, variant=variant)
    return evolved("de", population, {"F": F, "CR": CR, "variant": variant}, least=5, fixed=_NEVER)


@registry.register("pygmo_sade")
def pygmo_sade(population: int = 150, variant: int = 2, variant_adptv: int = 1) -> Pygmo:
    """Self-adaptive differential evolution; `variant` 1-18, `variant_adptv` 1 (jDE) or 2 (iDE)."""
    within("sade", 1, 18, variant=variant)
    within("sade", 1, 2, variant_adptv=variant_adptv)
    arguments = {"variant": variant, "variant_adptv": variant_adptv}
    return evolved("sade", population, arguments, least=7, fixed=_NEVER)


@registry.register("pygmo_de1220")
def pygmo_de1220(
    population: int = 150, allowed_variants: tuple[int, ...] = (2, 3, 7, 10, 13, 14, 15, 16), variant_adptv: int = 1
) -> Pygmo:
    """Differential evolution that adapts its variant too, out of `allowed_variants` (each 1-18)."""
    rule = "one or more whole numbers in 1 .. 18 are needed"
    good = bool(allowed_variants) and all(1 <= variant <= 18 for variant in allowed_variants)
    require("pygmo_de1220.allowed_variants", list(allowed_variants), good, rule)
    within("de1220", 1, 2, variant_adptv=variant_adptv)
    arguments = {"allowed_variants": list(allowed_variants), "variant_adptv": variant_adptv}
    return evolved("de1220", population, arguments, least=7, fixed=_NEVER)


def _swarm(algorithm: str, population: int, arguments: dict[str, Any]) -> Pygmo:
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
    population: int = 50,
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
    population: int = 50,
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
    population: int = 150,
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
    within("sga", 1, population, param_s=param_s)
    even = crossover != "sbx" or population % 2 == 0
    require("pygmo_sga.population", population, even, "sbx mates pairs: an even number is needed")
    operators = dict(crossover=crossover, mutation=mutation, selection=selection)
    numbers = dict(cr=cr, eta_c=eta_c, m=m, param_m=param_m, param_s=param_s)
    return evolved("sga", population, {**numbers, **operators}, least=2)


@registry.register("pygmo_bee_colony")
def pygmo_bee_colony(population: int = 20, limit: int = 20) -> Pygmo:
    """Artificial bee colony; a source that did not improve `limit` times is left.

    A generation costs two populations.
    """
    require("pygmo_bee_colony.limit", limit, limit >= 1, "must be 1 or more")
    return evolved("bee_colony", population, {"limit": limit}, least=2, per_generation=2 * max(population, 1))


@registry.register("pygmo_gaco")
def pygmo_gaco(population: int = 100, ker: int = 63, q: float = 1.0, acc: float = 0.01, focus: float = 0.0) -> Pygmo:
    """Extended ant colony; `ker` solutions are remembered, `q` weighs the better ones, `focus` narrows the search.

    `acc` is the least distance between what is remembered. pygmo's two stops by count are switched off.
    """
    within("gaco", 2, population, ker=ker)
    require("pygmo_gaco.q", q, q >= 0, "must be 0 or more")
    require("pygmo_gaco.acc", acc, acc >= 0, "must be 0 or more")
    require("pygmo_gaco.focus", focus, focus >= 0, "must be 0 or more")
    never = {"impstop": 2**31 - 1, "evalstop": 2**31 - 1}
    return evolved(
        "gaco", population, {"ker": ker, "q": q, "acc": acc, "focus": focus}, least=2, fixed=never, batches=True
    )


@registry.register("pygmo_gwo")
def pygmo_gwo(population: int = 50) -> Pygmo:
    """Grey wolf optimiser: it narrows over the generations, of which it is given as many as the budget holds."""
    return evolved("gwo", population, {}, least=3)


@registry.register("pygmo_cmaes")
def pygmo_cmaes(population: int = 50, sigma0: float = 0.5) -> Pygmo:
    """Covariance matrix adaptation; `sigma0` is the first step size in shares of the box."""
    require("pygmo_cmaes.sigma0", sigma0, sigma0 > 0, "must be above 0")
    never = {**_NEVER, "force_bounds": True}
    return evolved("cmaes", population, {"sigma0": sigma0}, least=5, fixed=never, batches=True)


@registry.register("pygmo_xnes")
def pygmo_xnes(population: int = 50, sigma0: float | None = None) -> Pygmo:
    """Exponential natural evolution strategy; `sigma0` is the first step size, null leaves it to pygmo."""
    require("pygmo_xnes.sigma0", sigma0, sigma0 is None or 0 < sigma0 <= 1, "must lie in 0 .. 1, above 0, or null")
    made = evolved("xnes", population, {}, least=4, fixed={**_NEVER, "force_bounds": True, "sigma0": sigma0 or -1.0})
    return Pygmo("xnes", {"population": population, "sigma0": sigma0}, made.build)


@registry.register("pygmo_ihs")
def pygmo_ihs(
    population: int = 50,
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
    return evolved("ihs", population, arguments, least=1, per_generation=1)
