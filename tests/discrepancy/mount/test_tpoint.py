"""Files of TheSky and TPOINT as they lie on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibench.bench.measured import read_measured
from calibench.discrepancy import DataError
from calibench.discrepancy.machines.mount.tpoint import read_tpoint

HEAD = "!TheSky Version 10\nMy mount\n:NODA\n:EQUAT\n"
SITE = "-00 30 00 2024 7 14 29.20 987.00 231.65  0.94 0.5500 0.0065\n"
STARS = (
    "21 43 18.0 +72 29 08.0 09 28 59.0 +109 20 06.0  23 59.0\n"
    "23 46 02.0 -00 38 38.0 11 26 17.0 -00 03 28.0  00 01.0 4.5\n"
    "! a comment between\n"
    "END\nnot read any more\n"
)


def test_a_file_is_read_as_it_lies() -> None:
    found = read_tpoint(HEAD + SITE + STARS)
    assert found.metadata == {"mount": "equatorial", "latitude_deg": -0.5}
    assert len(found.columns["ha"]) == 2
    lst = (23 + 59 / 60) * 15
    star = lst - 15 * (21 + 43 / 60 + 18 / 3600)
    assert np.degrees(found.columns["star_ha"][0]) == pytest.approx(star)
    assert np.degrees(found.columns["dec"][0]) == pytest.approx(109 + 20 / 60 + 6 / 3600)
    assert np.degrees(found.columns["star_dec"][1]) == pytest.approx(-(38 / 60 + 38 / 3600))
    assert found.columns["t_s"][1] == pytest.approx(2 * 60 * 86164.0905 / 86400)  # past midnight


def test_windows_line_ends_and_a_caption_with_a_number_are_read() -> None:
    found = read_tpoint((HEAD + "2 mounts\n" + SITE + STARS).replace("\n", "\r\n"))
    assert len(found.columns["ha"]) == 2


def test_an_altazimuth_file_has_azimuth_and_elevation() -> None:
    star = "12 00 00 +00 00 00 180 00 10 +60 00 05 12 00.0\n"
    found = read_tpoint(":ALTAZ\n+30 00 00 2024 7 14\n" + star)
    assert found.metadata["mount"] == "altaz"
    assert np.degrees(found.columns["star_az"][0]) % 360 == pytest.approx(180.0)
    assert np.degrees(found.columns["star_el"][0]) == pytest.approx(60.0)
    assert np.degrees(found.columns["az"][0]) == pytest.approx(180 + 10 / 3600)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + SITE, "no stars"),
        (HEAD, "no line of the site"),
        (HEAD + SITE + "21 43 18.0 +72 29 08.0 09 28\n", "line 6: a star needs 14 numbers"),
        (HEAD + SITE + "21 73 18.0 +72 29 08.0 09 28 59.0 +109 20 06.0  23 59.0\n", "line 6: 21 73 18.0: minutes"),
        (HEAD + "+99 00 00 2024 7 14\n", "latitude 99"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(text: str, said: str) -> None:
    with pytest.raises(DataError, match=said):
        read_tpoint(text)


def test_bench_reads_a_file_of_the_field(tmp_path: Path) -> None:
    file = tmp_path / "night.dat"
    file.write_text(HEAD + SITE + STARS)
    data = read_measured(file, "mount")
    assert (data.machine, data.name, len(data)) == ("mount", "night", 2)


def test_sidereal_time_to_the_second_is_read_as_such() -> None:
    stars = [
        f"{6 + k} 10 00.0 +20 00 00.0 {6 + k} 10 01.0 +20 00 05.0 08 {k:02d} {s}\n" for k, s in enumerate((3.5, 60.0))
    ]
    found = read_tpoint(HEAD + SITE + "".join(stars))
    lst = (8 + 3.5 / 3600) * 15
    assert np.degrees(found.columns["star_ha"][0]) == pytest.approx(lst - 15 * (6 + 10 / 60))
    assert "aux_1" not in found.columns
    assert any("h m s" in note for note in found.notes)


def test_what_stands_behind_a_sidereal_time_with_parts_of_a_minute_is_no_second() -> None:
    stars = (
        "6 10 00.0 +20 00 00.0 6 10 01.0 +20 00 05.0 08 01.5 21.0\n7 10 00 +20 00 00 7 10 01 +20 00 05 08 02.0 22.0\n"
    )
    found = read_tpoint(HEAD + SITE + stars)
    assert found.columns["aux_1"].tolist() == [21.0, 22.0]


def test_a_pointing_file_is_known_by_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "night.txt"
    path.write_text(HEAD + SITE + STARS)
    found = read_measured(path, "mount")
    assert len(found) == 2
    assert "read as a file that ends in .dat" in found.notes
    path.write_text("ha [deg];dec [deg]\n1,5;2,5\n")
    assert np.degrees(read_measured(path, "mount")["dec"]).tolist() == [2.5]
