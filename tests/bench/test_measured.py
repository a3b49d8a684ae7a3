"""Measured data on disk: what is written is read back to the last bit, and every mistake is a line that names it."""

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st

from calibench.bench.measured.files import read_measured, write_measured
from calibench.bench.measured.sources import sources
from calibench.core.tables.columns import ANY
from calibench.discrepancy import DataError, MeasuredData

METADATA = {"schema_version": 1, "machine": "gpm2002", "sigma_enc": 5e-5, "tooth_numbers": [40, 48, 56]}


def made(**columns):
    base = {
        "t_s": np.array([0.0, 0.1 + 0.2, 1e-17]),
        "pose_id": np.array([3, 1, 2]),
        "split": np.array(["train", "hold", "train"]),
        "enc_1": np.array([1 / 3, -np.pi, np.nan]),
        "valid": np.array([True, False, True]),
    }
    return MeasuredData(base | columns, "gpm2002", METADATA, "made")


def same(one, other):
    assert list(one.columns) == list(other.columns)
    for name, column in one.columns.items():
        assert column.dtype.kind == other[name].dtype.kind, name
        np.testing.assert_array_equal(column, other[name], err_msg=name)


def complaint(path):
    """Return what is wrong with the file, or nothing if it is data."""
    try:
        return "" if len(read_measured(path, "gpm2002")) else "no readings"
    except DataError as error:
        return str(error)


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_what_is_written_is_read_back_to_the_last_bit(tmp_path, ending):
    data = made()
    read = read_measured(write_measured(data, tmp_path / f"made{ending}"), "gpm2002")
    same(data, read)
    assert read.metadata == METADATA
    assert (read.name, read.machine, read.notes) == ("made", "gpm2002", ())


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(), min_size=1, max_size=5), st.sampled_from([".parquet", ".csv"]))
def test_any_float_survives(tmp_path_factory, values, ending):
    data = MeasuredData({"enc_1": np.array(values, dtype=float)}, "gpm2002", METADATA)
    path = tmp_path_factory.mktemp("floats") / f"x{ending}"
    same(data, read_measured(write_measured(data, path)))


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_degrees_that_say_so_become_radians_with_a_note(tmp_path, ending):
    path = tmp_path / f"x{ending}"
    if ending == ".csv":
        path.write_text(f"# measured_data: {json.dumps(METADATA)}\nenc_1 [deg],x [m],dir_1 [1]\n180,0.25,1\n90,1,-1\n")
    else:
        fields = [pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in (("enc_1", "deg"), ("x", "m"))]
        schema = pa.schema(fields, metadata={"measured_data": json.dumps(METADATA)})
        pq.write_table(pa.table([[180.0, 90.0], [0.25, 1.0]], schema=schema), path)
    data = read_measured(path)
    np.testing.assert_allclose(data["enc_1"], [np.pi, np.pi / 2])
    np.testing.assert_allclose(data["x"], [250, 1000])
    assert [note.text for note in data.notes] == [
        "enc_1: stated in deg, turned into rad",
        "x: stated in m, turned into mm",
    ]


def test_a_table_keeps_the_units_of_its_file_and_an_arm_does_not(tmp_path):
    path = tmp_path / "own.csv"
    path.write_text("way [um],turn [deg],force [kp]\n1,2,3\n4,5,6\n")
    kept = read_measured(path, machine="table")
    assert kept["way"].tolist() == [1, 4]
    assert kept["turn"].tolist() == [2, 5]
    assert kept["force"].tolist() == [3, 6]
    assert kept.units["way"] == "um"
    assert not kept.notes
    path.write_text("x [um]\n1000\n2000\n")
    assert read_measured(path, machine="arm")["x"].tolist() == [1, 2]


def test_the_command_line_goes_before_the_first_line_and_that_before_the_file_beside(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text('# measured_data: {"sigma_enc": 2e-5, "machine": "gpm2002"}\nenc_1\n1\n')
    (tmp_path / "x.json").write_text('{"sigma_enc": 1e-5, "sigma_xy": 0.02}')
    data = read_measured(path, "gpm2002", {"encoder_lsb": 1e-6})
    assert (data.metadata["sigma_enc"], data.metadata["sigma_xy"], data.metadata["encoder_lsb"]) == (2e-5, 0.02, 1e-6)
    assert read_measured(path, "gpm2002", {"sigma_enc": 3e-5}).metadata["sigma_enc"] == 3e-5


def test_pandas_own_parquet_is_read(tmp_path):
    frame = pd.DataFrame({"enc_1": [1.0, 2.0], "split": pd.Categorical(["train", "hold"]), "pose_id": [1, None]})
    frame[frame["enc_1"] > 0].to_parquet(tmp_path / "x.parquet")
    data = read_measured(tmp_path / "x.parquet", "gpm2002")
    assert list(data.columns) == ["enc_1", "split", "pose_id"]
    assert data["split"].tolist() == ["train", "hold"]
    assert np.isnan(data["pose_id"][1])


@pytest.mark.parametrize("parted", [",", ";", "\t"])
def test_what_parts_the_cells_is_seen(tmp_path, parted):
    path = tmp_path / "x.csv"
    path.write_bytes(parted.join(("enc_1 [mrad]", "note")).encode("utf-8-sig") + f"\n1e3{parted}warm\n\n".encode())
    data = read_measured(path, "gpm2002")
    assert data["enc_1"].tolist() == [1.0]
    assert data["note"].tolist() == ["warm"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("enc_1,enc_2\n", "a header and no readings"),
        ("enc_1,enc_1\n1,2\n", "column enc_1 is there twice"),
        ("enc_1,enc_2\n1,2\n3\n", "reading 2 has 1 cells, the header 2"),
        ("1,2\n3\n", "reading 2 has 1 cells, the first 2"),
        ("enc_1\n1\nerr\n", "column enc_1, reading 2: 'err' is no number"),
        ('enc_1,enc_2\n"1,5",2\n', "write the decimal point as a point"),
        ("enc_1 [furlong]\n1\n", "unit 'furlong' is unknown; choices: rad, mrad"),
        ("x [rad]\n1\n", "unit 'rad' cannot be turned into mm; write mm, um"),
        ("enc_1 [degre]\n1\n", "did you mean 'deg'?"),
        ("# measured_data: {oops\nenc_1\n1\n", "first line, measured_data: is no JSON"),
        ("# measured_data: []\nenc_1\n1\n", "a JSON object is needed"),
        ('# measured_data: {"schema_version": 9}\nenc_1\n1\n', "schema_version is 9, this version reads 1"),
        ('# measured_data: {"machine": "orthoglide"}\nenc_1\n1\n', "write machine=orthoglide"),
        ('# measured_data: {"machine": "os:system"}\nenc_1\n1\n', "'os:system' is none of arm, delta, gpm2002"),
        ("split [rad]\ntrain\n", "unit rad, and holds no numbers"),
    ],
)
def test_each_mistake_in_a_csv_is_one_line_that_begins_with_the_path(tmp_path, text, said):
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read_measured(path, "gpm2002")
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_parquet_is_one_line(tmp_path):
    path = tmp_path / "x.parquet"
    path.write_bytes(b"PAR1 and then nothing")
    for where, said in ((path, "no Parquet file"), (tmp_path / "y.parquet", "there is no such file")):
        with pytest.raises(DataError, match=said) as caught:
            read_measured(where, "gpm2002")
        assert "\n" not in str(caught.value)
    pq.write_table(pa.table({"enc_1": [[1.0], [2.0]]}), path)
    with pytest.raises(DataError, match="column enc_1"):
        read_measured(path, "gpm2002")


def test_a_glob_a_folder_and_a_name_stand_for_sets(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_measured(made(), tmp_path / folder / "run.csv")
    (tmp_path / "a" / "other.txt").write_text("no data")
    assert [s.case for s in sources(str(tmp_path / "a"), "gpm2002")] == ["run"]
    assert [s.case for s in sources(f"{tmp_path}/*/run.csv", "gpm2002")] == ["a_run", "b_run"]
    assert [s.case for s in sources("exp1,exp2", "orthoglide")] == ["exp1", "exp2"]
    for wrong, said in ((f"{tmp_path}/*.parquet", "matches no"), (str(tmp_path), "holds no"), ("exp9", "did you mean")):
        with pytest.raises(DataError, match=said):
            sources(wrong, "orthoglide")


def test_the_id_of_data_follows_what_stands_in_the_files(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("enc_1\n1\n")
    [source] = sources(str(path), "gpm2002")
    ids = [source.data_id]
    (tmp_path / "x.json").write_text('{"sigma_enc": 1e-5}')
    ids.append(source.data_id)
    path.write_text("enc_1\n2\n")
    ids.append(source.data_id)
    assert len(set(ids)) == 3


def test_every_spelling_of_a_unit_has_a_base_that_is_kept():
    assert ANY.factor("tau_1", "N·m") == ("N mm", 1000.0)
    assert ANY.factor("my_column", "inch") == ("mm", 25.4)
    assert ANY.factor("temp_K", "°C") == ("K", 1.0)


@settings(deadline=None, max_examples=120)
@given(st.one_of(st.binary(max_size=60), st.text(alphabet='enc_1,;[deg] \n\t"#:{}-.0x', max_size=60).map(str.encode)))
def test_whatever_a_csv_holds_it_is_data_or_one_line(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzz.csv"
    path.write_bytes(content)
    said = complaint(path)
    assert said == "" or (said.startswith(f"{path}: ") and "\n" not in said)


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_a_parquet_file_that_was_cut_or_scratched_is_data_or_one_line(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzz.parquet"
    whole = write_measured(made(), path).read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    cut = data.draw(st.booleans())
    path.write_bytes(whole[:at] if cut else whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :])
    said = complaint(path)
    assert said == "" or said.startswith(f"{path}: ")


def test_row_numbers_that_pandas_writes_beside_the_columns_are_no_column(tmp_path):
    (tmp_path / "a.csv").write_text(",enc_1,enc_2\n0,0.5,1.5\n1,0.6,1.4\n")
    assert list(read_measured(tmp_path / "a.csv", "gpm2002").columns) == ["enc_1", "enc_2"]


@pytest.mark.parametrize(
    "kind", [pa.binary(), pa.string_view(), pa.large_string(), pa.dictionary(pa.int8(), pa.string())]
)
def test_words_are_words_in_whatever_way_arrow_keeps_them(tmp_path, kind):
    words = pa.array(["train", "hold", None]).cast(kind)
    pq.write_table(pa.table({"enc_1": [1.0, 2.0, 3.0], "split": words}), tmp_path / "a.parquet")
    assert read_measured(tmp_path / "a.parquet", "gpm2002")["split"].tolist() == ["train", "hold", ""]


def test_hours_of_an_angle_are_fifteen_degrees(tmp_path):
    (tmp_path / "night.csv").write_text("ha [h],t_s [h]\n1.5,2\n-6,3\n")
    data = read_measured(tmp_path / "night.csv", "mount")
    np.testing.assert_allclose(np.degrees(data["ha"]), [22.5, -90])
    assert data["t_s"].tolist() == [7200, 10800]
