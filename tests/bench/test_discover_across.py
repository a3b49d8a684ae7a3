"""`bench discover ... across=`: other sets of the same machine, through the same door as data=."""

import json
import shutil

import pytest

from calibench import bench, discover
from calibench.bench.measured.sources import shipped_path
from tests.bench.test_discover import call

pytestmark = pytest.mark.usefixtures("at_one_noise", "undrawn")


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """The same machine on two days: a backlash on the first, and none on the second."""
    folder = tmp_path_factory.mktemp("days")
    for name, of in (("day1", "demo_backlash"), ("day3", "demo_unknown")):
        shutil.copy(shipped_path(of, "gpm2002"), folder / f"{name}.parquet")
    shutil.copy(shipped_path("demo_nothing", "gpm2002"), folder / "day2.csv")
    return folder


def _words(days, tmp_path, across, data="day1.parquet"):
    return f"discover machine=gpm2002 data={days}/{data} across={across} results={tmp_path}"


def test_other_sets_are_told_on_the_terminal_in_the_report_and_on_the_page(days, tmp_path, capsys):
    words = _words(days, tmp_path, f"[{days}/day2.csv,{days}/day3.parquet]")
    code, out, _ = call(words, capsys)
    assert code == 0
    assert "Of other sets of this machine: backlash of joint 2 does not carry to day2 (nothing of it shows" in out
    written = json.loads((tmp_path / "discover" / "day1" / "report.json").read_text())
    assert [(row["effect"], row["case"], row["verdict"]) for row in written["across"]] == [
        ("backlash joint 2", "day2", "does not carry"), ("backlash joint 2", "day3", "does not carry"),
    ]  # fmt: skip
    page = (tmp_path / "discover" / "day1" / "report.html").read_text()
    assert "In other sets of this machine" in page
    assert "searched before" in call(words, capsys)[1]


def test_a_day_that_changes_is_looked_at_again(days, tmp_path, capsys):
    other = tmp_path / "other.csv"
    shutil.copy(days / "day2.csv", other)
    words = _words(days, tmp_path, other) + " pages=none"
    call(words, capsys)
    lines = other.read_text().splitlines()
    other.write_text("\n".join(lines[:-2]) + "\n")
    assert "searched before" not in call(words, capsys)[1]


def test_what_no_set_can_carry_to_is_refused_in_a_line(days, tmp_path, capsys):
    refused = {
        _words(days, tmp_path, f"{days}/none.csv"): "none.csv: ",
        _words(days, tmp_path, "nowhere"): "across=nowhere: there is no such file, folder or name",
        _words(days, tmp_path, f"{days}/day1.parquet"): "across=day1: it is the set of data= itself",
        _words(days, tmp_path, f"{days}/day2.csv", "*.parquet"): "across= goes with one set in data=",
    }
    for words, why in refused.items():
        code, out, err = call(words, capsys)
        assert (code, out) == (2, "")
        assert why in err
        assert len(err.splitlines()) == 1


def test_python_has_the_same_word(days):
    report = discover("gpm2002", days / "day1.parquet", across=[days / "day2.csv"])
    assert [(row.case, row.verdict) for row in report.across] == [("day2", "does not carry")]
    there = bench.read_measured(days / "day2.csv")
    assert discover("gpm2002", days / "day1.parquet", across=there).across[0].verdict == "does not carry"
