"""The newcomers' stories end well: each with a fresh environment and an empty home, by the pages alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
STORIES = ("first_plot", "own_report", "own_csv", "own_robot")


@pytest.mark.slow
@pytest.mark.parametrize("story", STORIES)
def test_a_newcomer_gets_there_by_the_pages_alone(story: str) -> None:
    done = subprocess.run(
        [sys.executable, str(HERE / f"{story}.py"), str(HERE.parents[1])], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert " s  from git clone to " in done.stdout


def test_every_story_is_told() -> None:
    assert {path.stem for path in HERE.glob("*.py") if "story(" in path.read_text() and path.stem != "fresh"} == {
        *STORIES,
        "test_newcomer",
    }
