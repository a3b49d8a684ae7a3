"""Calls into compiled kernels: any array gives the same bits, what cannot be taken is one line, other errors pass."""

from __future__ import annotations

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calibench import problems
from calibench.problems.base import Parameter
from calibench.problems.compiled_problem import hold

ALL = [
    ("full12", {"error": "J2"}),
    ("full12", {"error": "J3"}),
    ("tracking_zero", {}),
    ("orthoglide6", {}),
    ("delta9", {}),
    ("arm_ur10", {}),
    ("arm_panda", {}),
]


@pytest.mark.parametrize(("name", "options"), ALL)
def test_any_array_of_the_right_numbers_gives_the_same_bits(name, options):
    problem = problems.make(name, **options)
    x = problem.start
    points = problem.lower + np.random.default_rng(0).random((5, len(x))) * (problem.upper - problem.lower)
    for given in (x.tolist(), x.copy(), np.repeat(x, 2)[::2], x.astype(object)):
        assert problem(given) == problem(x)
    for given in (points.tolist(), np.asfortranarray(points), np.repeat(points, 2, axis=0)[::2]):
        assert problem.batch(given).tobytes() == problem.batch(points).tobytes()
    with pytest.raises(ValueError, match=rf"^{name}: x has shape \(1,\), \({len(x)},\) is needed$"):
        problem([0.0])
    with pytest.raises(ValueError, match=rf"^{name}: points have shape \({len(x)},\), \(k, {len(x)}\) is needed$"):
        problem.batch(x)


@pytest.mark.parametrize(("name", "options"), ALL)
def test_a_problem_goes_to_another_process_and_back(name, options):
    problem = problems.make(name, **options)
    there = pickle.loads(pickle.dumps(problem))
    assert (there(problem.start), there.data_id) == (problem(problem.start), problem.data_id)


@pytest.mark.parametrize("readonly", [(False, True), (True, False), (True, True)])
def test_limits_and_points_may_be_writable_or_not(readonly):
    problem = problems.make("full12")
    points, limits = problem.start[None] + np.linspace(0, 1e-3, 6)[:, None], np.full(6, np.inf)
    wanted = problem.batch_below(points, limits)
    points.flags.writeable, limits.flags.writeable = not readonly[0], not readonly[1]
    assert problem.batch_below(points, limits).tobytes() == wanted.tobytes() == problem.batch(points).tobytes()


def test_an_error_that_is_no_refusal_passes_and_is_not_asked_again():
    problem, asked = problems.make("full12"), []

    def broken(*arrays):
        asked.append(arrays)
        raise MemoryError("no room")

    problem._exact.cost = problem._exact.batch = broken
    for call in (lambda: problem(problem.start), lambda: problem.batch(problem.start[None])):
        with pytest.raises(MemoryError, match="no room"):
            call()
    assert len(asked) == 2


def test_a_changed_problem_has_the_kernels_arrays_of_its_own_readings():
    problem = problems.make("full12")
    other = replace(problem, readings=problem.readings + 1e-3)
    assert problem(problem.truth) < 1e-15 < other(problem.truth)


def test_box_start_and_truth_are_arrays_that_nobody_can_write_to():
    known = Parameter("a", "mm", 1.0, 0.0, 2.0, 1.5)
    one, other = (SimpleNamespace(name="some") for _ in range(2))
    hold(one, (known, known), None, (), data=b"")
    compiled = one._compiled
    for array in (compiled.lower, compiled.upper, compiled.start, compiled.truth):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 9.0
    hold(other, (known, replace(known, true=None)), None, (), data=b"")
    assert other._compiled.truth is None
