"""Laws that hold for every plan of every machine: what `bench design` tells before anything is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench.core.options import declared_options
from calibench.discrepancy.checks.wild import wild_rows
from calibench.discrepancy.design.detectability import design
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import description_of, descriptions, machines
from tests.few import few

_SMALLER = {"gpm2002": {"n": 24, "radius": 80.0}}  # fewer places than by default, and all within reach
PLANS = [
    (machine, plan)
    for machine in sorted(descriptions())
    if description_of(machine).plan
    for plan in declared_options(description_of(machine).plan)["plan"].type.__args__  # type: ignore[arg-type]
]


def planned(machine: str, plan: str) -> MeasuredData:
    make = description_of(machine).plan
    assert make is not None
    return make(plan, **_SMALLER.get(machine, {}))


def sizes(machine: str, data: MeasuredData) -> dict[str, float]:
    return {sight.effect: sight.minimum_detectable for sight in design(machine, data).candidates}


def _first_of_each(plans: list[tuple[str, str]]) -> list[object]:
    """Return the plans, of which only the first of each machine is for the fast suite."""
    machine_before = [machine for machine, _ in plans]
    return [
        pytest.param(*one, marks=[pytest.mark.slow] if one[0] in machine_before[:k] else [])
        for k, one in enumerate(plans)
    ]


@pytest.mark.parametrize(("machine", "plan"), few(2, _first_of_each(PLANS)))
def test_every_plan_obeys_noise_and_numbers(machine: str, plan: str) -> None:
    """Noise twice as large doubles each smallest size, four times the rows halve it, and their order is nothing."""
    data = planned(machine, plan)
    once = sizes(machine, data)
    seen = [name for name, size in once.items() if np.isfinite(size)]
    assert seen
    noisy = {key: 2 * value for key, value in data.metadata.items() if key.startswith("sigma")}
    assert noisy
    order = np.random.default_rng(1).permutation(np.repeat(np.arange(len(data)), 4))
    doubled = sizes(machine, replace(data, metadata={**data.metadata, **noisy}))
    repeated = sizes(machine, data.rows(order))
    assert list(doubled) == list(repeated) == list(once)
    for name, size in once.items():
        if np.isfinite(size):
            assert doubled[name] == pytest.approx(2 * size, rel=1e-6), name
            assert repeated[name] == pytest.approx(size / 2, rel=0.02), name
        else:
            assert not np.isfinite(doubled[name]), name
            assert not np.isfinite(repeated[name]), name


def test_heights_that_are_all_zero_do_not_hide_one_that_is_wild() -> None:
    """Shuffled zeros are the same zeros; a height that is far off is told all the same."""
    data = planned("delta", "rich")
    assert not wild_rows(machines.make("delta").formulate(data)).any()
    height = np.array(data["height"])
    height[4] = 30.0
    far = wild_rows(machines.make("delta").formulate(data.with_columns({"height": height})))
    assert list(np.flatnonzero(far)) == [4]
    height[:12] = 30.0
    with pytest.raises(DataError, match="rows lie more than"):
        wild_rows(machines.make("delta").formulate(data.with_columns({"height": height})))
