"""Joints that a file numbers, and does not name, are those of the arm in their order."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibench.discrepancy.machines.arm.validate import accepted
from calibench.discrepancy.model.measured import DataError, MeasuredData

CHAIN = SimpleNamespace(
    told="URDF",
    driven=("shoulder", "elbow"),
    joints=tuple(
        SimpleNamespace(name=name, kind="rotary", mimic=None, lower=-np.pi, upper=np.pi)
        for name in ("shoulder", "elbow")
    ),
)


def data_of(scale):
    rng = np.random.default_rng(0)
    names = ("A1", "A2", "Tracker X", "Tracker Y", "Tracker Z")
    return MeasuredData({name: scale * rng.uniform(-1, 1, 20) for name in names}, "arm", name="own")


def test_numbered_joints_and_a_trackers_places_are_found():
    given = data_of(1.0)
    found = accepted(given, CHAIN)
    for ours, theirs in {"q_shoulder": "A1", "q_elbow": "A2", "x": "Tracker X", "z": "Tracker Z"}.items():
        np.testing.assert_array_equal(found[ours], given[theirs][1:])  # nobody knows whence the first came
    assert "A1 to A2 are taken for shoulder, elbow, in this order" in map(str, found.notes)


def test_numbered_degrees_are_told_under_the_names_of_the_file():
    with pytest.raises(DataError, match="units=A1:deg,A2:deg"):
        accepted(data_of(100.0), CHAIN)
