"""A user's own file: read where it may have changed, and kept while a sweep goes on."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibench import problems
from calibench.core import sources, user_file
from calibench.core.registry import UnknownName
from calibench.discrepancy.registries import machines


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "kept_while_swept.py"
    path.write_text("WORD = 'first'\n")
    return path


def test_an_edited_file_is_loaded_anew_but_not_within_a_sweep(file: Path) -> None:
    assert user_file.load(file).WORD == "first"
    file.write_text("WORD = 'second'\n")
    with user_file.as_loaded():
        assert user_file.load(file).WORD == "first"
    assert user_file.load(file).WORD == "second"


def test_a_sweep_asks_no_run_what_a_file_imports(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer takes a tenth of a second where much is imported, and a short run takes milliseconds."""
    user_file.load(file)
    asked: list[Path] = []
    closure = sources.closure
    monkeypatch.setattr(sources, "closure", lambda path: asked.append(path) or closure(path))
    with user_file.as_loaded():
        user_file.load(file)
    assert asked == []
    user_file.load(file)
    assert asked == [file], "a sweep that begins looks"


def test_an_unknown_name_beside_its_file_tells_how_the_classes_in_it_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scara.py").write_text("class Scara: ...\nclass _Own: ...\nraise RuntimeError('not asked for')\n")
    (tmp_path / "broken.py").write_text("class (\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownName, match=r"machine=scara\.py:Scara"):
        machines.options("scara")
    with pytest.raises(UnknownName, match=r"unknown machine 'broken'; choices: "):
        machines.options("broken")


def test_a_name_is_looked_for_once_while_what_is_loaded_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "kept_name.py"
    source = "import numpy as np\nclass Mine:\n    lower, upper, start = -np.ones(1), np.ones(1), np.zeros(1)\n"
    file.write_text(f"{source}    def __call__(self, x):\n        return 1.0\n")
    name = f"{file}:Mine"
    first = problems.make(name)
    file.unlink()
    with user_file.as_loaded():
        assert type(problems.make(name)) is type(first)
    with pytest.raises(ValueError, match="there is no file"):
        problems.make(name)
