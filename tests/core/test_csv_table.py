"""One reader of tables for every door: heads with units, comments, blank lines, and what is refused."""

import numpy as np
import pytest

from calibench.bench.measured import read_measured, shipped_path
from calibench.core.tables.csv_table import read_table
from calibench.problems import full11, orthoglide6


def test_comments_units_and_blank_lines_are_told_apart(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("# said: first\n# and more\n\nenc_1 [deg];t_s\n1;2\n\n# between\n3;4\n")
    table = read_table(path)
    assert (table.names, table.units) == (("enc_1", "t_s"), {"enc_1": "deg"})
    assert [cells for _, cells in table.rows] == [("1", "2"), ("3", "4")]
    assert [line for line, _ in table.rows] == [5, 8]
    assert table.comment.startswith("# said: first # and more")


def test_three_bare_columns_have_no_header(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("1,2,3\n4,5,6\n")
    assert read_table(path, bare=True).names == ()
    assert len(read_table(path, bare=True).rows) == 2


@pytest.mark.parametrize("mark", [";", "\t"])
def test_numbers_with_decimal_commas_and_no_header_are_parted_by_what_parts_them(tmp_path, mark):
    path = tmp_path / "run.csv"
    path.write_text(f"1,5{mark}2,25{mark}-3,5\n4,5{mark}5,25{mark}6,5\n")
    table = read_table(path, bare=True)
    assert table.names == ()
    assert [cells for _, cells in table.rows] == [("1,5", "2,25", "-3,5"), ("4,5", "5,25", "6,5")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file is empty"),
        ('"#"', "the file is empty"),
        ("1,2,1\n4,5,6\n", "the first row holds the number 1 twice, so it is no header; write the names"),
        ("a,[mm]\n1,2\n", "a name with its unit"),
    ],
)
def test_what_is_no_table_is_told_in_a_line(tmp_path, text, said):
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=said):
        read_table(path)


def test_the_file_that_ships_is_read_by_both_doors():
    path = shipped_path("demo_nothing", "gpm2002")
    measured = read_measured(path)
    assert np.array_equal(full11.from_readings(path).readings, np.stack([measured[f"enc_{i}"] for i in (1, 2, 3)], 1))


def test_degrees_are_turned_into_radians_by_both_doors(tmp_path):
    measured = read_measured(shipped_path("demo_nothing", "gpm2002"))
    readings = np.stack([measured[f"enc_{i}"] for i in (1, 2, 3)], axis=1)
    path = tmp_path / "degrees.csv"
    np.savetxt(path, np.degrees(readings), delimiter=",", header="enc_1 [deg],enc_2 [deg],enc_3 [deg]", comments="")
    assert np.allclose(full11.from_readings(path).readings, readings, atol=1e-12)
    assert np.allclose(read_measured(path, "gpm2002")["enc_2"], readings[:, 1], atol=1e-12)


def test_micrometres_are_turned_into_millimetres(tmp_path):
    plan = [f"{leg},{d},{leg}{end}" for leg in "xyz" for d in "xyz" if d != leg for end in ("max", "min")]
    for unit, size in (("mm", 0.05), ("um", 50.0)):
        rows = "".join(f"{row},{size * (1 + k)}\n" for k, row in enumerate(plan))
        (tmp_path / f"{unit}.csv").write_text(f"leg,direction,posture,deviation [{unit}]\n{rows}")
    one, other = (orthoglide6.from_readings(tmp_path / f"{unit}.csv") for unit in ("mm", "um"))
    assert np.allclose(one.readings, other.readings, atol=1e-12)


@pytest.mark.parametrize(
    "above", ["Title of a run\n", "Title of a run;\n", "Title of a run;\n;\n", "Date;12.3.2024\nOperator;Meier\n"]
)
@pytest.mark.parametrize("units", ["", "°C;mV\n", "[°C];[mV]\n"])
def test_a_preamble_as_wide_as_the_table_is_no_header(tmp_path, above, units):
    """Excel pads its lines; and a row of units below a preamble gave the names."""
    file = tmp_path / "run.csv"
    file.write_text(f"{above}Temperatur;Spannung\n{units}0;0\n5;0,19\n10;0,4\n")
    table = read_table(file, bare=True)
    assert table.names == ("Temperatur", "Spannung")
    assert [cells for _, cells in table.rows[-3:]] == [("0", "0"), ("5", "0,19"), ("10", "0,4")]
    assert len(table.rows) == 3 + bool(units)


@pytest.mark.parametrize("above", ["", "Portal 7\n", "Portal 7;;\n"])
@pytest.mark.parametrize("remarks", [("", ""), ("", "Stoss"), ("gut", "")])
def test_remarks_may_be_empty_in_the_first_readings_below_a_preamble(tmp_path, above, remarks):
    file = tmp_path / "run.csv"
    file.write_text(f"{above}X [mm];Y [mm];Bemerkung\n1,5;2;{remarks[0]}\n3;4;{remarks[1]}\n5;6;Ende\n")
    table = read_table(file)
    assert (table.names, table.units) == (("X", "Y", "Bemerkung"), {"X": "mm", "Y": "mm"})
    assert len(table.rows) == 3


def test_a_quotation_mark_that_is_not_closed_is_told_with_its_line(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text('X;Y;Bemerkung\n1;2;"gut"\n3;4;"Stoss\n5;6;\n')
    with pytest.raises(ValueError, match="line 3"):
        read_table(file)


@pytest.mark.parametrize("header", ["V;A", "s;temp", "a;b"])
def test_a_header_of_units_or_words_stays_the_header(tmp_path, header):
    file = tmp_path / "run.csv"
    file.write_text(f"{header}\n1;2\n3;4\n")
    assert read_table(file, bare=True).names == tuple(header.split(";"))
    file.write_text(f"Date;12.3.2024\n{header}\n1;2\n3;4\n")
    assert read_table(file, bare=True).names == tuple(header.split(";"))
