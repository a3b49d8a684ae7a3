"""`make bench` runs every benchmark by its name, and only those."""

from importlib import import_module
from pathlib import Path

import benchmarks
from benchmarks.__main__ import known_names


def test_every_known_benchmark_has_rows_and_no_other_module_has_them() -> None:
    [folder] = benchmarks.__path__
    modules = {file.stem for file in Path(folder).glob("*.py")} - {"__main__", "__init__"}
    with_rows = {name for name in modules if hasattr(import_module(f"benchmarks.{name}"), "rows")}

    assert set(known_names()) == with_rows
    assert {"gate", "kernels", "optimisers"} <= with_rows
