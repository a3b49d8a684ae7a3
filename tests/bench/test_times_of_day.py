"""Times of day without a date, as loggers and offices write them: seconds from the first, on over midnight."""

import datetime

import numpy as np
import openpyxl
import pytest

from calibench.bench.measured import read_measured
from calibench.discrepancy import DataError, MeasuredData, explain
from calibench.discrepancy.machines.table import Table


def read(path, times, head="t_s", machine="gpm2002", parted=",", **stated):
    cells = [f"0{'.' if parted == ',' else ','}{k}{parted}{time}" for k, time in enumerate(times, start=1)]
    path.write_text("\n".join([f"enc_1{parted}{head}", *cells]) + "\n")
    return read_measured(path, machine, **stated)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.csv"


@pytest.mark.parametrize(
    ("times", "seconds"),
    [
        (["14:03:22.5", "14:03:24", "14:04:00.25"], [0, 1.5, 37.75]),
        (["14:03", "14:05", "15:03"], [0, 120, 3600]),
        (["9:59:59", "10:00:00", "9:59:58"], [0, 1, -1]),
        (["23:59:59", "-", "00:00:01.5"], [0, np.nan, 2.5]),
    ],
)
def test_times_of_day_are_seconds_from_the_first(path, times, seconds):
    data = read(path, times)
    np.testing.assert_array_equal(data["t_s"], seconds)
    assert data.units["t_s"] == "s"


def test_midnights_are_counted_in_the_note(path):
    times = ["22:00", "23:00", "01:00", "11:00", "21:00", "07:00"]
    data = read(path, times)
    np.testing.assert_array_equal(data["t_s"] / 3600, [0, 1, 3, 13, 23, 33])
    assert "t_s: times of day, turned into seconds from the first, on over 2 midnights" in map(str, data.notes)
    assert "t_s: times of day, turned into seconds from the first" in map(str, read(path, times[:2]).notes)


def test_a_decimal_comma_is_read_and_a_column_of_another_name_is_taken(path):
    data = read(path, ["14:03:22,5", "14:03:24,25"], "Uhrzeit [hh:mm:ss]", parted=";", columns={"t_s": "Uhrzeit"})
    assert data["t_s"].tolist() == [0.0, 1.75]


def test_a_cell_of_excel_with_a_time_alone_is_a_time_of_day(tmp_path):
    book = openpyxl.Workbook()
    for row in (["enc_1", "t_s"], [0.1, datetime.time(23, 59, 59, 500000)], [0.2, datetime.time(0, 0, 1)]):
        book.active.append(row)
    book.save(tmp_path / "run.xlsx")
    assert read_measured(tmp_path / "run.xlsx", "gpm2002")["t_s"].tolist() == [0.0, 1.5]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (["14:03", "2026-03-01T14:04"], "column t_s, reading 2: '2026-03-01T14:04' has a date, and '14:03' has none"),
        (["2026-03-01T14:04", "14:05"], "column t_s, reading 2: '14:05' has no date, and other times have one"),
        (["14:03", "25:00"], "column t_s, reading 2: '25:00' is no time of day such as 14:03:22.5"),
        (["14:03", "12.5"], "column t_s, reading 2: '12.5' is no time of day such as 14:03:22.5"),
    ],
)
def test_what_is_not_written_alike_is_refused(path, times, said):
    with pytest.raises(DataError, match=said):
        read(path, times)


def test_angles_in_hours_are_no_times(path):
    for head in ("ha", "ha [h]", "repeat"):
        with pytest.raises(DataError, match=r"'14:03:22\.5'"):
            read(path, ["14:03:22.5", "14:05:00"], head, "mount")
    with pytest.raises(DataError, match="column ha: unit 's' cannot be turned into rad"):
        read(path, ["14:03:22.5", "14:05:00"], "RA", "mount", columns={"ha": "RA"})
    for name in ("ha", "RA"):
        with pytest.raises(DataError, match=f"units: {name}"):
            read(path, ["14:03:22.5", "14:05:00"], "RA", "mount", columns={"ha": "RA"}, units={name: "h"})


def test_words_and_names_of_poses_that_look_like_times_stay_words(path):
    assert read(path, ["14:03", "early"], "remark")["remark"].tolist() == ["14:03", "early"]
    assert read(path, ["14:03", "14:05"], "pose_id")["pose_id"].tolist() == ["14:03", "14:05"]


def test_seconds_that_were_rounded_up_to_sixty_are_the_next_minute(path):
    assert read(path, ["0:09:58.5", "0:09:60.0", "0:10:01"])["t_s"].tolist() == [0.0, 1.5, 2.5]


def test_one_wrong_time_among_many_is_named_under_the_name_of_the_file(path):
    times = [f"14:{k:02d}" for k in range(20)]
    times[7] = "ca. 14:07"
    with pytest.raises(DataError, match=r"column Uhrzeit, reading 8: 'ca. 14:07'"):
        read(path, times, "Uhrzeit")
    assert read(path, ["14:03", "late", "early"], "remark")["remark"].tolist() == ["14:03", "late", "early"]


@pytest.mark.parametrize("place", [20, 40])
def test_a_block_of_times_of_day_that_was_pasted_again_is_no_next_day(place):
    rng = np.random.default_rng(5)
    u = np.round(np.linspace(0, 3, 40), 2)
    y = np.round(2 * u + 1 + 0.05 * rng.standard_normal(40), 3)
    clock = 60.0 * np.arange(40)
    at = np.insert(np.arange(40), place, np.arange(10, 20))
    later = np.cumsum(np.diff(clock[at], prepend=0.0) < 0)  # as the times of day are read
    columns = {"u": u[at], "y": y[at], "t_s": clock[at] + 86400.0 * later}
    table = Table(model="line", inputs=("u",), time="t_s", sigma=0.05)
    with pytest.raises(DataError, match=r"rows 11 and \d+"):
        explain(table, MeasuredData(columns, "table", {}, "made", units={"t_s": "s"}))
    alone = {name: column[np.unique(at, return_index=True)[1]] for name, column in columns.items()}
    alone["t_s"] = clock
    assert explain(table, MeasuredData(alone, "table", {}, "made", units={"t_s": "s"})).verdict == "none"
