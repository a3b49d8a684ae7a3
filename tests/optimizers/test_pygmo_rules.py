"""Populations of pygmo's methods: a rule each, which options, rows, traits and the page tell alike."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.provenance.run_id import key_of_optimizer, options_of
from calibench.optimizers.pygmo import METHODS, RULES
from tests.optimizers.page import table_of

pytest.importorskip("pygmo")
NAMES = [n for n in optimizers.names() if "population" in optimizers.registry.options(n) and n.startswith("pygmo_")]


class Sphere:
    """A bowl in `dimension` variables."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension
        self.lower, self.upper = np.full(dimension, -1.0), np.full(dimension, 1.0)
        self.start = np.zeros(dimension)

    def __call__(self, x: np.ndarray) -> float:
        return float(x @ x)


def test_each_population_method_has_a_rule_that_the_page_states_with_its_source() -> None:
    assert sorted(NAMES) == sorted(f"pygmo_{method}" for method in RULES)
    for (method, rule), cells in zip(RULES.items(), table_of("pygmo"), strict=True):
        least = f", at least {rule.least}" if "B" in rule.name else ""
        sizes = [str(rule.size(*case)) for case in ((2, 1000), (12, 5000), (20, 20_000))]
        assert cells[:5] == [f"`{method}`", f"`{rule.name}`{least}", *sizes]
        assert cells[5]
        assert cells[6] or "B" not in rule.name


@pytest.mark.parametrize("name", NAMES)
def test_the_default_is_the_rule_and_null_is_it_too(name: str) -> None:
    rule = RULES[name.removeprefix("pygmo_")]
    assert optimizers.registry.options(name)["population"].default == rule.default
    made = optimizers.make(name)
    assert made == optimizers.make(name, population=None)
    assert options_of(made)["population"] == rule.default
    assert key_of_optimizer(made, name) == [name, {}]
    assert optimizers.make(name, **options_of(made)) == made  # the options of a row make it again


@pytest.mark.parametrize("name", NAMES)
def test_a_number_wins_and_enters_the_id(name: str) -> None:
    made = optimizers.make(name, population=14)
    assert made.members(3, 100) == made.members(12, 20_000) == 14  # type: ignore[attr-defined]
    assert key_of_optimizer(made, name) == [name, {"population": 14}]


@pytest.mark.parametrize(
    ("method", "dimension", "budget", "size"),
    [
        ("cmaes", 1, 20_000, 5), ("cmaes", 2, 1000, 6), ("cmaes", 11, 20_000, 11), ("cmaes", 20, 5000, 12),
        ("xnes", 1, 1000, 4), ("xnes", 12, 1000, 11),
        ("de", 2, 20_000, 20), ("de", 12, 20_000, 40), ("de", 12, 5000, 10), ("de", 12, 10**6, 120),
        ("sade", 12, 20_000, 40), ("sade", 12, 10**6, 100), ("de1220", 12, 50, 10),
        ("pso", 1, 1000, 12), ("pso", 12, 1000, 16), ("pso_gen", 9, 1000, 16),
        ("sga", 12, 1000, 40), ("sga", 12, 1025, 40), ("sga", 12, 20_000, 200), ("sga", 12, 1, 10),
        ("gaco", 12, 1000, 20), ("gaco", 12, 20_000, 50), ("gwo", 12, 1000, 30), ("ihs", 12, 1000, 5),
        ("bee_colony", 3, 1000, 62),
    ],
)  # fmt: skip
def test_rules_give_the_numbers_of_their_formulas(method: str, dimension: int, budget: int, size: int) -> None:
    assert RULES[method].size(dimension, budget) == size


@pytest.mark.parametrize("name", NAMES)
def test_pygmo_is_given_as_many_members_as_the_rule_says(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import pygmo

    asked: list[int] = []
    population = pygmo.population

    def listen(problem: object, size: int, seed: int) -> object:
        asked.append(size)
        return population(problem, size=size, seed=seed)

    monkeypatch.setattr(pygmo, "population", listen)
    run = bench.execute(Sphere(7), optimizers.make(name), budget=3000)
    assert run.status == "ok", run.row["error"]
    assert asked[0] == RULES[name.removeprefix("pygmo_")].size(7, 3000)
    default = optimizers.registry.options(name)["population"].default
    assert json.loads(run.row["optimizer_options"])["population"] == default


@pytest.mark.parametrize("name", NAMES)
def test_the_minimum_budget_holds_a_population(name: str) -> None:
    rule, traits = RULES[name.removeprefix("pygmo_")], optimizers.make(name).traits
    for dimension in range(1, 60):
        room = traits.minimum_budget + traits.minimum_budget_per_dimension * dimension
        assert all(rule.size(dimension, budget) <= room for budget in (1, 1000, 20_000, 10**8))
    assert optimizers.make(name, population=14).traits.minimum_budget == 14


def test_one_population_for_all_was_worth_decades() -> None:
    """The bars are half of what was measured (`python -m benchmarks.populations.rules`)."""
    problem = problems.make("link_length")
    for name, old, decades in (("pygmo_de", 150, 1.0), ("pygmo_cmaes", 50, 1.0)):
        gained = [
            np.log10(bench.execute(problem, optimizers.make(name, population=old), budget=5000, seed=s).best_value)
            - np.log10(bench.execute(problem, optimizers.make(name), budget=5000, seed=s).best_value)
            for s in range(3)
        ]
        assert np.median(gained) > decades, (name, gained)


@pytest.mark.parametrize("name", ["pso_gen", "cmaes", "gaco"])
def test_a_generation_at_once_changes_no_bit_of_the_run(name, monkeypatch):
    problem, method = problems.make("sensor_zero"), optimizers.make(f"pygmo_{name}")
    assert method.traits.batches
    at_once = bench.execute(problem, method, budget=1230, seed=3)
    monkeypatch.setitem(METHODS, name, replace(METHODS[name], batches=False))
    assert not method.traits.batches
    singly = bench.execute(problem, method, budget=1230, seed=3)
    assert at_once.points == singly.points
    assert at_once.best_x.tolist() == singly.best_x.tolist()
    assert at_once.evaluations == singly.evaluations == 1230
    assert at_once.stop_reason == "budget"


class Valley:
    """A rotated quadratic valley of condition 1e4 in twelve variables, with residuals and their Jacobian."""

    def __init__(self) -> None:
        rng = np.random.default_rng(12)
        self._a = np.sqrt(np.geomspace(1, 1e4, 12))[:, None] * np.linalg.qr(rng.normal(size=(12, 12)))[0]
        self._at = rng.uniform(-0.5, 0.5, 12)
        self.lower, self.upper, self.start = np.full(12, -2.0), np.full(12, 2.5), np.full(12, 1.3)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(self._a @ (x - self._at))

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self._a

    def __call__(self, x: np.ndarray) -> float:
        r = self.residuals(x)
        return float(r @ r)


def test_ipopt_remembers_as_many_steps_as_there_are_dimensions() -> None:
    """With Ipopt's own six it crawls here: 1e-9 of the start's value is left when the budget is spent."""
    problem = Valley()
    first = problem(problem.start)

    def left(**options: int) -> float:
        return bench.execute(problem, optimizers.make("pygmo_ipopt", **options), budget=200 * 13).best_value / first

    assert left() == left(memory=12) < 1e-12
    assert left(memory=6) > 1e-11
