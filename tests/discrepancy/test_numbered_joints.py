"""Joints that a file numbers, and does not name, are those of the arm in their order."""

from pathlib import Path

import numpy as np
import pytest

from calibench.calibration import Arm, parse_urdf
from calibench.core.notes import Code
from calibench.discrepancy.machines.arm.readings import accepted
from calibench.discrepancy.model.measured import DataError, MeasuredData
from tests.bench.arm_by_hand import NAMES, measured, urdf

ARM = Arm(Path("my.urdf"), parse_urdf(urdf()).chain())
NUMBERED = tuple(f"A{k}" for k in range(1, 7))


def data_of(scale):
    q, seen, _ = measured(20)
    names = (*NUMBERED, "Tracker X", "Tracker Y", "Tracker Z")
    return MeasuredData(dict(zip(names, np.column_stack([scale * q, seen]).T, strict=True)), "arm", name="own")


def test_numbered_joints_and_a_trackers_places_are_found():
    given = data_of(1.0)
    found, _ = accepted(given, ARM)
    for ours, theirs in {"q_joint_1": "A1", "q_joint_2": "A2", "x": "Tracker X", "z": "Tracker Z"}.items():
        np.testing.assert_array_equal(found[ours], given[theirs][1:])  # nobody knows whence the first came
    assert f"A1 to A6 are taken for {', '.join(NAMES)}, in this order" in map(str, found.notes)


def test_numbered_degrees_are_told_under_the_names_of_the_file():
    with pytest.raises(DataError, match=f"units={','.join(f'{name}:deg' for name in NUMBERED)}"):
        accepted(data_of(180 / np.pi), ARM)


def test_only_columns_that_nothing_reads_are_told_as_unread():
    given = data_of(1.0)
    found, _ = accepted(given.with_columns({"A3_dir": np.ones(20), "direction_joint_3": np.ones(20)}), ARM)
    assert [n.columns for n in found.notes if n.code is Code.COLUMNS_UNREAD] == [("A3_dir",)]
