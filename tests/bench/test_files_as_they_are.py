"""Files of measured data as they lie on disk: Excel, MATLAB, and the tables that instruments and offices write."""

import contextlib
import datetime
import io
import json
import os
import re
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from calibench.bench.cli import main
from calibench.bench.measured import read_measured, shipped_path, write_measured
from calibench.core.tables import csv_table, data_file
from calibench.discrepancy import DataError

GIVEN = Path(os.environ.get("CALIBENCH_DATA", Path(__file__).parents[3] / "shared" / "data"))
given = pytest.mark.skipif(
    not GIVEN.is_dir(), reason=f"no measured data at {GIVEN}; CALIBENCH_DATA names a folder that has them"
)


def said(*words):
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
        try:
            main(words)
        except SystemExit as ended:
            return ended.code, told.getvalue()
    return 0, told.getvalue()


def book(path, *rows, more=()):
    made = openpyxl.Workbook()
    for row in rows:
        made.active.append(row)
    for title in more:
        made.create_sheet(title).append(["a remark"])
    made.save(path)
    return path


def test_a_sheet_of_excel_is_a_table(tmp_path):
    noon = datetime.datetime(2026, 3, 1, 12)
    rows = [[1.5, noon, "train", 3], [2.5, noon + datetime.timedelta(seconds=2.5), "hold", None]]
    path = book(
        tmp_path / "run.xlsx", ["Run of March"], [], ["enc_1 [deg]", "t_s", "split", "x"], *rows, more=["notes"]
    )
    data = read_measured(path, "two_link")
    np.testing.assert_allclose(data["enc_1"], np.deg2rad([1.5, 2.5]))
    assert data["t_s"].tolist() == [0.0, 2.5]
    assert data["split"].tolist() == ["train", "hold"]
    np.testing.assert_array_equal(data["x"], [3.0, np.nan])
    assert "sheet Sheet is read, and not notes" in map(str, data.notes)


def test_a_long_sheet_is_read_to_its_end(tmp_path):
    rows = [[0.1 * k, 0.2, 0.3, *[""] * (k == 7)] for k in range(2500)]
    data = read_measured(book(tmp_path / "run.xlsx", ["enc_1", "enc_2", "enc_3"], *rows), "gpm2002")
    assert len(data) == 2500
    assert data["enc_1"][-1] == pytest.approx(249.9)


def test_a_sheet_tells_of_a_header_that_comes_again_as_text_does(tmp_path):
    rows = [["enc_1", "x"], [1.5, 2], ["enc_1", "x"], [2.5, None]]
    sheet = read_measured(book(tmp_path / "run.xlsx", *rows), "two_link")
    (tmp_path / "run.csv").write_text("enc_1,x\n1.5,2\nenc_1,x\n2.5,\n")
    text = read_measured(tmp_path / "run.csv", "two_link")
    assert "the header comes again in line 3 and is left out there" in map(str, sheet.notes)
    assert text.notes == sheet.notes


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: path.write_bytes(b"enc_1\n1\n"), "is no Excel file that can be read .*save it as CSV"),
        (lambda path: book(path), "the sheets are empty"),
        (lambda path: book(path, ["enc_1", "enc_1"], [1, 2]), "column enc_1 is there twice"),
        (lambda path: book(path, ["c"] * 2500, [1] * 2500), "columns, and at most 2000 are read"),
        (lambda path: os.mkfifo(path), "is a pipe, and a file is needed"),
        (lambda path: os.symlink("/dev/zero", path), "is a device, and a file is needed"),
        (lambda path: path.mkdir(), "is a folder, and a file is needed"),
    ],
)
def test_what_is_no_sheet_is_one_line(make, said, tmp_path):
    path = tmp_path / "run.xlsx"
    make(path)
    with pytest.raises(DataError, match=said) as caught:
        read_measured(path, "two_link")
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_sheet_that_unpacks_to_too_much_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(csv_table, "_LARGEST_UNPACKED", 1_000_000)
    path = tmp_path / "run.xlsx"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("xl/worksheets/sheet1.xml", b" " * 3_000_000)
    with pytest.raises(DataError, match="3 MB"):
        read_measured(path, "two_link")


def test_a_sheet_of_zeros_is_told_by_how_much_it_is_packed(tmp_path):
    path = tmp_path / "run.xlsx"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("xl/sharedStrings.xml", bytes(11_000_000))
    with pytest.raises(DataError, match=r"unpacks to \d+ times"):
        read_measured(path, "two_link")


@pytest.mark.parametrize(
    "variables",
    [
        {"enc_1": np.arange(3.0), "x": np.arange(3.0)[:, None], "operator": "Anna"},
        {"run": {"enc_1": np.arange(3.0), "x": np.arange(3.0)}},
        {"data": np.stack([np.arange(3.0)] * 2, axis=1), "names": np.array(["enc_1 [rad]", "x"], dtype=object)},
        {"data": np.stack([np.arange(3.0)] * 2, axis=1), "names": np.array(["enc_1", "x"])},
    ],
    ids=["vectors", "struct", "cell", "char"],
)
def test_variables_of_matlab_are_columns(variables, tmp_path):
    savemat(tmp_path / "run.mat", variables)
    data = read_measured(tmp_path / "run.mat", "two_link")
    assert list(data.columns) == ["enc_1", "x"]
    assert data["enc_1"].tolist() == data["x"].tolist() == [0.0, 1.0, 2.0]


def test_a_matrix_without_names_takes_those_of_its_owner(tmp_path):
    savemat(tmp_path / "run.mat", {"M": np.arange(6.0).reshape(3, 2)})
    data = read_measured(tmp_path / "run.mat", "two_link", columns={"enc_1": "column_2"})
    assert data["enc_1"].tolist() == [1.0, 3.0, 5.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"junk", "is no MATLAB file that can be read"),
        (b"MATLAB 7.3 MAT-file, Platform", "version 7.3, which is HDF5; save it with"),
    ],
)
def test_what_is_no_matlab_file_is_one_line(content, said, tmp_path):
    path = tmp_path / "run.mat"
    path.write_bytes(content)
    with pytest.raises(DataError, match=said) as caught:
        read_measured(path, "two_link")
    assert "\n" not in str(caught.value)


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def array(of, shape, inside):
    """Return an array of MATLAB's class `of` (1 cell, 6 double), whose content may not fit its shape."""
    sides = struct.pack(f"<{len(shape)}i", *shape)
    return element(14, element(6, struct.pack("<II", of, 0)) + element(5, sides) + element(1, b"x") + inside)


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (array(6, (20_000, 1000), element(9, bytes(32))), "has 20000000 numbers, and at most"),
        (array(6, (4, 1), element(9, bytes(32)) * 9), "is no MATLAB file that can be read"),
        (array(1, (1, 1), array(1, (3000, 1), b"")), "is no MATLAB file that can be read"),
        (array(6, (1,) * 100, element(9, bytes(8))), "is no MATLAB file that can be read"),
    ],
)
def test_a_matlab_file_that_states_what_it_does_not_hold_is_refused_in_a_line(inside, said, tmp_path):
    squeezed = zlib.compress(inside, level=1)
    path = tmp_path / "run.mat"
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\0\1IM" + struct.pack("<II", 15, len(squeezed)) + squeezed)
    with pytest.raises(DataError, match=said) as caught:
        read_measured(path, "gpm2002")
    assert "\n" not in str(caught.value)


def test_a_variable_that_is_there_twice_is_told(tmp_path):
    savemat(tmp_path / "run.mat", {"enc_1": np.arange(3.0)})
    content = (tmp_path / "run.mat").read_bytes()
    (tmp_path / "run.mat").write_bytes(content + content[128:])
    with pytest.raises(DataError, match="enc_1 is there twice"):
        read_measured(tmp_path / "run.mat", "gpm2002")


def test_a_matlab_file_of_too_many_numbers_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(data_file, "MOST_NUMBERS", 100)
    savemat(tmp_path / "run.mat", {"x": np.zeros(200)}, do_compression=True)
    savemat(tmp_path / "struct.mat", {"run": {"x": np.zeros(150), "y": np.zeros(150)}})
    for file, count in (("run.mat", 200), ("struct.mat", 300)):
        with pytest.raises(DataError, match=f"{count} numbers"):
            read_measured(tmp_path / file, "two_link")
    savemat(tmp_path / "text.mat", {"x": np.array([1.0, 2.0]), "text": "hello"})
    monkeypatch.setattr(data_file, "LARGEST_TEXT", 10)
    with pytest.raises(DataError, match="1e-05 MB"):
        read_measured(tmp_path / "text.mat", "two_link")


def test_a_table_without_a_header_takes_the_names_of_its_owner(tmp_path):
    (tmp_path / "bare.csv").write_text("1.5,2\n2.5,3\n")
    data = read_measured(tmp_path / "bare.csv", "two_link", columns={"enc_1": "column_1"})
    assert data["enc_1"].tolist() == [1.5, 2.5]
    assert [str(note) for note in data.notes] == [
        "no header: columns are called column_1 to column_2; columns= names them"
    ]


def test_a_row_of_units_beneath_the_header_is_no_reading(tmp_path):
    (tmp_path / "units.csv").write_text("enc_1;x\n[deg];[mm]\n90;2,5\n180;3,5\n")
    data = read_measured(tmp_path / "units.csv", "two_link")
    np.testing.assert_allclose(data["enc_1"], [np.pi / 2, np.pi])
    assert data["x"].tolist() == [2.5, 3.5]


@pytest.mark.parametrize("row", ["1,1", "1,-", "1,"])
def test_a_first_row_of_ones_is_a_reading(tmp_path, row):
    (tmp_path / "ones.csv").write_text(f"repeat,way\n{row}\n2,3\n")
    data = read_measured(tmp_path / "ones.csv", "table")
    assert data["repeat"].tolist() == [1, 2]
    assert dict(data.units) == {}
    (tmp_path / "units.csv").write_text("repeat,way\n1,mm\n1,3\n")
    assert read_measured(tmp_path / "units.csv", "table").units["way"] == "mm"


@pytest.mark.parametrize("cells", [("1,234.5", "2,345.5"), ("1.0D+05", "2.0D+05"), ("1_000", "2_000"), ("1%", "2%")])
def test_a_column_that_is_words_and_looks_like_numbers_is_told(cells, tmp_path):
    (tmp_path / "run.csv").write_text(f'u,y\n"{cells[0]}",2\n"{cells[1]}",3\n')
    data = read_measured(tmp_path / "run.csv", "table")
    assert data["u"].tolist() == list(cells)
    assert [str(note) for note in data.notes] == [f"column u is read as words: {cells[0]!r} is no number"]


def test_the_minus_of_typography_is_a_minus(tmp_path):
    (tmp_path / "run.csv").write_text("u,y\n\u22121.5,2\n\u22122,3\n", encoding="utf-8")
    assert read_measured(tmp_path / "run.csv", "table")["u"].tolist() == [-1.5, -2.0]


def test_a_header_of_several_lines_is_refused_and_a_quotation_mark_in_it_is_not(tmp_path):
    (tmp_path / "run.csv").write_text('"u\n[deg]",y\n1,2\n2,3\n')
    with pytest.raises(DataError, match="line 1: the header"):
        read_measured(tmp_path / "run.csv", "table")
    (tmp_path / "run.csv").write_text('a tube of 5" length\nu ["],y\n1,2\n2,3\n')
    assert dict(read_measured(tmp_path / "run.csv", "table").units) == {"u": '"'}


@pytest.mark.parametrize("cell", ["n/a", "NaN", "-", "", "#NV", "#DIV/0!", "none"])
def test_a_cell_may_say_in_many_ways_that_there_is_nothing(cell, tmp_path):
    (tmp_path / "run.csv").write_text(f"enc_1,x\n1.5,{cell}\n2.5,3\n")
    assert np.isnan(read_measured(tmp_path / "run.csv", "two_link")["x"][0])


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (("2026-03-01T12:00:00", "2026-03-01T12:00:00Z"), "some times state their zone and some do not"),
        (("2026-03-01T12:00:00", "2026-03-01T25:00:00"), "reading 2: '2026-03-01T25:00:00' is no time"),
        (("2026-03-01T12:00:00", "noon"), "reading 2: 'noon' is no time such as"),
    ],
)
def test_a_time_that_is_none_is_told(cells, said, tmp_path):
    (tmp_path / "run.csv").write_text("t_s\n" + "\n".join(cells) + "\n")
    with pytest.raises(DataError, match=said):
        read_measured(tmp_path / "run.csv", "two_link")


def test_a_clock_that_crosses_a_zone_is_one_time(tmp_path):
    (tmp_path / "run.csv").write_text("t_s\n2026-03-01T12:00:00+01:00\n2026-03-01 11:00:01.5 Z\n")
    assert read_measured(tmp_path / "run.csv", "two_link")["t_s"].tolist() == [0.0, 1.5]


@pytest.fixture
def renamed(tmp_path):
    """Return a shipped set whose first encoder has a name of its own."""
    data = read_measured(shipped_path("demo_nothing", "gpm2002"))
    path = write_measured(data, tmp_path / "run.csv")
    path.write_text(path.read_text().replace("enc_1 [rad]", "Winkel 1 (rad)"))
    return path


@pytest.mark.parametrize("columns", ['{"enc_1":"Winkel 1"}', "enc_1:Winkel 1"])
def test_columns_are_named_on_the_command_line(columns, renamed, tmp_path):
    words = ("machine=gpm2002", f"data={renamed}", f"columns={columns}")
    code, told = said("discover", *words, f"results={tmp_path / 'r'}", "pages=none", "--json")
    assert (code, json.loads(told)["verdict"]) == (0, "none")
    code, told = said("design", *words, "next=0")
    assert code == 0
    assert "readings" in told


@pytest.mark.parametrize(
    ("word", "wanted"),
    [
        ("columns=enc_1", "columns=enc_1: names with words are needed"),
        ("columns=enc_1:Winkle 1", "did you mean 'Winkel 1'?"),
        ("columns=enc_7:Winkel 1", "'enc_7' is no column of gpm2002"),
        ("units=enc_1:Grad", "'Grad' may be degrees or gon"),
        ("units=enc_7:deg", "units: enc_7 is no column of the file"),
        ("data.colour=red", "colour= is stated, and nothing of gpm2002 reads it"),
    ],
)
def test_a_wrong_word_about_columns_ends_in_one_line(word, wanted, renamed, tmp_path):
    first = [] if word.startswith("columns") else ["columns=enc_1:Winkel 1"]
    where = f"results={tmp_path / 'r'}"
    code, told = said("discover", "machine=gpm2002", f"data={renamed}", where, "pages=none", *first, word)
    assert code == 2
    assert wanted in told
    assert told.count("\n") == 1
    assert not (tmp_path / "r").exists()


def test_a_named_column_of_blanks_is_told(tmp_path):
    (tmp_path / "run.csv").write_text("u,amb,y\n1.5,,2\n2.5,,3\n")
    data = read_measured(tmp_path / "run.csv", "table", columns={"x": "amb"})
    assert [note.text for note in data.notes] == ["columns: x is to be 'amb', which is blank in every row"]
    assert data.notes[0].columns == ("x",)


def test_names_of_columns_do_not_go_with_a_printed_set():
    code, told = said("discover", "machine=orthoglide", "data=exp2", "columns=leg:Bein")
    assert code == 2
    assert "columns=: goes with a file; exp2 is printed in a paper" in told


@given
def test_tables_of_real_arms_are_read():
    tables = [*GIVEN.glob("arm_*/**/*.csv")]
    assert len(tables) > 40
    for path in tables:
        data = read_measured(path, "own")
        assert all(column.dtype.kind in "if" for column in data.columns.values()), path
    measured = read_measured(
        GIVEN / "arm_ur10_tmac" / "Series_B" / "measurements_joint_configurations.csv", "own",
        columns={"x": "measurement_x", "q1": "shoulder_pan_joint", "rx": "measurement_rx"}, units={"rx": "deg"},
    )  # fmt: skip
    assert len(measured) == 1495
    assert measured["x"][0] == 383.76294
    assert measured["rx"][0] == pytest.approx(np.deg2rad(-90.179302))


@given
def test_tables_of_other_machines_are_read_or_asked_for_their_units():
    silverbox = read_measured(GIVEN / "silverbox" / "SNLS80mV.csv", "own")
    assert (list(silverbox.columns), len(silverbox)) == (["V1", "V2"], 131072)
    assert len(read_measured(GIVEN / "delta_v400" / "V400ph_mesh_default.csv", "own")) == 49
    distances = GIVEN / "delta_v400" / "V400ph_distances.csv"
    with pytest.raises(DataError, match="unit 'steps, 80 steps/mm'"):
        read_measured(distances, "own")
    assert len(read_measured(distances, "own", units={"p2_c": "1"}).columns) == 7


@pytest.mark.parametrize("mark", [",", ";", " "])
def test_names_in_a_comment_above_the_first_reading_are_the_header(mark, tmp_path):
    path = tmp_path / "run.txt"
    units = "deg" if mark == " " else " deg"
    rows = ["# logger 7, March", "# " + mark.join([f"enc_1[{units.strip()}]", "x", "y"])]
    path.write_text("\n".join([*rows, mark.join(["90", "1.5", "2.5"]), mark.join(["180", "3.5", "4.5"]), ""]))
    data = read_measured(path, "two_link")
    np.testing.assert_allclose(data["enc_1"], [np.pi / 2, np.pi])
    assert data["y"].tolist() == [2.5, 4.5]
    assert "the names of the columns are those of the comment above the first reading, line 2" in map(str, data.notes)


def test_a_comment_that_names_no_columns_stays_one(tmp_path):
    for comment in ("# three words here", "# 1,2", "# of: March, April"):
        (tmp_path / "run.csv").write_text(f"{comment}\n1.5,2.5\n3.5,4.5\n")
        assert list(read_measured(tmp_path / "run.csv", "two_link").columns)[:2] == ["column_1", "column_2"]
    (tmp_path / "run.csv").write_text("# a,b\nx,y\n1.5,2.5\n")
    assert list(read_measured(tmp_path / "run.csv", "two_link").columns)[:2] == ["x", "y"]


def test_a_header_that_comes_again_is_left_out_and_told(tmp_path):
    (tmp_path / "run.csv").write_text("x [m],y\n1.5,2.5\nx [m],y\n3.5,4.5\n")
    data = read_measured(tmp_path / "run.csv", "two_link")
    assert data["x"].tolist() == [1500.0, 3500.0]
    assert "the header comes again in line 3 and is left out there" in map(str, data.notes)


def test_empty_lines_between_rows_are_passed_over_and_a_second_table_below_is_refused(tmp_path):
    (tmp_path / "run.csv").write_text("x,y\n1.5,2.5\n3.5,4.5\n\n5.5,6.5\n7.5,8.5\n\n")
    assert read_measured(tmp_path / "run.csv", "two_link")["x"].tolist() == [1.5, 3.5, 5.5, 7.5]
    (tmp_path / "run.csv").write_text("x,y\n1.5,2.5\n3.5,4.5\n\nt,u\n5.5,6.5\n")
    with pytest.raises(DataError, match="column x, reading 3: 't' is no number"):
        read_measured(tmp_path / "run.csv", "two_link")


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ("1'000.00", "write it without a mark between thousands"),
        ("1.000.000", "write it without a mark between thousands"),
        ("12.5 mm", "its unit in the heading"),
        ("118.5°", "its unit in the heading"),
        ("1.5D+01", "write the exponent with E"),
        ("01.03.2026 12:00:00", "write a time as 2026-03-01T12:30:05"),
        ("118:33:12.83", "an angle as one number of degrees"),
        ("err", "or leave the row out"),
    ],
)
def test_a_cell_that_is_no_number_is_told_with_its_own_way_out(cell, said, tmp_path):
    (tmp_path / "run.csv").write_text(f"x,y\n1.5,2.5\n{cell},4.5\n")
    with pytest.raises(DataError, match=re.escape(repr(cell))) as told:
        read_measured(tmp_path / "run.csv", "two_link")
    assert said in str(told.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Maschine,,Kamera\nr,x,y\n1,2,3\n", "header '' of column 2: a name, or a name with its unit"),
        ("x,y\n1,5,2,5\n", "it is line 2 of the file: decimal commas? then part the cells by semicolons"),
        ("x,y\n1,2\n3\n", "it is line 3 of the file: mend it, or leave the row out"),
        ("x,x\n1,2\n", "give each a name of its own"),
    ],
)
def test_a_table_that_is_none_is_told_with_what_to_do(text, said, tmp_path):
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(DataError, match=re.escape(said)):
        read_measured(tmp_path / "run.csv", "two_link")


def test_json_is_no_table(tmp_path):
    (tmp_path / "run.json").write_text('{"x": {"0": 1.0}}')
    with pytest.raises(DataError, match="is JSON"):
        read_measured(tmp_path / "run.json", "two_link")


def test_a_variable_of_another_length_is_told_where_it_is_missed(tmp_path):
    savemat(tmp_path / "run.mat", {"x": np.arange(5.0), "y": np.arange(9.0)})
    data = read_measured(tmp_path / "run.mat", "two_link")
    assert "y" in data
    with pytest.raises(DataError, match=r"column 'x'.*variables x \(5\)"):
        data["x"]


def test_a_column_in_other_letters_is_proposed(tmp_path):
    (tmp_path / "run.csv").write_text("Theta,x\n1,2\n2,3\n")
    with pytest.raises(DataError, match=re.escape("""columns='{"theta":"Theta"}'""")):
        read_measured(tmp_path / "run.csv", "two_link")["theta"]


def test_poses_and_visits_have_words_for_names_where_some_are_numbers_too(tmp_path):
    (tmp_path / "run.csv").write_text("pose_id;visit_id;enc_1\nP1;1;0,5\nP1;2b;0,6\nP2;1;0,7\n")
    data = read_measured(tmp_path / "run.csv", "mine")
    assert data["pose_id"].tolist() == ["P1", "P1", "P2"]
    assert data["visit_id"].tolist() == ["1", "2b", "1"]
    assert data["enc_1"].tolist() == [0.5, 0.6, 0.7]
