"""The papers' numbers, read from ``data/*.toml``: each with its unit, its place, and its erratum if it has one.

No published number stands in code.
"""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any


@dataclass(frozen=True, slots=True)
class Constant:
    """A published number. Use `value`; `printed` differs from it only where the print is wrong, and `why` says why.

    `certain` is False where the correction was argued and not seen in another print; `doubt` names what stays open.
    `kind` is what the paper does with the number: it is given it (input), chooses it (setting) or finds it (result).
    """

    value: float
    unit: str
    place: str
    printed: float
    why: str = ""
    certain: bool = True
    doubt: str = ""
    kind: str = "result"

    @property
    def is_misprint(self) -> bool:
        """Tell whether the paper prints another number."""
        return self.printed != self.value


@dataclass(frozen=True)
class Column:
    """One column of a printed table: quantity -> `Constant`, in printed order."""

    key: str
    place: str
    entries: Mapping[str, Constant]

    def __getitem__(self, quantity: str) -> float:
        return self.entries[quantity].value

    def get(self, quantity: str) -> float:
        """Return the value of `quantity`; NaN where the column has none."""
        return self.entries[quantity].value if quantity in self.entries else float("nan")

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)


@cache
def column(paper: str, key: str) -> Column:
    """Return the column `key` (``"table4.j3_12"``) of `paper` (``"cong2008"``)."""
    node: Any = document(paper)
    for part in key.split("."):
        node = node[part]
    place = node["place"]
    entries = {}
    for name, entry in node.items():
        if isinstance(entry, dict) and "value" in entry:
            entries[name] = Constant(
                value=float(entry["value"]), unit=entry["unit"], place=place,
                printed=float(entry["printed"] if "printed" in entry else entry["value"]), why=entry.get("why", ""),
                certain=entry.get("certain", True), doubt=entry.get("doubt", ""), kind=entry.get("kind", node["kind"]),
            )  # fmt: skip
    return Column(key, place, entries)


@cache
def document(paper: str) -> Mapping[str, Any]:
    """Return the parsed data file of `paper`."""
    return tomllib.loads(files("calibench.problems").joinpath(f"data/{paper}.toml").read_text(encoding="utf-8"))
