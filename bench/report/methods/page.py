"""The tables of docs/optimizers.md, made from what the adapters obey.

``python -m calibench.bench.report.methods.page`` writes them.

A table stands between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; the words around it are written by hand.
"""

from __future__ import annotations

from pathlib import Path

from calibench.bench.report.methods.pygmo_table import pygmo_table
from calibench.bench.report.shared.page import table
from calibench.optimizers.nlopt import SETTINGS
from calibench.optimizers.scipy import SETTINGS as OF_SCIPY

PAGE = Path(__file__).resolve().parents[3] / "docs" / "optimizers.md"


def nlopt_table() -> str:
    """Return what each NLopt algorithm is given, a row for those that are given the same for the same reason."""
    head = ["algorithms", "the value's size", "tolerances", "memory", "population", "why"]
    rows = [
        [
            ", ".join(f"`{name}`" for name in setting.algorithms),
            "matters: divided" if setting.size_matters else "no effect",
            setting.tolerances,
            setting.memory,
            setting.population,
            setting.why,
        ]
        for setting in SETTINGS
    ]
    return table(head, rows)


def scipy_table() -> str:
    """Return what each method of SciPy is given and why."""
    rows = [
        [
            f"`{name}`",
            setting.word or f"{name}()",
            ", ".join(f"`{option}` = {value}" for option, value in setting.given.items()) or "none",
            setting.why,
        ]
        for name, setting in OF_SCIPY.items()
    ]
    return table(["scipy_", "SciPy's own", "given", "why"], rows)


TABLES = {"scipy": scipy_table, "nlopt": nlopt_table, "pygmo": pygmo_table}


def filled(page: str) -> str:
    """Return the text of the page with its tables made anew. Raises `ValueError` where a table's marks are missing."""
    for name, make in TABLES.items():
        begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
        if begin not in page or end not in page:
            raise ValueError(f"{PAGE.name}: the marks of the table {name} are missing")
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}\n{make()}\n{end}{rest.partition(end)[2]}"
    return page


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text()))
