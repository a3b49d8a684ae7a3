"""`bench list effects`, `machines` and `figures`: what the search for a missing effect knows, and what pages draw."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import TypeGuard

import pytest

from calibench.bench.cli import main
from calibench.bench.commands import list as list_command
from calibench.bench.papers.cong2008 import figures


def listed(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["list", *argv])
    assert ended.value.code == 0
    return capsys.readouterr().out


def test_effects_are_listed_with_what_they_need(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [row for row in json.loads(listed(capsys, "effects", "--json")) if row["machine"] == "gpm2002"]
    assert len(rows) == 21
    [backlash] = [row for row in rows if row["name"] == "backlash"]
    assert backlash["columns"] == ["dir_{i}"]
    assert backlash["targets"] == ["joint 1", "joint 2", "joint 3"]
    assert backlash["unit"] == "rad"


def test_effects_are_printed_with_their_machine_and_formula(capsys: pytest.CaptureFixture[str]) -> None:
    lines = listed(capsys, "effects").splitlines()
    at = lines.index("gear  [gpm2002, reading]")
    assert "enc_i += k enc_i" in lines[at + 1]


def test_machines_are_listed_with_their_effects(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in json.loads(listed(capsys, "machines", "--json"))}
    assert "tracker_lag" in rows["gpm2002"]["effects"]
    assert rows["gpm2002"]["options"] == []


def drawn_by(source: str) -> set[str]:
    """Return the names of the drawings that a module yields, without what tells several of one kind apart."""
    found = set()
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef) and "Draw" in ast.unparse(function.returns or ast.Constant("")):
            yielded = [node.value for node in ast.walk(function) if isinstance(node, ast.Yield)]
            names = [node.elts[0] for node in yielded if isinstance(node, ast.Tuple)]
            found |= {word.value.strip("_") for name in names for word in ast.walk(name) if is_word(word)}
        if isinstance(function, ast.Call) and ast.unparse(function.func) == "Shown":
            found |= {word.value.strip("_") for word in ast.walk(function.args[0]) if is_word(word)}
        if isinstance(function, ast.Call) and ast.unparse(function.func) == "AddedFigure":
            name = function.args[0]
            found |= {name.value} if is_word(name) else {*figures.FIGURES}  # those of a dictionary
    return found


def is_word(node: ast.AST) -> TypeGuard[ast.Constant]:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def test_the_figures_that_are_listed_are_those_that_pages_draw(capsys: pytest.CaptureFixture[str]) -> None:
    home = Path(list_command.__file__).parents[1]
    sources = (path.read_text(encoding="utf-8") for path in home.rglob("*.py"))
    drawn = set().union(
        *(drawn_by(source) for source in sources if re.search(r"\bDraw(ing|able)\b|(AddedFigure|Shown)\(", source))
    )
    assert {row["name"] for row in json.loads(listed(capsys, "figures", "--json"))} == drawn
