"""Rows with empty cells that are needed are left out and told; a column that is mostly empty is refused."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.measured import read_measured, shipped_path
from calibench.discrepancy import DataError, MeasuredData
from calibench.discrepancy.machines.delta.formulation import accepted as of_a_printer
from calibench.discrepancy.machines.mount.formulation import accepted as of_a_mount

WAYS = ("travel_a", "travel_b", "travel_c")


def night():
    data = read_measured(shipped_path("demo_flexure", "mount"), "mount")
    return data, "star_dec", lambda spoilt: of_a_mount(spoilt)[0]


def printer():
    rng = np.random.default_rng(0)
    ways = {name: rng.uniform(95.0, 105.0, 40) for name in WAYS}
    ways |= {f"{name}_2": np.where(np.arange(40) < 30, np.nan, 100.0) for name in WAYS}
    measured = {
        "height": np.where(np.arange(40) < 30, 0.1, np.nan),
        "distance": np.where(np.arange(40) < 30, np.nan, 9),
    }
    kind = np.where(np.arange(40) < 30, "height", "distance")
    stated = {"nominal": {"radius": 160, "arm": 340, "endstop": 400}}
    return MeasuredData({"kind": kind, **measured, **ways}, "delta", stated, "heights"), "height", of_a_printer


def planar():
    data = read_measured(shipped_path("demo_backlash", "gpm2002"), "gpm2002")
    return data, "enc_2", lambda spoilt: discrepancy.machines.make("gpm2002").formulate(spoilt).data


@pytest.mark.parametrize("made", [night, printer, planar])
def test_a_row_without_a_number_that_is_needed_is_left_out_and_told(made):
    data, name, accepted = made()
    whole = accepted(data)
    assert not [note for note in whole.notes if "left out" in note.text]
    spoilt = data.with_columns({name: np.where(np.arange(len(data)) % 10 == 3, np.nan, data[name])})
    lost = int(np.isnan(spoilt[name][: 30 if made is printer else None]).sum())
    left = accepted(spoilt)
    assert len(left) == len(whole) - lost
    assert f"{lost} rows are left out for cells that hold no finite number: {name} in {lost}" in map(str, left.notes)


@pytest.mark.parametrize("made", [night, printer, planar])
def test_a_column_that_is_empty_in_most_rows_is_refused(made):
    data, name, accepted = made()
    spoilt = data.with_columns({name: np.where(np.arange(len(data)) % 10 < 6, np.nan, data[name])})
    with pytest.raises(DataError, match=f"column {name} "):
        accepted(spoilt)


def test_a_missing_column_is_told_among_those_that_the_file_has():
    for made, name in ((night, "star_dec"), (planar, "enc_2")):
        data, _, accepted = made()
        columns = {known: column for known, column in data.columns.items() if known != name}
        short = MeasuredData({**columns, "reading_place": np.arange(len(data))}, data.machine, data.metadata, "run")
        with pytest.raises(DataError, match=name) as told:
            accepted(short)
        assert "reading_place" not in str(told.value)
        assert "nothing like it" not in str(told.value)
