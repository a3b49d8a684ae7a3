"""`pso` as Cong et al. 2008 state it: equation (45), the border, the inertia, the renewal."""

from __future__ import annotations

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.optimizers.own import _swarm_kernels as step
from calibench.optimizers.own._random_kernels import halves, random_state


class Told:
    """The unit box of `dim` dimensions, valued by a function of the number of the batch; keeps all batches."""

    def __init__(self, value=lambda batch: 1.0, dim=3):
        self.lower, self.upper, self.start = np.zeros(dim), np.ones(dim), np.zeros(dim)
        self.batches, self._value = [], value

    def __call__(self, x):
        raise AssertionError("it asks in batches")

    def batch(self, points):
        self.batches.append(points.copy())
        return np.full(len(points), self._value(len(self.batches)))


def flights(told, iterations, **options):
    """Return the positions, shape (iterations, 8, dim), of a swarm of eight."""
    bench.execute(told, optimizers.make("pso", population=8, **options), budget=8 * iterations, seed=5)
    return np.array(told.batches)


STILL = {"C1": 0.0, "C2": 0.0, "w_first": 0.0, "w_last": 0.0}  # then only a renewal moves a particle


def test_defaults_are_the_paper_s():
    pso = optimizers.make("pso")
    assert (pso.population, pso.C1, pso.C2, pso.w_first, pso.w_last, pso.NR) == (100, 2, 2, 0.9, 0.1, 50)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"population": 1}, "pso.population=1: "),
        ({"C1": -1}, "pso.C1=-1: "),
        ({"C2": -0.5}, "pso.C2=-0.5: "),
        ({"w_first": 1.1}, "pso.w_first=1.1: "),
        ({"w_last": -0.1}, "pso.w_last=-0.1: "),
        ({"NR": 0}, "pso.NR=0: "),
        ({"w_iterations": 0}, "pso.w_iterations=0: "),
        ({"velocity_limit": 0}, "pso.velocity_limit=0: "),
        ({"border": "bounce"}, "pso.border=bounce: "),
        ({"C1": float("nan")}, "pso.C1=nan: "),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        optimizers.make("pso", **options)
    with pytest.raises(ValueError, match=f"^{message}"):
        type(optimizers.make("pso"))(**options)  # not through the registry


@pytest.mark.parametrize("by_component", [True, False])
@pytest.mark.parametrize("limit", [np.inf, 0.2])
@pytest.mark.parametrize("stop_at_border", [True, False])
def test_flight_is_equation_45(by_component, limit, stop_at_border):
    rng = np.random.default_rng(11)
    size, dim, w, c1, c2, best = 40, 3, 0.7, 2.0, 1.5, 4
    lower, upper = np.array([-1.0, 0.0, 10.0]), np.array([1.0, 5.0, 10.5])
    x, p = rng.uniform(lower, upper, (size, dim)), rng.uniform(lower, upper, (size, dim))
    v = rng.uniform(-1, 1, (size, dim)) * (upper - lower)
    state = random_state(rng)
    twin_state, position, velocity = state.copy(), x.copy(), v.copy()
    fastest = limit * (upper - lower)
    every = [np.tile(row, (size, 1)) for row in (p[best], fastest, lower, upper)]
    step.fly(position, velocity, p, every[0], w, c1, c2, by_component, every[1], stop_at_border, *every[2:], state)

    drawn = 2 * size * (dim if by_component else 1)
    r1, r2 = (halves(twin_state, drawn)[:drawn] / 2**32).reshape(2, size, -1)
    v = w * v + c1 * r1 * (p - x) + c2 * r2 * (p[best] - x)
    v = np.clip(v, -fastest, fastest)
    free = x + v
    x = np.clip(free, lower, upper)
    outside = x != free
    assert 5 < outside.sum() < size * dim - 5
    np.testing.assert_allclose(position, x, rtol=1e-13)
    np.testing.assert_allclose(velocity, np.where(outside & stop_at_border, 0.0, v), rtol=1e-12, atol=1e-14)


def test_own_best_and_swarm_s_best_stay_on_a_tie():
    position = np.array([[1.0], [2.0], [3.0], [4.0]])
    own_best, own_values = np.zeros((4, 1)), np.array([5.0, 1.0, 2.0, 7.0])
    best = step.record(position, np.array([5.0, 3.0, 1.0, 6.0]), own_best, own_values, 1)
    assert own_best[:, 0].tolist() == [0, 0, 3, 4]
    assert own_values.tolist() == [5, 1, 1, 6]
    assert best == 1
    assert step.record(position, np.array([9.0, 9.0, 9.0, 0.5]), own_best, own_values, best) == 3


def test_inertia_falls_linearly_over_the_run():
    told = Told()
    # a tiny limit keeps all inside; without attraction each step is w times the one before
    x = flights(told, 11, C1=0, C2=0, NR=99, velocity_limit=1e-5)
    steps = np.diff(x, axis=0)
    inside = ((x > 0.01) & (x < 0.99)).all(axis=0)
    assert inside.sum() > 10
    ratios = (steps[1:] / steps[:-1])[:, inside]
    expected = np.linspace(0.9, 0.1, 10)[1:, None]  # the first flight has .9, its step is cut to the limit
    np.testing.assert_allclose(ratios, np.broadcast_to(expected, ratios.shape), rtol=1e-5)


def test_inertia_falls_over_the_iterations_told_and_stays():
    x = flights(Told(), 9, C1=0, C2=0, NR=99, velocity_limit=1e-5, w_iterations=5)
    steps = np.diff(x, axis=0)
    inside = ((x > 0.01) & (x < 0.99)).all(axis=0)
    ratios = (steps[1:] / steps[:-1])[:, inside]
    expected = np.array([0.7, 0.5, 0.3, *[0.1] * 4])[:, None]
    np.testing.assert_allclose(ratios, np.broadcast_to(expected, ratios.shape), rtol=1e-4)


def test_inertia_begins_and_ends_as_told():
    assert [step.inertia(0.9, 0.1, 0, flights) for flights in (9999, 1, 0)] == [0.9, 0.9, 0.9]
    assert step.inertia(0.9, 0.1, 9998, 9999) == pytest.approx(0.1)
    assert step.inertia(0.9, 0.1, 4999, 9999) == pytest.approx(0.5)


@pytest.mark.parametrize("renewal", ["random", "worst"])
def test_half_begin_again_after_NR_still_iterations_and_the_best_stays(renewal):
    x = flights(Told(), 20, NR=4, renewal=renewal, **STILL)
    moved = (np.diff(x, axis=0) != 0).any(axis=2)  # (19, 8)
    # batch 1 is the record; 2-5 are still; 6 is renewed and still, and so are 7-9; 10 is renewed ...
    assert np.flatnonzero(moved.any(axis=1)).tolist() == [4, 8, 12, 16]
    assert (moved.sum(axis=1)[4::4] == 4).all()
    assert not moved[:, 0].any()  # G_best is the first of equals


def test_an_improvement_begins_the_count_anew():
    x = flights(Told(lambda batch: 1.0 if batch < 4 else 0.5), 12, NR=4, **STILL)
    assert np.flatnonzero((np.diff(x, axis=0) != 0).any(axis=(1, 2))).tolist() == [7]  # batch 4 is the record


def test_any_own_best_may_count_as_the_improvement():
    class Slow(Told):
        """The best is the first sample's; the last particle alone gets better, until batch 6."""

        def batch(self, points):
            super().batch(points)
            values = np.full(len(points), 5.0)
            values[0], values[-1] = 1.0, 4.0 - 0.1 * min(len(self.batches), 6)
            return values

    for improvement, first in (("best", 4), ("any", 9)):
        x = flights(Slow(), 12, NR=4, improvement=improvement, **STILL)
        assert np.flatnonzero((np.diff(x, axis=0) != 0).any(axis=(1, 2)))[0] == first


@pytest.mark.parametrize("forgets", [True, False])
def test_who_begins_again_forgets_its_best_or_returns_to_it(forgets):
    x = flights(Told(), 7, NR=4, renewal_forgets=forgets, **(STILL | {"C1": 1.0}))
    renewed = (x[5] != x[4]).any(axis=1)
    assert renewed.sum() == 4
    if forgets:
        assert (x[6] == x[5]).all()
    else:
        back = (x[6] - x[5])[renewed] / (x[0] - x[5])[renewed]  # R1
        assert ((back > 0) & (back < 1)).all()


def test_velocity_at_first_is_random_or_zero():
    options = {"C1": 0.0, "C2": 0.0, "w_first": 1.0, "w_last": 1.0}
    x = flights(Told(dim=50), 2, initial_velocity="random", **options)
    v = np.diff(x, axis=0)[0]
    unclipped = v[(x[1] > 0) & (x[1] < 1)]
    assert unclipped.min() < -0.5 < 0.5 < unclipped.max()
    # from a uniform place with a uniform velocity of up to a width each way, half the components reach the border
    assert len(unclipped) / v.size == pytest.approx(0.5, abs=0.08)
    x = flights(Told(), 3, initial_velocity="zero", **options)
    assert (x == x[0]).all()


def test_velocity_limit_is_a_share_of_the_width():
    x = flights(Told(), 10, velocity_limit=0.05)
    assert np.abs(np.diff(x, axis=0)).max() == pytest.approx(0.05)
