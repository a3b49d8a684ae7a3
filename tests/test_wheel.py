"""The wheel holds what the package reads at run time beside its modules."""

import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).resolve().parents[1]
DATA = (".j2", ".css", ".js", ".txt", ".json", ".toml", ".yaml", ".typed", ".csv", ".parquet")


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    return set(zipfile.ZipFile(wheel).namelist())


def test_templates_style_sheets_the_schema_and_the_mark_of_types_are_in_the_wheel(names):
    packages = [path for path in (ROOT / "calibench").iterdir() if path.is_dir()]
    here = {
        path.relative_to(ROOT).as_posix()
        for package in packages
        for path in package.rglob("*")
        if path.suffix in DATA and "__pycache__" not in path.parts
    }
    assert {path.rpartition(".")[2] for path in here} >= {"j2", "css", "js", "txt", "json", "toml", "yaml"}
    assert here <= names
    assert "calibench/py.typed" in names
    assert "calibench/bench/discovery/report.schema.json" in names
