"""Score reports against sealed truths: ``python -m benchmarks.blind.score --reports FILE --sealed DIR [--json]``.

FILE holds a line of JSON a case, as ``bench discover --json`` prints them. All rates come with their 95 % binomial
intervals (Clopper-Pearson), medians with that of the order statistics, means with Student's. A bar is met where the
whole interval lies on its good side, missed where it lies on the bad one, and open where it holds the bar.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import beta

from benchmarks.blind.bars import Verdict, mean_interval, median_interval, verdict
from benchmarks.blind.claims import (
    Report,
    Truth,
    amplitude_covered,
    first_right,
    gap_covered,
    in_sets,
    is_twin,
    length_error,
    named_set,
    true_names,
)
from benchmarks.blind.gpm2002.noise import LAWS

BINS = ((0.4, 0.6), (0.6, 1.0), (1.0, 1.5), (1.5, 2.5), (2.5, 4.05))
# what a refusal leaves out: it counts as an answer that finds nothing
BLANK = {"verdict": "refused", "findings": [], "gap": {}, "parameters": {}}
Pair = tuple[Report, Truth]


@dataclass(frozen=True)
class Row:
    """One line of the table. `low`, `high`: the 95 % interval of the value, None where there are too few.

    `reached`: the value of a mean or median is on the good side of the bar, a rate's interval not whole on the bad one:
    what the slow tests ask of samples too small to meet a bar. None without a bar.
    """

    what: str
    data: str
    n: int
    value: float | None
    low: float | None = None
    high: float | None = None
    bar: str = ""
    reached: bool | None = None

    @property
    def verdict(self) -> Verdict | None:
        """Return met, open or missed, from the whole interval; None without a bar or an interval."""
        return verdict(self.low, self.high, self.bar)


def read(reports: Path, sealed: Path) -> tuple[list[Pair], list[str]]:
    """Return (report, truth) of each line of `reports`, and the truths that no line answers."""
    truths = {p.stem: json.loads(p.read_text()) for p in sorted(sealed.glob("*.json"))}
    lines = [BLANK | json.loads(line) for line in reports.read_text().splitlines() if line.strip()]
    lines = [{key: BLANK.get(key) if value is None else value for key, value in line.items()} for line in lines]
    if not lines:
        raise ValueError(f"--reports: {reports} holds no report; a line of JSON a case is needed")
    strangers = sorted({line["case"] for line in lines} - set(truths))
    if strangers:
        raise ValueError(f"--reports: no truth in {sealed} for {', '.join(strangers[:5])}")
    answered = {line["case"] for line in lines}
    return [(line, truths[line["case"]]) for line in lines], sorted(set(truths) - answered)


def score(pairs: Sequence[Pair]) -> list[Row]:
    """Return the table of all bars."""
    rows: list[Row] = []
    for group in ("angles", "x,y", "all"):
        mine = [(r, t) for r, t in pairs if group == "all" or t["xy"] == (group == "x,y")]
        if mine:
            rows += _naming(mine, group) + _alarms(mine, group) + _outside(mine, group) + _closing(mine, group)
    return rows


def misses(pairs: Sequence[Pair]) -> list[str]:
    """Return a line for each case that was told wrongly (leniently seen), the most visible first."""
    lines = []
    for r, t in pairs:
        true = true_names(t)
        if t["kind"] == "none":
            wrong = r["verdict"] != "none"
        elif t["kind"] == "outside":
            wrong = r["verdict"] != "unknown"
        else:
            wrong = _testable(t) and not all(in_sets(name, r, lenient=True) for name in true)
        if wrong:
            there = " + ".join(f"{e['family']} {e['target']} ({e['lambda']:.2f})" for e in t["effects"]) or "nothing"
            sets = ["|".join(" ".join(name).strip() for name in named_set(f)) for f in r["findings"]]
            told = f"{r['verdict']} {'; '.join(sets)}".strip()
            line = f"{t['case']}  {'x,y' if t['xy'] else 'angles':6} {t['noise']:5} {there}  ->  {told}"
            lines.append((_lambda(t) if t["effects"] else 9.0, line))
    return [line for _, line in sorted(lines, key=lambda one: -one[0])]


def _naming(pairs: Sequence[Pair], group: str) -> list[Row]:
    one = [(r, t) for r, t in pairs if t["kind"] == "one" and _testable(t)]
    rows = []
    for low, high in [*BINS, (1.0, 4.05)]:
        some = [(r, t) for r, t in one if low <= _lambda(t) < high]
        bar = 0.97 if low >= 1 else 0.93 if low >= 0.6 else None
        for word, lenient in (("strict", False), ("lenient", True)):
            hits = [in_sets(true_names(t)[0], r, lenient) for r, t in some]
            rows.append(_rate(f"truth in the set, {word}, lambda {low:g}-{high:g}", group, hits, bar))
    apart = [(r, t) for r, t in one if _lambda(t) >= 1 and not is_twin(true_names(t)[0], t["xy"])]
    bar = {"angles": 0.95, "x,y": 0.97}.get(group)
    for word, lenient in (("strict", False), ("lenient", True)):
        named = [(r, t) for r, t in apart if r["findings"]]
        hits = [first_right(true_names(t)[0], r, lenient) for r, t in named]
        rows.append(_rate(f"first name right where one is given, {word}, no twins, lambda >= 1", group, hits, bar))
    sizes = [len(named_set(f)) for r, t in one if _lambda(t) >= 0.6 for f in r["findings"]]
    mean = float(np.mean(sizes)) if sizes else None
    low_size, high_size = mean_interval(sizes)
    reached = None if mean is None else mean <= 1.4
    rows.append(Row("mean set size, lambda >= .6", group, len(sizes), mean, low_size, high_size, "<= 1.4", reached))
    blind = [(r, t) for r, t in pairs if t["kind"] == "one" and t["withheld"]]
    hits = [bool(r["findings"]) and not in_sets(true_names(t)[0], r, lenient=True) for r, t in blind]
    rows.append(_rate("another name where the needed columns are missing", group, hits, None))
    two = [(r, t) for r, t in pairs if t["kind"] == "two" and _testable(t)]
    for low in (0.0, 1.0):
        some = [(r, t) for r, t in two if _lambda(t) >= low]
        for word, lenient in (("strict", False), ("lenient", True)):
            hits = [all(in_sets(true, r, lenient) for true in true_names(t)) for r, t in some]
            rows.append(_rate(f"both effects in sets, {word}, lambda >= {low:g}", group, hits, 0.90 if low else None))
    return rows


def _alarms(pairs: Sequence[Pair], group: str) -> list[Row]:
    rows = []
    for law in LAWS:
        empty = [r for r, t in pairs if t["kind"] == "none" and t["noise"] == law]
        hits = [r["verdict"] != "none" for r in empty]
        rows.append(_rate(f"alarm on nothing, {law}", group, hits, 0.015 if law == "gauss" else 0.03, at_most=True))
        hits = [r["verdict"] not in {"none", "negligible"} for r in empty]
        rows.append(_rate(f"alarm on nothing, negligible left out, {law}", group, hits, None))
    return rows


def _outside(pairs: Sequence[Pair], group: str) -> list[Row]:
    outside = [(r, t) for r, t in pairs if t["kind"] == "outside"]
    rows = []
    for low, high in [*BINS, (1.0, 4.05), (0.4, 4.05)]:
        some = [r for r, t in outside if low <= _lambda(t) < high]
        bar = {"angles": 0.85, "x,y": 0.95}.get(group) if (low, high) == (1.0, 4.05) else None
        hits = [r["verdict"] == "unknown" for r in some]
        rows.append(_rate(f"outside the catalogue: unknown, lambda {low:g}-{high:g}", group, hits, bar))
    seen = [r for r, t in outside if r["verdict"] not in {"none", "negligible"}]
    rows.append(
        _rate("outside the catalogue: unknown, of those seen", group, [r["verdict"] == "unknown" for r in seen], None)
    )
    return rows


def _closing(pairs: Sequence[Pair], group: str) -> list[Row]:
    one = [(r, t) for r, t in pairs if t["kind"] == "one" and _testable(t) and _lambda(t) >= 0.6]
    named = [(r, t) for r, t in one if r["verdict"] in {"named", "ambiguous"}]
    right = [(r, t) for r, t in named if in_sets(true_names(t)[0], r, lenient=True)]
    over = _numbers(_ratio(r["gap"].get("held_out_after"), r["gap"].get("noise_floor")) for r, _ in named)
    shrink = _numbers(r["gap"].get("excess_shrink") for r, _ in named)
    rows = [
        _median("held-out rms over the floor after naming", group, over, "<= 1.08", lambda v: v <= 1.08),
        _median("excess removed after naming", group, shrink, ">= 0.85", lambda v: v >= 0.85),
    ]
    bent = {"gear", "eccentricity"}
    ratios: list[float] = []
    for xy in (False, True):  # what a tracker sees of the links, angles do not: each against its own
        empty = _numbers(length_error(r, t) for r, t in pairs if t["kind"] == "none" and t["xy"] == xy)
        mine = [(r, t) for r, t in right if true_names(t)[0][0] in bent and t["xy"] == xy]
        ratios += [value / float(np.median(empty)) for value in _numbers(length_error(*pair) for pair in mine) if empty]
    rows.append(_median("link error after gear or eccentricity, over no-effect's", group, ratios, "<= 3", _three))
    for what, hits in (
        ("amplitude", [amplitude_covered(r, t) for r, t in right]),
        ("gap", [gap_covered(r) for r, _ in right]),
    ):
        known = [hit for hit in hits if hit is not None]
        row = _rate(f"95 % interval of the {what} covers", group, known, None)
        inside = None if row.low is None or row.high is None else row.high >= 0.90 and row.low <= 0.98
        rows.append(Row(row.what, group, row.n, row.value, row.low, row.high, "0.90-0.98", inside))
    seconds = _numbers(r.get("seconds") for r, _ in pairs)
    rows.append(_median("seconds a case", group, seconds, "< 0.5", lambda v: v < 0.5))
    return rows


def _testable(truth: Truth) -> bool:
    return not truth["withheld"] and not any(effect["invisible"] for effect in truth["effects"])


def _lambda(truth: Truth) -> float:
    return float(min(effect["lambda"] for effect in truth["effects"]))


def _rate(what: str, group: str, hits: Iterable[bool], bar: float | None, at_most: bool = False) -> Row:
    marks = list(hits)
    n, k = len(marks), sum(marks)
    if n == 0:
        return Row(what, group, 0, None)
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    if bar is None:
        return Row(what, group, n, k / n, low, high)
    reached = bar >= low if at_most else bar <= high
    return Row(what, group, n, k / n, low, high, f"{'<=' if at_most else '>='} {bar:g}", reached)


def _median(what: str, group: str, values: Sequence[float], bar: str, holds: Callable[[float], bool]) -> Row:
    if not values:
        return Row(what, group, 0, None, bar=bar)
    middle, (low, high) = float(np.median(values)), median_interval(values)
    return Row(what, group, len(values), middle, low, high, bar, holds(middle))


def _numbers(values: Iterable[float | None]) -> list[float]:
    return [float(v) for v in values if v is not None and np.isfinite(v)]


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def _three(value: float) -> bool:
    return value <= 3.0


def table(rows: Sequence[Row]) -> str:
    """Return the rows as text, each with its interval and what it says of the bar."""

    def number(v: float | None) -> str:
        return "-" if v is None else f"{v:.3f}"

    width = max(len(row.what) for row in rows)
    lines = [f"{'':{width}}  data      n   value  [  low   high]  bar"]
    for r in rows:
        mark = "" if not r.bar or not r.n else r.verdict or "too few"
        found = f"{r.n:4d}  {number(r.value):>6}  [{number(r.low):>6} {number(r.high):>6}]"
        lines.append(f"{r.what:{width}}  {r.data:6} {found}  {r.bar:9}  {mark}".rstrip())
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Print the table that the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.score", description=__doc__)
    parser.add_argument("--reports", type=Path, required=True, help="lines of JSON, one a case")
    parser.add_argument("--sealed", type=Path, required=True, help="folder of the truths")
    parser.add_argument("--json", action="store_true", help="rows as JSON instead of text")
    parser.add_argument("--misses", action="store_true", help="below the table, a line for each case told wrongly")
    asked = parser.parse_args(arguments)
    pairs, unanswered = read(asked.reports, asked.sealed)
    rows = score(pairs)
    if asked.json:
        print(json.dumps({"unanswered": unanswered, "rows": [asdict(row) | {"verdict": row.verdict} for row in rows]}))
        return
    print(table(rows))
    if asked.misses:
        print("\n".join(misses(pairs)))
    if unanswered:
        print(f"{len(unanswered)} truths without a report: {', '.join(unanswered[:5])} ...")


if __name__ == "__main__":
    main()
