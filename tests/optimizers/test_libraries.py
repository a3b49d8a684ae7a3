"""The adapters of NLopt and pygmo: whole, with options that reach the library, and open about what is left out."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.gate.evaluator import Evaluator
from calibench.core.registry import Registry
from calibench.optimizers.nlopt import ALGORITHMS, EXCLUDED
from calibench.optimizers.pygmo import _Fitness
from tests.few import one_of_each

nlopt = pytest.importorskip("nlopt")
pygmo = pytest.importorskip("pygmo")


class Bowl:
    """A bowl in `dimension` variables, its floor at 0.3; keeps the points it was asked for."""

    def __init__(self, dimension: int = 4, start: float = -0.9) -> None:
        self.dimension = dimension
        self.lower, self.upper = np.full(dimension, -2.0), np.full(dimension, 2.5)
        self.start = np.full(dimension, start)
        self.asked: list[np.ndarray] = []

    def __call__(self, x: np.ndarray) -> float:
        self.asked.append(np.array(x))
        return float(((x - 0.3) ** 2 * np.arange(1, len(x) + 1)).sum())


class Hole(Bowl):
    """The same, infinite in a half of the box."""

    def __call__(self, x: np.ndarray) -> float:
        return super().__call__(x) if x[0] < 0.5 else float("inf")


class Downhill(Bowl):
    """A plane that falls towards the upper corner of an awkward box."""

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self.lower, self.upper = np.full(dimension, AWKWARD[0]), np.full(dimension, AWKWARD[1])
        self.start = np.full(dimension, 0.05)

    def __call__(self, x: np.ndarray) -> float:
        super().__call__(x)
        return -float(x.sum())


class Slope(Bowl):
    """A plane that falls towards the lower corner, at which a quadratic model leaves the box."""

    def __call__(self, x: np.ndarray) -> float:
        super().__call__(x)
        return float(x.sum())


def test_every_algorithm_of_nlopt_is_there_or_left_out_with_a_reason() -> None:
    theirs = {name for name in dir(nlopt) if name[:3] in ("GN_", "GD_", "LN_", "LD_", "G_M", "AUG")}
    assert theirs == {*ALGORITHMS, *EXCLUDED}
    assert len(theirs) == nlopt.NUM_ALGORITHMS
    assert {f"nlopt_{name}" for name in ALGORITHMS} <= set(optimizers.names())


def test_every_algorithm_of_pygmo_is_there_or_left_out_with_a_reason() -> None:
    theirs = {name for name in dir(pygmo) if isinstance(getattr(pygmo, name), type) and _is_algorithm(name)}
    ours = {n.removeprefix("pygmo_") for n in optimizers.names() if n.startswith("pygmo_")}
    left_out = {n.removeprefix("pygmo_") for n in optimizers.registry.left_out if n.startswith("pygmo_")}
    assert not ours & left_out
    assert theirs == ours | left_out


def _is_algorithm(name: str) -> bool:
    """Return whether pygmo takes an instance of its class `name` as an algorithm."""
    try:
        pygmo.algorithm(getattr(pygmo, name)())
    except Exception:
        return False
    return name not in ("algorithm", "island", "archipelago")  # the boxes that they come in


@pytest.mark.parametrize("name", list(optimizers.registry.left_out))
def test_asking_for_what_is_left_out_gives_the_reason(name: str) -> None:
    with pytest.raises(ValueError, match="is left out: ") as refused:
        optimizers.make(name)
    assert optimizers.registry.left_out[name] in str(refused.value)


def test_a_registered_name_cannot_be_left_out() -> None:
    registry: Registry[int] = Registry("thing", "no.group")
    registry.register("one")(lambda: 1)
    with pytest.raises(ValueError, match="cannot be left out"):
        registry.exclude("one", "no reason")


def test_the_list_shows_what_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    from calibench.bench.cli import main

    for words, shown in ((["list", "optimizers", "--all"], True), (["list", "optimizers"], False)):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == 0
        text = capsys.readouterr().out
        for name, reason in optimizers.registry.left_out.items():
            assert (f"{name}  [left out]\n    {reason}\n" in text) is shown


def test_listing_needs_neither_library() -> None:
    code = "import sys; sys.modules['nlopt'] = sys.modules['pygmo'] = None; import optimizers as o\n"
    code += "print(len([o.make(n).traits for n in o.names()]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == len([name for name in optimizers.names() if ":" not in name])


@pytest.mark.parametrize(
    ("name", "options", "rule"),
    [
        ("nlopt_GN_CRS2_LM", {"population": 0}, "population=0: must be 1 or more"),
        ("nlopt_LD_LBFGS", {"storage": 0}, "storage=0: must be 1 or more"),
        ("lm", {"first_step": 0}, "lm.first_step=0: must be above 0 (widths of the box)"),
        ("lm", {"first_step": -1}, "lm.first_step=-1: must be above 0"),
        ("lm", {"tolerance": 0}, "lm.tolerance=0: must lie in 2.22045e-16 .. 1"),
        ("trf", {"tolerance": 5}, "trf.tolerance=5: must lie in 2.22"),
        ("dogbox", {"tolerance": -1}, "dogbox.tolerance=-1: must lie in 2.22"),
        ("nlopt_LN_BOBYQA", {"initial_step": 1.5}, "initial_step=1.5: must lie in 0 .. 1"),
        ("nlopt_LN_BOBYQA", {"initial_step": 0}, "initial_step=0: must lie in 0 .. 1"),
        ("nlopt_G_MLSL", {"local_tolerance": 2}, "local_tolerance=2: must lie in 0 .. 1, above 0"),
        ("nlopt_G_MLSL", {"local": "LN_PRAXIS"}, "local=LN_PRAXIS: choices: LD_SLSQP"),
        ("nlopt_LN_AUGLAG", {"local": "LD_SLSQP"}, "local=LD_SLSQP: "),
        ("nlopt_LN_BOBYQA", {"population": 5}, "has no option 'population'"),
        ("pygmo_de", {"F": 1.2}, "pygmo_de.F=1.2: must lie in 0 .. 1"),
        ("pygmo_de", {"CR": -0.1}, "pygmo_de.CR=-0.1: must lie in 0 .. 1"),
        ("pygmo_de", {"variant": 11}, "pygmo_de.variant=11: must lie in 1 .. 10"),
        ("pygmo_de", {"population": 4}, "pygmo_de.population=4: must be 5 or more"),
        ("pygmo_sade", {"population": 6}, "population=6: must be 7 or more"),
        ("pygmo_sade", {"variant_adptv": 3}, "variant_adptv=3: must lie in 1 .. 2"),
        ("pygmo_de1220", {"allowed_variants": [2, 19]}, "allowed_variants=[2, 19]: one or more whole numbers"),
        ("pygmo_de1220", {"allowed_variants": []}, "allowed_variants=[]: one or more whole numbers"),
        ("pygmo_pso", {"max_vel": 0}, "max_vel=0: must lie in"),
        ("pygmo_pso_gen", {"neighb_type": 5}, "pygmo_pso_gen.neighb_type=5: must lie in 1 .. 4"),
        ("pygmo_sga", {"m": 2}, "m=2: must lie in 0 .. 1"),
        ("pygmo_sga", {"crossover": "sbx", "population": 51}, "population=51: sbx mates pairs"),
        ("pygmo_sga", {"param_s": 151, "population": 150}, "param_s=151: must lie in 1 .. 150"),
        ("pygmo_sga", {"param_s": 11}, "param_s=11: must lie in 1 .. 10"),
        ("pygmo_sga", {"mutation": "gaussian", "param_m": 2}, "param_m=2.0: must lie in 0 .. 1"),
        ("pygmo_sga", {"mutation": "cauchy"}, "mutation=cauchy: choices: gaussian"),
        ("pygmo_bee_colony", {"limit": 0}, "limit=0: must be 1 or more"),
        ("pygmo_gaco", {"population": 50, "ker": 63}, "ker=63: must lie in 2 .. 50"),
        ("pygmo_de", {"population": "many"}, "pygmo_de.population=many: a whole number is needed"),
        ("pygmo_ipopt", {"memory": 0}, "memory=0: must be 1 or more"),
        ("pygmo_gwo", {"population": 2}, "population=2: must be 3 or more"),
        ("pygmo_cmaes", {"sigma0": 0}, "sigma0=0: must be above 0"),
        ("pygmo_xnes", {"sigma0": 2}, "sigma0=2: must lie in 0 .. 1, above 0"),
        ("pygmo_ihs", {"ppar_min": 0.99}, "ppar_min=0.99: must be below ppar_max=0.99"),
        ("pygmo_ihs", {"bw_min": 2}, "bw_min=2.0: must be above 0 and below bw_max=1"),
        ("pygmo_compass_search", {"stop_range": 0.2}, "stop_range=0.2: must lie in"),
        ("pygmo_simulated_annealing", {"Tf": 1}, "Tf=1.0: must be above 0 and below Ts=0.1"),
        ("pygmo_simulated_annealing", {"bin_size": 0}, "bin_size=0: must be 1 or more"),
        ("pygmo_mbh", {"perturb": 2}, "perturb=2: must lie in"),
        ("pygmo_mbh", {"inner": "de"}, "inner=de: choices: compass_search, ipopt"),
        ("pygmo_ipopt", {"tolerance": 0}, "tolerance=0: must lie in"),
    ],
)
def test_an_option_out_of_range_is_refused_before_any_run(name: str, options: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValueError, match=re.escape(rule)):
        optimizers.make(name, **options)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("nlopt_GN_CRS2_LM", {"population": 7}),
        ("nlopt_GN_ISRES", {"population": 30}),
        ("nlopt_GN_ESCH", {"population": 10}),
        ("nlopt_GN_MLSL", {"population": 20}),
        ("nlopt_GN_MLSL", {"local": "LN_SBPLX"}),
        ("nlopt_G_MLSL_LDS", {"local": "LN_BOBYQA"}),
        ("nlopt_G_MLSL_LDS", {"local_tolerance": 1e-2}),
        ("nlopt_AUGLAG", {"local": "LN_NELDERMEAD"}),
        ("nlopt_LN_BOBYQA", {"initial_step": 0.01}),
        ("nlopt_LN_COBYLA", {"initial_step": 0.01}),
        ("nlopt_LN_NELDERMEAD", {"initial_step": 0.01}),
        ("nlopt_LN_SBPLX", {"initial_step": 0.01}),
        ("nlopt_LN_PRAXIS", {"initial_step": 0.01}),
        ("nlopt_LD_LBFGS", {"storage": 1}),
        ("nlopt_LD_SLSQP", {"scale_value": False}),
        ("pygmo_de", {"F": 0.3}),
        ("pygmo_de", {"variant": 1}),
        ("pygmo_sade", {"variant_adptv": 2}),
        ("pygmo_de1220", {"allowed_variants": (1,)}),
        ("pygmo_pso", {"neighb_type": 1}),
        ("pygmo_pso_gen", {"omega": 0.5}),
        ("pygmo_sga", {"selection": "truncated"}),
        ("pygmo_bee_colony", {"limit": 1}),
        ("pygmo_gaco", {"ker": 5}),
        ("pygmo_cmaes", {"sigma0": 0.1}),
        ("pygmo_xnes", {"sigma0": 0.1}),
        ("pygmo_ihs", {"phmcr": 0.5}),
        ("pygmo_compass_search", {"start_range": 0.3}),
        ("pygmo_simulated_annealing", {"Ts": 10.0}),
        ("pygmo_simulated_annealing", {"n_T_adj": 2}),
        ("pygmo_mbh", {"perturb": 0.5}),
        ("pygmo_mbh", {"inner": "ipopt"}),
        ("pygmo_ipopt", {"memory": 1}),
    ],
)
def test_an_option_reaches_the_library(name: str, options: dict[str, Any]) -> None:
    changed = Bowl()
    run = bench.execute(changed, optimizers.make(name, **options), budget=1500, optimizer_name="chosen")
    assert run.status == "ok", run.row["error"]
    same_seed = Bowl()
    bench.execute(same_seed, optimizers.make(name), budget=1500, optimizer_name="chosen")
    assert not np.array_equal(np.array(changed.asked), np.array(same_seed.asked))


OF_VALUES = [n for n in optimizers.names() if not optimizers.make(n).traits.uses_residuals]


@pytest.mark.parametrize("name", one_of_each(OF_VALUES))
def test_a_hole_in_the_objective_stops_nobody(name: str) -> None:
    run = bench.execute(Hole(), optimizers.make(name), budget=400)
    assert run.status == "ok", run.row["error"]
    assert run.best_value < 20


@pytest.mark.parametrize("name", ["nlopt_LN_NEWUOA"])
def test_what_ignores_bounds_says_so_and_evaluates_where_it_asks(name: str) -> None:
    problem = Slope()
    run = bench.execute(problem, optimizers.make(name), budget=100)
    assert not optimizers.make(name).traits.bounded
    assert not run.row["inside_box"]
    assert run.best_value < problem.lower.sum()


AWKWARD = (-0.01, 0.12)  # lower + 1.0 * (upper - lower) is an ulp above upper


@pytest.mark.parametrize("name", one_of_each(OF_VALUES))
def test_the_corner_of_an_awkward_box_is_not_passed_by_an_ulp(name: str) -> None:
    lower, upper = AWKWARD
    assert lower + 1.0 * (upper - lower) > upper
    problem = Downhill(3)
    run = bench.execute(problem, optimizers.make(name), budget=300)
    traits = optimizers.make(name).traits
    asked = np.array([run.best_x] if traits.may_hang else problem.asked)  # what may hang ran in another process
    assert ((asked >= problem.lower) & (asked <= problem.upper)).all() or not traits.bounded


@pytest.mark.parametrize("name", [n for n in optimizers.names() if n.startswith("pygmo_")])
def test_pygmo_keeps_its_own_points_in_the_box(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise it would learn from points outside while we evaluate the edge: 1e-8 is what Ipopt may miss."""
    asked: list[np.ndarray] = []
    put_right = _Fitness._outside

    def listen(self: _Fitness, u: np.ndarray) -> np.ndarray:
        low, high = self.get_bounds()
        asked.append(np.maximum(low - u, u - high).max())
        return put_right(self, u)

    monkeypatch.setattr(_Fitness, "_outside", listen)
    bench.execute(Downhill(3), optimizers.make(name), budget=600)
    assert max(asked) <= 1e-8


def test_what_pygmo_asks_beyond_the_box_is_evaluated_on_its_edge() -> None:
    problem = Bowl(2)
    fitness = _Fitness(Evaluator(problem, 10), scaled=False, has_gradient=False)
    fitness.fitness(np.array([2.5 + 1e-8, np.nextafter(-2.0, -3)]))
    assert problem.asked[0].tolist() == [2.5, -2.0]


def test_a_point_that_is_no_number_is_not_evaluated() -> None:
    """COBYLA asks for NaN at the rounding floor of a bowl."""
    problem = Bowl(5, start=-1.0)
    problem_of_equal_weights = type("Sphere", (Bowl,), {"__call__": _sphere})(5, -1.0)
    for each in (problem, problem_of_equal_weights):
        run = bench.execute(each, optimizers.make("nlopt_LN_COBYLA"), budget=6000)
        assert run.stop_reason == "converged"
        assert np.isfinite(np.array(each.asked)).all()


def _sphere(self: Bowl, x: np.ndarray) -> float:
    self.asked.append(np.array(x))
    return float(((x - 0.3) ** 2).sum())


def test_what_takes_few_dimensions_only_is_refused_more() -> None:
    with pytest.raises(ValueError, match=r"1 \.\. 10 dimensions.* 11"):
        bench.execute(Bowl(11), optimizers.make("nlopt_GN_AGS"), budget=10)
    with pytest.raises(ValueError, match=r"1 \.\. 500 dimensions.* 501"):
        bench.execute(Bowl(501), optimizers.make("nlopt_GN_ORIG_DIRECT"), budget=10)
    with pytest.raises(ValueError, match=r"2 or more dimensions.* 1"):
        bench.execute(Bowl(1), optimizers.make("nlopt_LN_NEWUOA"), budget=10)


def test_what_nlopt_refuses_is_a_sentence() -> None:
    run = bench.execute(Bowl(4), optimizers.make("nlopt_GN_CRS2_LM", population=3), budget=10)
    assert run.status == "failed"
    assert "NLopt refuses {'population': 3, 'scale_value': True} in 4 dimensions" in run.row["error"]


def test_a_trajectory_begins_at_the_start() -> None:
    for name in ("compass_search", "simulated_annealing", "sea", "ipopt", "mbh"):
        problem = Bowl()
        bench.execute(problem, optimizers.make(f"pygmo_{name}"), budget=30)
        assert np.allclose(problem.asked[0], problem.start, rtol=0, atol=1e-15), name


def test_a_stretched_schedule_ends_with_the_budget() -> None:
    for budget in (800, 3200):
        run = bench.execute(Bowl(), optimizers.make("pygmo_simulated_annealing"), budget=budget)
        assert run.row["restarts"] <= 1
        assert run.charged == budget


@pytest.mark.parametrize(
    "name", ["de", "sade", "de1220", "cmaes", "xnes", "pso", "pso_gen", "sga", "bee_colony", "gwo"]
)
def test_a_flat_population_goes_on(name: str) -> None:
    """pygmo's own tolerances (1e-6) would end half of these long before the budget, as a restart."""
    run = bench.execute(Bowl(2), optimizers.make(f"pygmo_{name}", population=10), budget=6000)
    assert run.row["restarts"] == 0
    assert run.charged == 6000
