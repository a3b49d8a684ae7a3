"""A table is in the units of its file: what the door says of numbers far off speaks of no other unit."""

import numpy as np
import pytest

from calibench.discrepancy import DataError, MeasuredData, explain
from calibench.discrepancy.machines.table import Table


def spring(shift=0.0, factor=1.0):
    rng = np.random.default_rng(0)
    force = rng.uniform(-1, 1, 120)
    way = force / 1.9 + 0.01 * rng.standard_normal(120)
    columns = {"force": force + shift, "way": factor * way}
    return MeasuredData(columns, "table", {}, "spring")


def said(data):
    machine = Table("exponential", "way", ("force",), sigma=0.01, start={"b0": -1.0, "b1": 1.0, "b2": 0.5})
    with pytest.raises(DataError) as told:
        explain(machine, data)
    return str(told.value)


def test_a_column_of_another_unit_is_told_without_advice_that_a_table_does_not_take():
    line = said(spring(factor=1000.0))
    assert "if way is multiplied by 0.001: file and model are in units that differ by this factor" in line
    assert "units=" not in line


def test_a_column_without_a_unit_is_not_shifted_by_radians():
    line = said(spring(shift=2.5))
    assert "is added to force: its zero is that far off" in line
    assert "rad" not in line


@pytest.mark.parametrize("sigma", ["nan", "weight"])
def test_noise_that_is_no_number_and_no_column_is_told_as_the_option_it_is(sigma):
    machine = Table("line", "way", ("force",), sigma=sigma)
    with pytest.raises(DataError, match=f"machine.sigma={sigma}: .*force, way"):
        explain(machine, spring())
