"""A user's file stands beside a clone of this package, as after the README's first line: the installed one counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibench.core import sources, user_file


@pytest.fixture
def beside_a_clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    for package in ("calibench/calibench", "calibench/bench", "calibench/optimizers"):
        (tmp_path / package).mkdir(parents=True)
        (tmp_path / package / "__init__.py").write_text("import calibench\nfrom calibench import optimizers\n")
    file = tmp_path / "beside.py"
    file.write_text("from calibench import bench, optimizers\n\n\ndef f(x):\n    return float(x @ x)\n")
    return file


def test_a_clone_in_the_folder_does_not_hide_what_is_installed(beside_a_clone: Path) -> None:
    assert user_file.load(beside_a_clone).f is not None
    assert not any((beside_a_clone.parent / "calibench") in file.parents for file in sources.closure(beside_a_clone))


def test_a_folder_of_ones_own_is_followed_where_nothing_of_its_name_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "quarry").mkdir()
    (tmp_path / "quarry" / "stone.py").write_text("WEIGHT = 3\n")
    file = tmp_path / "digs.py"
    file.write_text("from quarry import stone\n")
    assert user_file.load(file).stone.WEIGHT == 3
    assert tmp_path / "quarry" / "stone.py" in sources.closure(file)
