"""The examples run as they stand, from any folder: scripts in a process of their own, the notebook cell by cell."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
SAYS = {
    "own_problem": ["all laws are kept", "trf "],
    "own_optimizer": ["all laws are kept", "Walk(width=0.01)"],
    "own_machine": ["play of 0.0 mm: none []", "play of 0.05 mm: named ['play slide: 0.05"],
    "reading_results": ["converged", "median best value after 100 evaluations"],
}
IN_NOTEBOOKS = {
    "tour": ["11 of 12 parameters can be seen", "backlash joint 2", "de               "],
    "compare": ["trf reaches 100% of the targets", "named backlash joint 2"],
}


def cells(notebook: Path, kind: str) -> list[str]:
    """Return the sources of the cells of one kind."""
    read = json.loads(notebook.read_text())
    assert read["nbformat"] == 4
    return ["".join(cell["source"]) for cell in read["cells"] if cell["cell_type"] == kind]


@pytest.mark.parametrize(
    "script",
    [pytest.param(s, id=s.stem, marks=[] if s.stem == "own_problem" else [pytest.mark.slow]) for s in SCRIPTS],
)
def test_a_script_runs_from_another_folder_and_says_what_it_should(script: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    for said in SAYS[script.stem]:
        assert said in done.stdout


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_cells_of_a_notebook_run_in_order(
    notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    space: dict[str, object] = {"__name__": "__main__"}
    for cell in cells(notebook, "code"):
        exec(compile(cell, notebook.name, "exec"), space)
    said = capsys.readouterr().out
    for words in IN_NOTEBOOKS[notebook.stem]:
        assert words in said


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_output(notebook: Path) -> None:
    read = json.loads(notebook.read_text())
    assert all(not c["outputs"] and c["execution_count"] is None for c in read["cells"] if c["cell_type"] == "code")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_short_and_uses_the_public_face(script: Path) -> None:
    text = script.read_text()
    assert len(text.splitlines()) <= 60
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("calibench"):
            assert (node.module or "").count(".") <= 1, node.module
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_") or node.attr.startswith("__")


def test_there_is_an_example_of_each_kind() -> None:
    assert {script.stem for script in SCRIPTS} == set(SAYS)
    assert {notebook.stem for notebook in NOTEBOOKS} == set(IN_NOTEBOOKS)
