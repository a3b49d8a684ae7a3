"""Watched numbers tell of every decision that another threshold would change, and of no other."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.thresholds.alternatives import FORKS, answers
from benchmarks.thresholds.watched import Watch
from calibench.discrepancy.model.effect import is_possible

HALF, TWICE = ("limit", 2.0), ("limit", 8.0)
ROW = np.array([1.0, 3.0, 5.0])


def watched() -> tuple[Watch, Any]:
    watch = Watch(lambda key: False)
    return watch, watch.value("limit", 4.0, (2.0, 8.0))


@pytest.mark.parametrize(
    ("decide", "told"),
    [
        (lambda w: w > 1.0, set()),
        (lambda w: 3.0 < w, {HALF}),  # noqa: SIM300
        (lambda w: np.float64(5.0) > w, {TWICE}),
        (lambda w: ROW > w, {HALF, TWICE}),  # noqa: SIM300
        (lambda w: np.full(3, 9.0) > w, set()),
        (lambda w: 2 * w + 1 > 6.0, {HALF}),
        (lambda w: 1 / w < 0.3, {HALF}),
        (lambda w: np.sqrt(w) > 2.5, {TWICE}),
        (lambda w: np.minimum(ROW, w).sum() >= 9.0, {TWICE}),
        (lambda w: int(np.argmax(np.minimum(ROW, w))), {HALF}),
        (lambda w: min(w, 3.0), {HALF}),
        (lambda w: max(w, 9.0), set()),
        (lambda w: list(range(9))[: int(w)], {HALF, TWICE}),
        (lambda w: math.ceil(float(w) / 100), {HALF, TWICE}),
        (lambda w: int(w / 100), set()),
        (lambda w: np.array([1.0, w]), {HALF, TWICE}),
        (lambda w: np.log(w - 3.0) > -1.0, {HALF}),
        (lambda w: cache(lambda one: one)(w), {HALF, TWICE}),
        (lambda w: (ROW + w).T[0] > 4.5, {HALF}),
        (lambda w: f"{w:g}", {HALF, TWICE}),
    ],
)
def test_a_decision_is_told_where_it_would_be_another_one(
    decide: Callable[[Any], object], told: set[tuple[str, float]]
) -> None:
    watch, limit = watched()
    decide(limit)
    assert watch.told == told


def test_numbers_are_those_of_the_plain_value() -> None:
    _, limit = watched()
    assert float(limit * 3 - 1) == 11.0
    assert isinstance(limit > 3.0, bool)
    assert np.array_equal(np.clip(ROW, -limit, limit), np.clip(ROW, -4.0, 4.0))
    assert [one for one in (ROW * limit)] == [4.0, 12.0, 20.0]


def test_two_thresholds_in_one_number_are_told_apart() -> None:
    watch = Watch(lambda key: False)
    one: Any = watch.value("one", 1.0, (0.5,))
    two: Any = watch.value("two", 10.0, (5.0,))
    three: Any = watch.value("three", 1.0, (0.5,))
    assert not one + two < 10.8
    assert watch.told == {("one", 0.5), ("two", 5.0)}
    assert not three * 20.0 + one < 10.0
    assert ("three", 0.5) not in watch.told


def test_nothing_is_told_after_the_end() -> None:
    watch, limit = watched()
    watch.end()
    assert float(limit) == 4.0
    assert not watch.told


def steps(changes: Mapping[str, Any]) -> list[int]:
    """Return which of some numbers lie above a limit, and how many of all are asked: a search in small."""
    limit, most, idle = (changes.get(name, plain) for name, plain in (("limit", 4.0), ("most", 3), ("idle", 1.0)))
    above = [k for k, one in enumerate((3.0, 9.0, 5.0, 1.0, 6.0)) if one > limit]
    return above[: most if len(above) > most else len(above)] if idle < 100.0 else []


@pytest.mark.parametrize("forks", [False, pytest.param(True, marks=pytest.mark.skipif(not FORKS, reason="no fork"))])
def test_answers_are_those_of_searches_from_the_start(forks: bool) -> None:
    plain, others = {"limit": 4.0, "most": 3, "idle": 1.0}, {"limit": (2.0, 8.0), "most": (2, 6), "idle": (0.5, 2.0)}
    found = answers(steps, plain, others, forks=forks)
    assert found.plain == steps({})
    for name, values in others.items():
        for value in values:
            assert found.at(name, value) == steps({name: value})
    assert set(found.others) == {("limit", 2.0), ("limit", 8.0), ("most", 2)}


@pytest.mark.parametrize("forks", [False, pytest.param(True, marks=pytest.mark.skipif(not FORKS, reason="no fork"))])
def test_what_a_search_raises_at_another_value_is_raised(forks: bool) -> None:
    def search(changes: Mapping[str, Any]) -> float:
        if changes.get("limit", 4.0) > 6.0:
            raise ArithmeticError("too far")
        return 0.0

    with pytest.raises(ArithmeticError, match="too far"):
        answers(search, {"limit": 4.0}, {"limit": (2.0, 8.0)}, forks=forks)


def test_an_effect_far_below_its_largest_size_decides_nothing_otherwise() -> None:
    watch, limit = watched()
    assert is_possible(SimpleNamespace(largest=limit), 0.1)  # type: ignore[arg-type]
    assert not watch.told
