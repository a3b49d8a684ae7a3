"""`make bench` runs every benchmark by its name, and only those."""

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

import benchmarks
from benchmarks.__main__ import known_names, page

ROOT = Path(__file__).resolve().parents[2]


def test_every_known_benchmark_has_rows_and_no_other_module_has_them() -> None:
    [folder] = benchmarks.__path__
    modules = {file.stem for file in Path(folder).glob("*.py")} - {"__main__", "__init__"}
    with_rows = {name for name in modules if hasattr(import_module(f"benchmarks.{name}"), "rows")}

    assert set(known_names()) == with_rows
    assert {"gate", "kernels", "optimisers"} <= with_rows


def test_what_a_benchmark_imports_as_it_runs_is_there() -> None:
    [folder] = benchmarks.__path__
    nodes = [node for file in Path(folder).rglob("*.py") for node in ast.walk(ast.parse(file.read_text("utf-8")))]
    ours = [node for node in nodes if isinstance(node, ast.ImportFrom) and str(node.module).startswith("calibench.")]
    named = {(str(node.module), alias.name) for node in ours for alias in node.names}
    assert not [
        one for one in sorted(named) if not hasattr(import_module(one[0]), one[1]) and not find_spec(".".join(one))
    ]


def test_a_part_that_is_measured_again_leaves_the_rest_of_the_page_alone() -> None:
    before = (ROOT / "docs/benchmarks.md").read_text(encoding="utf-8")
    assert page([], before) == before
    about = "From the shell to the answer.\n\nMeasured anew."
    row = {
        "benchmark": "a process",
        "contestant": "ours",
        "ns_per_evaluation": 2e9,
        "ns_q1": 1e9,
        "ns_q3": 3e9,
        "ratio": 1.0,
    }
    told = {"about": about, "date": "2026-11-26", "machine": "a machine", "versions": "python 3.11"}
    after = page([pd.DataFrame([row | told])], before)
    assert "Measured anew.\n\n2026-11-26, a machine, python 3.11.\n\n| a process | time" in after
    changed = [section for section in before.split("\n## ") if section not in after]
    assert [section.splitlines()[0] for section in changed] == ["From the shell to the answer"]
