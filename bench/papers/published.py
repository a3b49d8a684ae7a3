"""The printed numbers of a paper as rows to be filled: one for each quantity of its data file, by its key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cache
from importlib.resources import files
from math import nan
from typing import Any, final

from calibench.bench.papers.row import NOTHING, Kind, Ours, Row, Ruling, Tolerance, judge_near, make_row
from calibench.problems.constants import Column, Constant, column


def quantities(paper: str) -> dict[str, Constant]:
    """Return every printed number of `paper` by its key, such as ``table3.j1.la3``, in printed order."""
    numbers: dict[str, Constant] = {}

    def walk(node: Any, path: str) -> None:
        if not isinstance(node, dict):
            return
        if "place" in node:
            for name, constant in column(paper, path).entries.items():
                numbers[f"{path}.{name}"] = constant
        for name, below in node.items():
            if isinstance(below, dict) and "value" not in below:
                walk(below, f"{path}.{name}".lstrip("."))

    walk(_exact(paper), "")
    return numbers


@final
@dataclass(frozen=True, kw_only=True)
class Shown:
    """What a computation shows of an erratum: a `quantity` as `printed`, as it is to be `read`, and ours."""

    quantity: str
    unit: str
    printed: float
    read: float
    ours: Iterable[float] | float
    tolerance: Tolerance
    method: str
    ruling: Ruling | None = None
    differs: str = ""


@final
class Printed:
    """The cells of one paper: makes their rows, with a verdict from `judge` unless another is given."""

    def __init__(self, paper: str) -> None:
        self.paper = paper

    def column(self, key: str) -> Column:
        """Return a printed column."""
        return column(self.paper, key)

    def digit(self, key: str) -> float:
        """Return what one unit of the last printed digit of the cell `key` is worth."""
        node = _exact(self.paper)
        for part in key.split("."):
            node = node[part]
        literal = node.get("printed", node["value"])
        return float(Decimal(1).scaleb(int(literal.as_tuple().exponent))) if isinstance(literal, Decimal) else 1.0

    def cell(
        self,
        key: str,
        ours: Ours | Iterable[float] | float,
        tolerance: Tolerance,
        method: str,
        *,
        reason: str = "",
        ruling: Ruling | None = None,
        of_print: bool = False,
    ) -> Row:
        """Return the row of the cell `key`. What the data file says against the print comes after `reason`.

        With `of_print` ours is made of other numbers that the paper found: the row tests the print against itself.
        """
        name, _, quantity = key.rpartition(".")
        entry = column(self.paper, name).entries[quantity]
        result = ours if isinstance(ours, Ours) else Ours.of(ours)
        inferred = "" if entry.certain else " (inferred, not seen in another print)"
        kind: Kind = "consistency" if of_print else entry.kind  # type: ignore[assignment]
        about, differs = one_print(self.paper).get(key, (key, ""))
        return make_row(
            paper=self.paper,
            key=key,
            kind=kind,
            about=about,
            place=entry.place,
            quantity=quantity,
            unit=entry.unit,
            printed=entry.printed,
            read=entry.value,
            ours=result,
            tolerance=tolerance,
            ruling=ruling or judge_near(entry.printed, entry.value, result.median, tolerance),
            reason="; ".join(text for text in (reason, entry.why.strip() + inferred, entry.doubt) if text),
            method=method,
            differs=differs,
        )

    def unknown(self, key: str, reason: str) -> Row:
        """Return the row of a cell about which nothing can be computed: its data are not published."""
        nothing = Tolerance(nan, "nothing to compare with")
        return self.cell(key, NOTHING, nothing, "none: data not published", reason=reason)

    def claim(
        self,
        key: str,
        place: str,
        sentence: str,
        *,
        ours: Ours | Iterable[float] | float,
        ruling: Ruling,
        rule: str,
        method: str,
        reason: str = "",
        unit: str = "1",
        printed: float = nan,
        about: str = "",
        differs: str = "",
        read: float | None = None,
    ) -> Row:
        """Return the row of a sentence: `ours` measures it, `rule` says which numbers make it true.

        `about` names the printed numbers (keys, a space between) that the sentence repeats, and `differs` why this
        row's verdict may be another than theirs. `read` is what is to be read, where that is not what is `printed`.
        """
        result = ours if isinstance(ours, Ours) else Ours.of(ours)
        return make_row(
            paper=self.paper,
            key=f"claim.{key}",
            kind="claim",
            about=about,
            place=place,
            quantity=sentence,
            unit=unit,
            printed=printed,
            read=printed if read is None else read,
            ours=result,
            tolerance=Tolerance(ruling.limit, rule),
            ruling=ruling if result.n else replace(ruling, verdict="not checkable"),
            reason=reason,
            method=method,
            differs=differs,
        )

    def erratum(self, place: str, shown: Shown) -> Row:
        """Return the row of the erratum at `place` in the data file, of which a computation has `shown` this."""
        number = self.errata().index(place)
        entry = _exact(self.paper)["erratum"][number]
        inferred = "" if entry["certain"] else " (inferred)"
        ours = Ours.of(shown.ours)
        return make_row(
            paper=self.paper,
            key=f"erratum.{number + 1}",
            kind="erratum",
            about=" ".join(entry.get("about", ())),
            place=place,
            quantity=shown.quantity,
            unit=shown.unit,
            printed=shown.printed,
            read=shown.read,
            ours=ours,
            tolerance=shown.tolerance,
            ruling=shown.ruling or judge_near(shown.printed, shown.read, ours.median, shown.tolerance),
            reason=f"printed: {entry['printed']}; read: {entry['read']}; {entry['why']}{inferred}",
            method=shown.method,
            differs=shown.differs,
        )

    def errata(self) -> list[str]:
        """Return the places of the data file's errata, in its order."""
        return [str(entry["place"]) for entry in _exact(self.paper)["erratum"]]

    def to_read(self, place: str) -> float:
        """Return the number that the erratum at `place` says is to be read."""
        return float(_exact(self.paper)["erratum"][self.errata().index(place)]["value"])


def one_print(paper: str) -> dict[str, tuple[str, str]]:
    """Return for each number that is printed again the key where it is told first, and why verdicts may differ."""
    groups = _exact(paper).get("one_print", ())
    return {key: (group["keys"][0], group.get("differs", "")) for group in groups for key in group["keys"]}


@cache
def _exact(paper: str) -> dict[str, Any]:
    """Return the data file with its decimals as they are written: digits are part of what is printed."""
    text = files("calibench.problems").joinpath(f"data/{paper}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text, parse_float=Decimal)
