"""The recipes of CONTRIBUTING.md in a scratch copy of the checkout: files written, lines added, commands run."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text()
SECTIONS = dict(re.findall(r"^## ([^\n]+)\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE))
RECIPES = ["A problem", "An optimiser", "An effect", "A machine", "A paper"]
COPIED = (
    "bench",
    "calibench",
    "calibration",
    "conf",
    "core",
    "discrepancy",
    "optimizers",
    "problems",
    "pyproject.toml",
)
LONG = "bench paper"  # minutes: the ledger's own tests run it


def blocks(section: str) -> list[tuple[str, str, str]]:
    """Return (language, file and word, text) of every block."""
    return re.findall(r"```(\w+)([^\n]*)\n(.*?)```", section, re.DOTALL)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for name in COPIED:
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy)(
            ROOT / name,
            tmp_path / name,
            **({"symlinks": True, "ignore": shutil.ignore_patterns("__pycache__")} if (ROOT / name).is_dir() else {}),
        )
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    (tmp_path / "benchmarks").symlink_to(ROOT / "benchmarks")
    return tmp_path


def follow(section: str, folder: Path) -> list[str]:
    """Write what a recipe writes into `folder`; return its commands."""
    commands: list[str] = []
    for language, where, text in blocks(section):
        file, _, word = where.strip().partition(" ")
        path = folder / file
        if language == "sh":
            commands += [line for line in text.splitlines() if line.strip()]
        elif language == "diff":
            for old, new in zip(re.findall(r"^-(.*)$", text, re.M), re.findall(r"^\+(.*)$", text, re.M), strict=True):
                before = path.read_text()
                assert before.count(f"\n{old}\n") == 1, old
                path.write_text(before.replace(f"\n{old}\n", f"\n{new}\n"))
        elif word == "(add)":
            path.write_text(path.read_text() + text)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            assert not path.exists()
            path.write_text(text)
    return commands


@pytest.mark.slow
@pytest.mark.parametrize("recipe", RECIPES)
def test_a_recipe_can_be_followed(recipe: str, copy: Path) -> None:
    commands = follow(SECTIONS[recipe], copy)
    assert commands
    for command in commands:
        words = shlex.split(command, comments=True)
        if " ".join(words).startswith(LONG):
            continue
        if words[0] == "bench":
            words = ["python", "-m", "calibench", *words[1:]]
        assert words[0] == "python"
        done = subprocess.run(
            [sys.executable, *words[1:]],
            cwd=copy,
            env={k: v for k, v in os.environ.items() if not k.startswith("PYTEST")} | {"PYTHONPATH": str(copy)},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        if "pytest" in words:
            assert re.search(r"\[100%\]", done.stdout), f"{command}\n{done.stdout}"
        if words[-1] == "verdicts.py":
            assert "table1.length" in done.stdout
            assert done.stdout.split()[-1] == "reproduced"
        if "discover" in words:
            assert "slide" in done.stdout


def test_every_recipe_is_there_and_tested() -> None:
    assert [title for title in SECTIONS if title.startswith(("A ", "An "))] == RECIPES


def test_the_make_targets_that_are_named_are_there() -> None:
    makefile = (ROOT / "Makefile").read_text()
    named = {target for line in re.findall(r"make ((?:[a-z]+ ?)+)", PAGE) for target in line.split()}
    found = {target for target in named if f"\n{target}:" in makefile}
    assert {"venv", "test", "slow", "bench", "reference"} <= found


def test_the_files_that_are_named_are_there() -> None:
    written = {where.split()[0] for section in SECTIONS.values() for _, where, _ in blocks(section) if where.strip()}
    text = re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)
    for path in re.findall(r"(?:docs|tests|examples|conf|benchmarks)/[\w/.-]*\w/?", text):
        assert (ROOT / path).exists() or path in written or path == "docs/architecture.md", path
