"""The printed numbers of a paper as rows to be filled: one for each quantity of its data file, by its key."""

import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from decimal import Decimal
from functools import cache
from importlib.resources import files
from math import nan
from typing import Any, final

from calibench.bench.papers.row import NO_TOLERANCE, NOTHING, Ours, Row, Ruling, Tolerance, judge_near
from calibench.problems.constants import Column, Constant, column

Numbers = Ours | Iterable[float] | float


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
class Printed:
    """The cells of one paper: makes their rows, with a verdict from `judge` unless another is given."""

    def __init__(self, paper: str) -> None:
        self.paper = paper

    def column(self, key: str) -> Column:
        return column(self.paper, key)

    def digit(self, key: str) -> float:
        """Return what one unit of the last printed digit of the cell `key` is worth."""
        node = _exact(self.paper)
        for part in key.split("."):
            node = node[part]
        literal = node.get("printed", node["value"])
        return float(Decimal(1).scaleb(int(literal.as_tuple().exponent))) if isinstance(literal, Decimal) else 1.0

    def cell(
        self, key: str, ours: Numbers, tolerance: Tolerance, method: str, *, reason: str = "",
        ruling: Ruling | None = None, of_print: bool = False,
    ) -> Row:  # fmt: skip
        """Return the row of the cell `key`; with `of_print` ours is made of other numbers that the paper found."""
        name, _, quantity = key.rpartition(".")
        entry, ours = column(self.paper, name).entries[quantity], Ours.of(ours)
        inferred = "" if entry.certain else " (inferred, not seen in another print)"
        ruling = ruling or judge_near(entry.printed, entry.value, ours.median, tolerance)
        kind: Any = "consistency" if of_print else entry.kind
        about, differs = key, ""  # of a number that is printed again: where it stands first, why verdicts may differ
        for group in _exact(self.paper).get("one_print", ()):
            if key in group["keys"]:
                about, differs = group["keys"][0], group.get("differs", "")
        return Row(
            paper=self.paper, key=key, kind=kind, about=about, place=entry.place,
            quantity=quantity, unit=entry.unit, printed=float(entry.printed), read=float(entry.value),
            reason=_one_line(reason, entry.why.strip() + inferred, entry.doubt), differs=differs, method=method,
            **_judged(ours, tolerance, ruling),
        )  # fmt: skip

    def unknown(self, key: str, reason: str = "", method: str = "none: data not published") -> Row:
        """Return the row of a cell about which nothing can be computed."""
        return self.cell(key, NOTHING, NO_TOLERANCE, method, reason=reason)

    def claim(
        self, key: str, place: str, sentence: str, *, ours: Numbers, ruling: Ruling, rule: str, method: str,
        reason: str = "", unit: str = "1", printed: float = nan, about: str = "", differs: str = "",
        read: float | None = None,
    ) -> Row:  # fmt: skip
        """Return the row of a sentence: `ours` measures it, `rule` says when it is true; `about` names the printed
        numbers that it repeats, `differs` why its verdict may be another than theirs, `read` what is to be read."""
        ours = Ours.of(ours)
        ruling = ruling if ours.n else replace(ruling, verdict="not checkable")
        return Row(
            paper=self.paper, key=f"claim.{key}", kind="claim", about=about, place=place, quantity=sentence, unit=unit,
            printed=float(printed), read=float(printed if read is None else read), reason=_one_line(reason),
            differs=differs, method=method, **_judged(ours, Tolerance(ruling.limit, rule), ruling),
        )  # fmt: skip

    def erratum(
        self, place: str, quantity: str, *, unit: str, printed: float, read: float, ours: Numbers, tolerance: Tolerance,
        method: str, ruling: Ruling | None = None, differs: str = "",
    ) -> Row:  # fmt: skip
        """Return the row of the erratum at `place` in the data file: of a `quantity`, what the computation shows."""
        errata = _exact(self.paper)["erratum"]
        number = [entry["place"] for entry in errata].index(place)
        entry, ours = errata[number], Ours.of(ours)
        inferred = "" if entry["certain"] else " (inferred)"
        ruling = ruling or judge_near(printed, read, ours.median, tolerance)
        return Row(
            paper=self.paper, key=f"erratum.{number + 1}", kind="erratum", about=" ".join(entry.get("about", ())),
            place=place, quantity=quantity, unit=unit, printed=float(printed), read=float(read),
            reason=_one_line(f"printed: {entry['printed']}; read: {entry['read']}; {entry['why']}{inferred}"),
            differs=differs, method=method, **_judged(ours, tolerance, ruling),
        )  # fmt: skip

    def in_order(self, errata: Iterable[Row]) -> Iterator[Row]:
        """Yield the rows of all errata in the data file's order. Raises `KeyError` for one without a row."""
        by_place = {row.place: row for row in errata}
        for entry in _exact(self.paper)["erratum"]:
            yield by_place[entry["place"]]


def _judged(ours: Ours, tolerance: Tolerance, ruling: Ruling) -> dict[str, Any]:
    """Return the columns that follow from these: limits are the ruling's numbers and the tolerance's words."""
    return {
        "ours_median": ours.median, "ours_q1": ours.q1, "ours_q3": ours.q3, "n": ours.n, "verdict": ruling.verdict,
        "judged": float(ruling.judged), "rule": ruling.rule, "tolerance": float(ruling.limit),
        "tolerance_in_kind": float(ruling.in_kind), "tolerance_in_decades": ruling.decades,
        "tolerance_origin": float(tolerance.origin), "share": float(ruling.share), "why_tolerance": tolerance.why,
    }  # fmt: skip


def _one_line(*texts: str) -> str:
    return " ".join("; ".join(text for text in texts if text).split())


@cache
def _exact(paper: str) -> dict[str, Any]:
    """Return the data file with its decimals as they are written: digits are part of what is printed."""
    text = files("calibench.problems").joinpath(f"data/{paper}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text, parse_float=Decimal)
