"""Files of TheSky and TPOINT as they lie on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibench.bench.measured import read_measured
from calibench.discrepancy import DataError
from calibench.discrepancy.machines.mount.description import read_tpoint
from calibench.discrepancy.machines.mount.formulation import accepted

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
        (HEAD + STARS, "line 5: stands where the line of the site is needed .* and has no year"),
        (":ALTAZ\n" + SITE + "10.5 60.5 10.4 60.4\n" + STARS, "line 4: a star needs 14 numbers .* or 4 in degrees"),
        (HEAD + SITE + "10.5 60.5 10.4 60.4\n", "line 6: a star needs 14 numbers"),
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
    assert any("h m s" in note.text for note in found.notes)


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
    assert "read as a file that ends in .dat" in map(str, found.notes)
    path.write_text("ha [deg];dec [deg]\n1,5;2,5\n")
    assert np.degrees(read_measured(path, "mount")["dec"]).tolist() == [2.5]


def test_a_latitude_alone_is_the_site_and_the_first_star_is_none() -> None:
    """The first star was read as the line of the site, and its right ascension as the latitude."""
    found = read_tpoint("+35 01 32.0\n" + STARS)
    assert found.metadata["latitude_deg"] == pytest.approx(35 + 1 / 60 + 32 / 3600)
    assert len(found.columns["ha"]) == 2


def test_a_line_of_the_site_behind_a_caption_of_three_numbers_is_the_site() -> None:
    found = read_tpoint("13 02 02\n" + SITE + STARS)
    assert found.metadata["latitude_deg"] == -0.5
    assert len(found.columns["ha"]) == 2


DEGREES = (
    "!decimal degrees\nnight of a big telescope\n: ALTAZ\n+31 41 19.6 2021 8 21 13.0 741 2608.0 0.75\n"
    "192.3860283 77.3468410111111 -167.2778909 77.3475476\n-0.92036 23.1119783111111 -0.58799 23.1170926\n"
)


def test_a_star_of_four_numbers_is_azimuth_and_elevation_in_degrees() -> None:
    found = read_tpoint(DEGREES)
    assert found.metadata == {"mount": "altaz", "latitude_deg": pytest.approx(31.6887777)}
    assert np.degrees(found.columns["star_az"]).tolist() == pytest.approx([192.3860283, -0.92036])
    assert np.degrees(found.columns["star_el"]).tolist() == pytest.approx([77.3468410111111, 23.1119783111111])
    assert np.degrees(found.columns["az"]).tolist() == pytest.approx([-167.2778909, -0.58799])
    assert np.degrees(found.columns["el"]).tolist() == pytest.approx([77.3475476, 23.1170926])
    behind = read_tpoint(DEGREES.replace("77.3475476", "77.3475476 3").replace("23.1170926", "23.1170926 4"))
    assert behind.columns["aux_1"].tolist() == [3, 4]


@pytest.mark.parametrize(
    ("way", "sign", "zero"),
    [("north_east", 1, 0), ("north_west", -1, 0), ("south_east", -1, 180), ("south_west", 1, 180)],
)
def test_azimuth_is_counted_as_the_owner_states_it(tmp_path: Path, way: str, sign: int, zero: float) -> None:
    """A mount whose axis leans north by 100 arcsec, told in each of the four ways of counting."""
    rng = np.random.default_rng(2)
    az, el = rng.uniform(0, 2 * np.pi, 60), rng.uniform(0.3, 1.3, 60)
    d_az, d_el = -100 * np.sin(az) * np.tan(el) / 206264.8, -100 * np.cos(az) / 206264.8  # TPOINT: AN
    written = np.stack([sign * (az + d_az) + np.radians(zero), el + d_el, sign * az + np.radians(zero), el], axis=-1)
    lines = [" ".join(f"{value:.7f}" for value in row) for row in np.degrees(written)]
    file = tmp_path / "night.dat"
    file.write_text(":ALTAZ\n+30 00 00 2024 7 14\n" + "\n".join(lines))
    seen = accepted(read_measured(file, "mount", {"azimuth": way}))[0]
    assert np.cos(seen["az"] - az) == pytest.approx(1)
    assert seen["dS"] == pytest.approx(d_az * np.cos(el) * 206264.8, abs=0.1)
    assert seen["dEl"] == pytest.approx(d_el * 206264.8, abs=0.1)


def test_an_azimuth_that_nobody_states_is_told_and_an_unknown_one_refused(tmp_path: Path) -> None:
    file = tmp_path / "night.dat"
    file.write_text(DEGREES)
    notes = accepted(read_measured(file, "mount"))[0].notes
    assert any("from north through east is taken" in n.text and "azimuth=south_east" in n.text for n in notes)
    stated = accepted(read_measured(file, "mount", {"azimuth": "south_east"}))[0].notes
    assert not any("azimuth" in note.text for note in stated)
    with pytest.raises(DataError, match=r"azimuth=south: .*south_west"):
        accepted(read_measured(file, "mount", {"azimuth": "south"}))
