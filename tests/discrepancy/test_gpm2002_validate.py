"""Bad input: a clear line or a clear note, and never a confident answer from data that cannot carry one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibench.discrepancy import machines
from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import DataError, MeasuredData, number_visits
from calibench.discrepancy.noise.repeats import pairs_of


def formulate(data: MeasuredData) -> Formulation:
    return machines.make("gpm2002").formulate(data)


def renamed(data: MeasuredData, old: str, new: str) -> MeasuredData:
    return replace(data, columns={new if name == old else name: column for name, column in data.columns.items()})


def stating(data: MeasuredData, **metadata: Any) -> MeasuredData:
    return replace(data, metadata={k: v for k, v in {**data.metadata, **metadata}.items() if v is not None})


def noisy(data: MeasuredData, sigma: float, rng: np.random.Generator) -> MeasuredData:
    read = [name for name in ("enc_1", "enc_2", "enc_3") if name in data]
    return data.with_columns({name: data[name] + sigma * rng.normal(size=len(data)) for name in read})


@pytest.fixture
def data() -> MeasuredData:
    return planned(n=40, tracked=True)


def test_good_data_pass_with_no_more_remarks_than_they_deserve(data: MeasuredData) -> None:
    split = np.where(np.arange(len(data)) % 3 == 0, "hold", "train")
    assert formulate(data.with_columns({"split": split})).data.notes == ()  # type: ignore[dict-item]


ENCODERS = ("enc_1", "enc_2", "enc_3")
STATED = [
    *({"sigma_enc": sigma} for sigma in (0.0, -1e-5, float("nan"), "small", [1e-5])),
    {"tooth_numbers": [40, 48]}, {"tooth_numbers": "40,48,56"}, {"encoder_lsb": [1e-5]}, {"encoder_lsb": "fine"},
    {"fixed_parameters": 3},
]  # fmt: skip


@pytest.mark.parametrize(("said", "spoil"), [
    (r"enc_2 is missing .is enc_2 called Enc(oder)?2", lambda data: renamed(data, "enc_2", "Enc2")),
    ("another machine", lambda _: MeasuredData({"leg": np.arange(5), "deviation": np.zeros(5)}, "gpm2002", {}, "b")),
    ("degrees", lambda data: data.with_columns({name: np.degrees(data[name]) for name in ENCODERS})),
    ("miss each other", lambda data: data.with_columns(
        dict(zip(ENCODERS, np.random.default_rng(0).uniform(-3, 3, (3, len(data))), strict=True)))),
    ("5 different poses", lambda _: planned(n=5, visits=4, repeats=20)),
    ("sigma_enc", lambda _: stating(planned(n=40, repeats=1), sigma_enc=None)),
    ("la7", lambda data: stating(data, nominal={"la7": 244.0})),
    ("zz1", lambda data: stating(data, fixed_parameters=["zz1"])),
    ("la1='long'", lambda data: stating(data, nominal={"la1": "long"})),
    ("names with values", lambda data: stating(data, nominal=[1, 2])),
    *((f"{next(iter(one))}", lambda data, one=one: stating(data, **one)) for one in STATED),
])  # fmt: skip
def test_what_cannot_be_meant_is_refused(data: MeasuredData, said: str, spoil: Any) -> None:
    with pytest.raises(DataError, match=said):
        formulate(spoil(data))


def test_twenty_poses_are_enough() -> None:
    assert len(formulate(planned(n=20)).parameters) == 11


def test_a_misnamed_covariate_is_told_and_not_used(data: MeasuredData) -> None:
    notes = validate(machines.make("gpm2002"), renamed(data, "temp_K", "Temp_k")).data.notes
    assert any("Temp_k" in note.columns and "temp_K" in note.text for note in notes)


def test_a_covariate_with_many_holes_goes_and_the_rows_stay(data: MeasuredData) -> None:
    warm = np.where(np.arange(len(data)) % 3 == 0, np.nan, data["temp_K"])
    closure = formulate(data.with_columns({"temp_K": warm}))
    assert len(closure.data) == len(data)
    assert "temp_K" not in closure.data
    assert any("temp_K" in note.text for note in closure.data.notes)


def test_a_tracker_with_one_coordinate_is_not_used(data: MeasuredData) -> None:
    half = replace(data, columns={name: column for name, column in data.columns.items() if name != "y"})
    closure = formulate(half)
    assert len(closure.parameters) == 11
    assert any("x and y go together" in note.text for note in closure.data.notes)


def test_repeated_time_stamps_are_remarked(data: MeasuredData) -> None:
    notes = formulate(data.with_columns({"t_s": np.floor(data["t_s"] / 60)})).data.notes
    assert any("repeat a time stamp" in note.text for note in notes)


def test_what_no_repeats_and_no_split_cost_is_said() -> None:
    notes = " ".join(map(str, formulate(planned(n=60, repeats=1)).data.notes))
    assert "no repeats" in notes
    assert "cross-validation" in notes


def test_noise_that_is_not_stated_is_taken_from_repeats(data: MeasuredData) -> None:
    rng = np.random.default_rng(1)
    told = formulate(stating(noisy(data, 7e-5, rng), sigma_enc=None))
    assert told.sigma["enc_1"] == pytest.approx(7e-5, rel=0.2)
    assert any("sigma_enc is not stated" in note.text for note in told.data.notes)


def test_a_tracker_of_unknown_noise_is_left_aside() -> None:
    data = stating(planned(n=40, repeats=1, tracked=True), sigma_xy=None)
    closure = formulate(data)
    assert len(closure.parameters) == 11
    assert any("sigma_xy" in note.text for note in closure.data.notes)


def test_a_covariate_that_does_not_vary_is_remarked(data: MeasuredData) -> None:
    notes = formulate(data.with_columns({"temp_K": np.zeros(len(data))})).data.notes
    assert any("temp_K never varies" in note.text for note in notes)


def test_a_hundred_thousand_readings_are_no_matter() -> None:
    data = planned(n=25_000, tracked=True)
    closure = formulate(data)
    assert len(closure.data) == 100_000


def test_visits_numbered_anew_for_each_pose_are_visits_of_their_own(data: MeasuredData) -> None:
    through = np.unique(data["visit_id"])
    again = {v: k for pose in np.unique(data["pose_id"])
             for k, v in enumerate(np.unique(data["visit_id"][data["pose_id"] == pose]))}  # fmt: skip
    anew = data.with_columns({"visit_id": np.array([again[v] for v in data["visit_id"]])})
    assert len(np.unique(anew["visit_id"])) < len(through)
    first, second = pairs_of(formulate(anew).data)
    wanted = pairs_of(formulate(data).data)
    assert sorted(zip(first, second)) == sorted(zip(*wanted))
    words = np.array([f"v{v}" for v in data["visit_id"]])
    assert sorted(zip(*pairs_of(formulate(data.with_columns({"visit_id": words})).data))) == sorted(zip(*wanted))


def test_readings_apart_in_time_are_no_back_to_back_repeats(data: MeasuredData) -> None:
    """One visit number for all rows, or none, must not make repeats of readings that others lie between."""
    wanted = sorted(zip(*pairs_of(formulate(data).data)))
    same = formulate(data.with_columns({"visit_id": np.ones(len(data))})).data
    assert sorted(zip(*pairs_of(same))) == wanted
    nothing = formulate(data.with_columns({"visit_id": np.full(len(data), np.nan)})).data
    assert len(pairs_of(nothing)[0]) == 0


@pytest.mark.parametrize("word", ["-", " N/A", "?", "#NV", "missing", "<NA>", "nan", ""])
def test_rows_whose_cell_names_no_pose_are_no_repeats_of_each_other(data: MeasuredData, word: str) -> None:
    """Noise is learned from repeats: what a file does not name is not one pose read again."""
    poses = np.array([f"P{k % 5}" for k in range(len(data))], dtype="U8")
    poses[::7] = word
    told = number_visits(data.with_columns({"pose_id": poses}))["pose_id"]
    counts = np.unique(told, return_counts=True)[1]
    assert len(counts) == 5 + len(poses[::7])
    assert sorted(np.unique(told[::7], return_counts=True)[1]) == [1] * len(poses[::7])


@pytest.mark.parametrize("teeth", [[40, None, 56], 48, {"1": 40}, []])
def test_teeth_may_be_stated_of_some_joints_only(data: MeasuredData, teeth: Any) -> None:
    formulate(stating(data, tooth_numbers=teeth))
