"""What an arm carries: its payload is told once, in kg, and gravity is a direction."""

from dataclasses import replace

import numpy as np
import pytest

from calibench.bench.measured import read_measured, shipped_path
from calibench.discrepancy import DataError
from calibench.discrepancy.checks.validate import rows_apart
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.machines.arm.readings import gravity_of, payload_of
from calibench.discrepancy.registries import machines
from calibench.discrepancy.thresholds import thresholds


@pytest.fixture(scope="module")
def data():
    return read_measured(shipped_path("demo_play", "arm"), "arm")


def without_column(data):
    return replace(data, columns={name: column for name, column in data.columns.items() if name != "payload_kg"})


def test_a_payload_is_that_of_the_row_or_that_of_all(data):
    empty = data.with_columns({"payload_kg": np.where(np.arange(len(data)) == 3, np.nan, 2.0)})
    assert payload_of(empty).tolist() == [0.0 if k == 3 else 2.0 for k in range(len(data))]
    stated = replace(without_column(data), metadata={"payload_kg": 1.5}, stated=frozenset({"payload_kg"}))
    assert set(payload_of(stated).tolist()) == {1.5}


def test_a_payload_that_is_told_twice_is_refused(data):
    with pytest.raises(DataError, match="payload_kg="):
        payload_of(replace(data, metadata={"payload_kg": 1.5}, stated=frozenset({"payload_kg"})))


@pytest.mark.parametrize("wrong", [-5.0, np.inf])
def test_a_payload_that_nothing_weighs_is_refused(data, wrong):
    with pytest.raises(DataError, match="payload_kg"):
        payload_of(data.with_columns({"payload_kg": np.full(len(data), wrong)}))


@pytest.mark.parametrize("pull", [[0, 0, np.inf], [0, 0, 0], [1, 2], "down"])
def test_gravity_is_a_finite_direction(data, pull):
    with pytest.raises(DataError, match="three numbers"):
        gravity_of(replace(data, metadata={"gravity": pull}))


def test_no_bearing_leans_further_than_a_drive_may_wind_up(data):
    formulation = machines.make("arm").formulate(data)
    bends = [effect for effect in catalogue(formulation).candidates if effect.family == "bending"]
    assert bends
    for effect in bends:
        lean = effect.shift({}, formulation.data, np.array([effect.largest]))
        assert max(np.max(np.abs(one)) for one in lean.values()) == pytest.approx(thresholds().largest_windup)


def test_a_load_that_is_computed_is_no_misread_cell(data):
    """Of a UR10 the stretched pose alone loads the last joints: it was left out, and with it what told the tool."""
    formulation = machines.make("arm").formulate(data)
    name = sorted(formulation.data.computed)[0]
    load = np.where(np.arange(len(formulation.data)) == 5, 1e9, formulation.data[name])
    far = formulation.data.with_columns({name: load})
    assert not rows_apart(formulation.on(far))[0].any()
    measured = replace(far, computed=frozenset())
    assert np.flatnonzero(rows_apart(formulation.on(measured))[0]).tolist() == [5]
