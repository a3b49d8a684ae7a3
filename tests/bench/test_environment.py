"""Where a row comes from: the commit of the checkout, and whether a file of it was edited."""

import shutil
import subprocess
from pathlib import Path

import pytest

from calibench.bench.provenance import environment


def git(folder: Path, *words: str) -> str:
    asked = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", *words]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    place = tmp_path / "bench" / "provenance" / "environment.py"
    place.parent.mkdir(parents=True)
    place.write_text("one = 1\n")
    monkeypatch.setattr(environment, "__file__", str(place))
    git(tmp_path, "init", "--quiet")
    return tmp_path


def told() -> tuple[str, bool]:
    found = environment.provenance.__wrapped__()
    return found["git_commit"], found["git_dirty"]


def test_a_row_tells_the_commit_and_whether_a_tracked_file_was_edited(checkout: Path) -> None:
    git(checkout, "add", ".")
    git(checkout, "commit", "--quiet", "-m", "first")
    commit = git(checkout, "rev-parse", "HEAD")
    (checkout / "notes.txt").write_text("not tracked")
    assert told() == (commit, False)
    (checkout / "bench" / "provenance" / "environment.py").write_text("one = 2\n")
    assert told() == (commit, True)


def test_a_checkout_without_a_commit_has_none(checkout: Path) -> None:
    assert told()[0] == ""


def test_outside_of_a_checkout_there_is_neither(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "bench" / "provenance" / "environment.py"
    monkeypatch.setattr(environment, "__file__", str(place))
    assert told() == ("", False)
