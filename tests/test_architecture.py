"""docs/architecture.md tells the code as it is: its picture, its rooms, and the two walks, each in ten stations."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from benchmarks import architecture
from benchmarks.architecture import PICTURE, circles, draw, files_listed, inside, lines, read_back, room_imports, sizes
from calibench.bench.cli import main
from calibench.bench.measured import read_measured, shipped_path, write_measured
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import carry_out, costs
from tests.bench.conftest import empty_drawings

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
imports = cache(room_imports)


def walk(title: str) -> tuple[list[str], list[str]]:
    """Return the command of a walk and its stations, ``module:qualified name`` each."""
    section = PAGE.partition(f"## {title}")[2].partition("\n## ")[0]
    [command] = re.findall(r"^`bench ([^`]+)`$", section, re.MULTILINE)
    numbered = re.findall(r"^(\d+)\. `([\w.]+:[\w.]+)` ", section, re.MULTILINE)
    assert [int(number) for number, _ in numbered] == list(range(1, 11))
    return shlex.split(command), [station for _, station in numbered]


def passed(stations: list[str], run: Callable[[], Any]) -> list[str]:
    """Return the stations that `run` passes in their order: each is looked for after the one before it."""
    left = list(reversed(stations))
    names = [re.split("[:.]", station)[-1] for station in left]

    def watch(frame: FrameType, event: str, _: Any) -> None:
        code: CodeType = frame.f_code
        if event == "call" and code.co_name == names[-1]:
            module = frame.f_globals.get("__name__", "").removeprefix("calibench.")
            if f"{module}:{code.co_qualname}" == left[-1]:
                left.pop()
                names.pop()
                if not left:
                    sys.setprofile(None)

    sys.setprofile(watch)
    try:
        run()
    finally:
        sys.setprofile(None)
    return stations[: len(stations) - len(left)]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for module in (carry_out, costs):  # a run stays in this process, where it can be watched
        monkeypatch.setattr(module, "CAN_FORK", False)
    return tmp_path


def bench(words: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0


def test_a_candidate_passes_its_ten_stations_and_is_a_row(here: Path) -> None:
    words, stations = walk("One candidate, from the command line to a row")
    bench([*words, "study=compiled"])
    assert passed(stations, lambda: bench(words)) == stations
    assert len(ResultStore(here / "results" / "adhoc").runs()) == 1


@pytest.mark.usefixtures("at_one_noise", "without_formula")
def test_a_measured_file_passes_its_ten_stations_and_has_a_page(here: Path) -> None:
    words, stations = walk("One measured file, from CSV to the page of its verdict")
    write_measured(read_measured(shipped_path("demo_nothing", "gpm2002"), "gpm2002"), here / "run.csv")
    with empty_drawings():
        assert passed(stations, lambda: bench(words)) == stations
    assert (here / "results" / "discover" / "run" / "report.html").exists()


def test_stations_in_another_order_are_not_passed() -> None:
    def one() -> None:
        pass

    def two() -> None:
        one()

    names = [f"{__name__}:{f.__qualname__}" for f in (two, one)]
    assert passed(names, two) == names
    assert passed(names[::-1], two) == names[1:]


def test_the_picture_is_that_of_the_imports_now() -> None:
    picture = PICTURE.read_text(encoding="utf-8")
    found = imports()
    assert read_back(picture) == found, "run: python -m benchmarks.architecture"
    assert picture == draw(found)


def test_every_file_is_in_the_list_of_the_site() -> None:
    assert "- `thresholds.py`: " in files_listed()


def test_the_sizes_are_those_of_the_folders_that_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(architecture, "FOLDERS", ("core", "optimizers"))
    size = sizes()
    files = [path for folder in ("core", "optimizers") for path in (ROOT / folder).rglob("*.py")]
    assert size["files"] == len(files)
    assert size["lines"] == sum(path.read_text().count("\n") for path in files)
    assert size["lines"] > size["longest file"] > size["median file"] > size["median function"]
    assert size["modules with one importer"] >= size["of them below 100 lines"]


def test_imports_of_rooms_are_read_whatever_their_form() -> None:
    assert "problems" in imports()["discrepancy.model"]
    assert "bench.execution" in imports()["testing"]
    assert not any(target.startswith("bench") for target in imports()["problems"])
    assert ("discrepancy.search", "discrepancy.model") not in lines(inside(imports(), "discrepancy"))


def test_a_line_is_left_out_only_where_others_lead() -> None:
    rooms = {"a": ("b", "c"), "b": ("c",), "c": (), "x": ("y", "z"), "y": ("z",), "z": ("y",)}
    assert lines(rooms) == [("a", "b"), ("b", "c"), ("x", "y"), ("x", "z"), ("y", "z"), ("z", "y")]
    assert circles(rooms) == [("y", "z")]


@pytest.mark.parametrize("package", ["discrepancy", "problems", "optimizers"])
def test_no_folders_of_a_package_import_each_other(package: str) -> None:
    assert circles(inside(imports(), package)) == []


def test_every_room_is_told_in_one_line() -> None:
    table = PAGE.partition("## The rooms")[2].partition("\n## ")[0]
    told = re.findall(r"^\| `([\w.]+)` \|", table, re.MULTILINE)
    assert sorted(told) == sorted(imports())


def test_the_files_to_change_are_there() -> None:
    table = PAGE.partition("## Where do I add")[2]
    paths = re.findall(r"`((?:bench|calibration|conf|core|problems|optimizers|discrepancy)/[\w/.*]+)`", table)
    assert len(paths) >= 25
    for path in paths:
        assert (ROOT / path).exists(), path


TASKS = {  # what somebody adds: the row that says where, and what stands in a file that the row names
    "a unit": ("a unit that files may state", "_TO_BASE = {"),
    "a decimal comma": ("a quirk of CSV", "def with_points"),
    "a kind of observation of an arm": ("what may be observed of an arm", "OBSERVED = ("),
    "an effect of a rotary joint": ("a missing effect", "RECIPES = ("),
    "a method of NLopt that cannot be run": ("an optimiser", "EXCLUDED: dict[str, str]"),
    "a reason to stop": ("a reason why a run stops", "STOP_REASONS"),
    "a column": ("a column of `runs.parquet`", "class RunRow"),
    "an interval of a success rate": ("a statistic of a study", "def success_interval"),
    "a colour": ("a figure of a study", "COLOURS = ("),
    "a word of a verdict": ("a note or sentence of a verdict", "def headline"),
    "a format of files": ("a format of measured files", "def read_measured"),
    "a verb": ("a verb of `bench`", "_VERBS = {"),
}


@pytest.mark.parametrize("task", TASKS)
def test_the_table_leads_a_newcomer_to_the_file(task: str) -> None:
    row_of, holds = TASKS[task]
    [row] = [line for line in PAGE.partition("## Where do I add")[2].splitlines() if row_of in line]
    files = [
        file
        for path in re.findall(r"`((?:bench|calibration|core|conf|problems|optimizers|discrepancy)/[\w/.]+)`", row)
        for file in ([ROOT / path] if path.endswith(".py") else (ROOT / path).rglob("*.py"))
    ]
    assert any(holds in file.read_text() for file in files)
