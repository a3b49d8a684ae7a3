"""What tells two runs apart: every argument, whoever made the problem; and the ids of shipped names stay."""

import functools
import json
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.provenance.run_id import (
    canonical,
    key_of_optimizer,
    key_of_problem,
    name_of,
    options_as_asked,
    options_of,
    plain,
    run_id,
)
from calibench.bench.store.runs import ResultStore
from calibench.core.registry import Registry
from calibench.core.seeds import _BASE, digest, seed_sequence

FROZEN = json.loads((Path(__file__).parent / "frozen_ids.json").read_text())


class Plain:
    def __init__(self, dimension=2, depth: float = 0.0):
        self.lower, self.upper, self.start = -np.ones(dimension), np.ones(dimension), np.full(dimension, 0.5)
        self._far = depth

    def __call__(self, x):
        return float(x @ x) + self._far


class Deep:
    def __init__(self, depth: float):
        self.depth = depth


class Pair:
    def __init__(self, c: tuple[float, ...] = (1.0, 2.0)):
        self.c = c


class Slotted:
    __slots__ = ("lower", "start", "upper")

    def __init__(self, dimension=2):
        self.lower, self.upper, self.start = -np.ones(dimension), np.ones(dimension), np.full(dimension, 0.5)

    def __call__(self, x):
        return float(x @ x)


class Said(Plain):
    """It speaks of one of its parameters alone."""

    options = {"depth": 0.0}  # noqa: RUF012


@dataclass
class Fielded:
    dimension: int = 2
    weights: list[float] = field(default_factory=lambda: [1.0])

    lower = property(lambda self: -np.ones(self.dimension))
    upper = property(lambda self: np.ones(self.dimension))
    start = property(lambda self: np.full(self.dimension, 0.5))

    def __call__(self, x):
        return float(x @ x)


def factory(dimension=2):
    return Plain(dimension)


def simple(dimension=2):
    box = np.ones(dimension)
    return SimpleNamespace(lower=-box, upper=box, start=box / 2)


@pytest.fixture
def registered(monkeypatch):
    """Let the problems be a registry of one's own, with entries of each kind."""
    registry = Registry("problem", "test.none")
    registry.register("plain")(Plain)
    registry.register("partial")(functools.partial(Plain, depth=1.0))
    registry.register("factory")(factory)
    monkeypatch.setattr(problems, "registry", registry)
    return registry


@pytest.mark.parametrize(
    "name",
    ["plain", "partial", "factory", *(f"{__name__}:{n}" for n in ("Plain", "Slotted", "Said", "Fielded", "factory"))],
)
def test_each_argument_tells_runs_apart_whatever_makes_the_problem(registered, name):
    made = [registered.make(name, dimension=n) for n in (2, 5, 10)]
    runs = [bench.execute(p, optimizers.make("de"), budget=2) for p in made]
    assert len({run.run_id for run in runs}) == len({run.row["seed"] for run in runs}) == 3
    assert [json.loads(run.row["problem_options"])["dimension"] for run in runs] == [2, 5, 10]
    assert {run.row["problem"] for run in runs} == {name}


def test_a_thing_without_a_class_of_its_own_is_told_by_its_arguments(registered):
    things = [registered.make(f"{__name__}:simple", dimension=n) for n in (2, 3)]
    assert [options_of(thing) for thing in things] == [{"dimension": 2}, {"dimension": 3}]
    assert {name_of(thing) for thing in things} == {f"{__name__}:simple"}


def test_a_default_that_is_written_out_is_the_same_run_for_a_plain_class(registered):
    for name in ("plain", f"{__name__}:Plain"):
        ids = {key_of_problem(p, name)[1] == {} for p in (registered.make(name), registered.make(name, dimension=2))}
        assert len(ids) == 1


def test_an_object_in_python_is_told_by_its_attributes_named_as_parameters():
    class Seen(Plain):
        def __init__(self, dimension=2, depth=0.0):
            super().__init__(dimension, depth)
            self.dimension, self._depth = dimension, depth

    assert options_of(Seen(3, 1.5)) == {"dimension": 3, "depth": 1.5}


def test_an_object_with_10_where_its_annotation_says_float_is_the_one_with_10_0():
    assert canonical(options_of(Deep(10))) == canonical(options_of(Deep(10.0))) == '{"depth":10.0}'
    ones, floats = Fielded(weights=[1, 2]), Fielded(weights=(1.0, 2.0))
    assert canonical(options_of(ones)) == canonical(options_of(floats))
    assert canonical(options_of(Pair([1, 2]))) == canonical(options_of(Pair(np.array([1, 2])))) == '{"c":[1.0,2.0]}'
    assert options_of(Deep("far")) == {"depth": "far"}  # an attribute may hold what its parameter does not


def test_a_parameter_that_cannot_be_seen_is_told_by_the_box_and_a_stored_row_warns(tmp_path):
    assert options_of(Plain(2)) != options_of(Plain(5))
    store = ResultStore(tmp_path / "mine")
    store.open()
    run = bench.execute(Plain(2), optimizers.make("de"), budget=200)
    with pytest.warns(UserWarning, match=r"depth, dimension"):
        store.write(run)
    store.write(bench.execute(Plain(2), optimizers.make("de"), budget=200, seed=1))  # told once


def test_arguments_are_forgotten_with_the_object(registered):
    made = registered.make("plain", dimension=3)
    assert registered.made(made).arguments == {"dimension": 3, "depth": 0.0}
    del made
    assert not registered._made


def scale_by_two(x):
    return 2 * x


def closing_over(k):
    return lambda x: k * x


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.arange(5), np.arange(6)),
        (np.zeros(1000), np.ones(1000)),
        (np.array(["a", None], dtype=object), np.array(["b", None], dtype=object)),
        (Path("a"), Path("b")),
        ({1, 2}, {1, 3}),
        (1 + 2j, 1 + 3j),
        (b"a", b"b"),
        (scale_by_two, plain),
        (closing_over(1), closing_over(2)),
        (functools.partial(scale_by_two, x=1), functools.partial(scale_by_two, x=2)),
        (SimpleNamespace(a=1), SimpleNamespace(a=2)),
        (Fielded(2), Fielded(3)),
        (np.sin, np.cos),
        ({"a": {"b": SimpleNamespace(a=1)}}, {"a": {"b": SimpleNamespace(a=2)}}),
    ],
)
def test_no_value_vanishes(one, other):
    assert canonical({"": plain(one)}) != canonical({"": plain(other)})
    assert canonical({"": plain(one)}) == canonical({"": plain(one)})


def test_what_cannot_be_told_apart_is_refused_with_the_way_out():
    @dataclass
    class Drawn(Fielded):
        rng: object = None

    with pytest.raises(ValueError, match=r"option rng"):
        bench.execute(Drawn(rng=np.random.default_rng(1)), optimizers.make("de"), budget=5)


@pytest.mark.parametrize("case", FROZEN, ids=lambda case: f"{case['problem'][0]}-{case['optimizer'][0]}")
def test_the_ids_of_shipped_names_stay(case):
    (problem, asked), (optimizer, options) = case["problem"], case["optimizer"]
    one, other = problems.make(problem, **asked), optimizers.make(optimizer, **options)
    keys = key_of_problem(one, problem), key_of_optimizer(other, optimizer)
    assert run_id(*keys, case["budget"], case["repetition"], case["start"], case["target"]) == case["id"]


@pytest.mark.parametrize("words", [(0,), (7, 2**32), (2**64 - 1, 3), (2**63, 0), ("restart", 5)])
def test_a_seed_sequence_is_that_of_its_numbers(words):
    numbers = [word if isinstance(word, int) else int(digest(word), 16) for word in words]
    expected = np.random.SeedSequence([_BASE, *numbers, 4])
    found = seed_sequence(*words, repetition=4)
    np.testing.assert_array_equal(found.generate_state(8), expected.generate_state(8))


class Spoken(Plain):
    """It says its options, but for one that came later and is told only where it was chosen."""

    said_if_chosen = ("shift",)

    def __init__(self, dimension=2, shift: float | None = None):
        super().__init__(dimension)
        self.options = {"dimension": dimension} | ({} if shift is None else {"shift": shift})


def test_an_option_that_came_later_is_told_only_where_it_was_chosen(registered):
    registered.register("spoken")(Spoken)
    assert options_of(registered.make("spoken")) == {"dimension": 2}
    assert options_of(registered.make("spoken", shift=None)) == {"dimension": 2}
    assert options_of(registered.make("spoken", shift=0.5)) == {"dimension": 2, "shift": 0.5}
    assert options_as_asked(registered, "spoken", {}) == {"dimension": 2}


class Scaled:
    """One of its parameters is called `options`, as many a library has it."""

    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

    def __init__(self, gain: float = 1.0, options: dict = {}):  # noqa: B006
        self.gain, self.options = gain, options

    def __call__(self, x):
        return self.gain * float(x @ x)


@pytest.mark.parametrize("inside", [{}, {"gain": 7.0}, {"depth": 2}])
def test_a_parameter_called_options_hides_no_other(registered, inside):
    made = registered.make(f"{__name__}:Scaled", gain=2.0, options=inside)
    assert options_of(made) == {"gain": 2.0, "options": inside}
    assert options_of(registered.make(f"{__name__}:Scaled", options=inside)) == {"gain": 1.0, "options": inside}
    by_hand = [Scaled(gain, {"depth": 2}) for gain in (1.0, 2.0)]
    assert [options_of(one)["gain"] for one in by_hand] == [1.0, 2.0]


class Passing(Deep):
    def __init__(self, **options):
        super().__init__(**options)


class Collecting(Scaled):
    def __init__(self, *parts, **more):
        super().__init__(more.get("gain", 1.0))
        self.more = more


def test_keys_that_are_written_alike_are_refused():
    assert plain({1: "a"}) == {"1": "a"}
    with pytest.raises(ValueError, match="two keys of a mapping that are written alike"):
        plain({1: "a", "1": "b"})


def test_parameters_that_are_handed_on_or_collected_tell_objects_apart():
    assert options_of(Passing(depth=1.0)) == options_of(Deep(1.0)) == {"depth": 1.0}
    ids = {bench.execute(Collecting(gain=k), optimizers.make("de"), budget=2).run_id for k in (1.0, 2.0)}
    assert len(ids) == 2
    assert options_of(SimpleNamespace(lower=0)) == {}


class Growing(Scaled):
    def __init__(self, weights: list = [1.0]):  # noqa: B006
        weights.append(2.0)
        super().__init__(sum(weights))


class Doubling(Scaled):
    def __init__(self, weights: np.ndarray = np.ones(2)):  # noqa: B008
        weights *= 2
        super().__init__(float(weights.sum()))


def test_what_an_object_does_to_its_arguments_changes_no_other_run(registered):
    asked = {"weights": [5.0]}
    made = [registered.make(f"{__name__}:Growing", **asked) for _ in range(2)]
    assert [one.gain for one in made] == [7.0, 7.0]
    assert asked == {"weights": [5.0]}
    assert [options_of(one)["weights"] for one in made] == [[5.0], [5.0]]
    assert [registered.make(f"{__name__}:Growing").gain for _ in range(2)] == [3.0, 3.0]
    assert options_of(registered.make(f"{__name__}:Growing"))["weights"] == [1.0]
    asked = {"weights": np.ones(2)}
    assert [registered.make(f"{__name__}:Doubling", **asked).gain for _ in range(2)] == [4.0, 4.0]
    assert [registered.make(f"{__name__}:Doubling").gain for _ in range(2)] == [4.0, 4.0]
