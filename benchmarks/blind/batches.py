"""Every batch of sealed cases ever drawn, on the page of the statistics: ``python -m benchmarks.blind.batches``.

``batches.json`` beside this file is the record. A batch is registered there, seeds and sizes, in a commit before a case
of it is drawn; ``--record N --reports FILE --sealed DIR`` enters what came of it, and the section of
docs/discovery-statistics.md between its two marks is written anew.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind.bars import verdict
from benchmarks.blind.score import Row, read as read_reports, score

BATCHES = Path(__file__).with_name("batches.json")
PAGE = Path(__file__).parents[2] / "docs" / "discovery-statistics.md"
BEGIN, END = "<!-- batches: written by python -m benchmarks.blind.batches -->", "<!-- end of the batches -->"
GROUPS = {"angles": "angles only", "x,y": "with x, y", "all": "all"}
SHOWN = {  # a row of the page: the row of the score, strict where names are counted
    "truth in the set, lambda 0.6-1": "truth in the set, strict, lambda 0.6-1",
    "truth in the set, lambda 1-4.05": "truth in the set, strict, lambda 1-4.05",
    "first name right where one is given, no twins, lambda >= 1": "first name right where one is given, strict, no "
    "twins, lambda >= 1",
    "mean set size, lambda >= .6": "mean set size, lambda >= .6",
    "both effects in sets, lambda >= 1": "both effects in sets, strict, lambda >= 1",
    "alarm on nothing, gauss": "alarm on nothing, gauss",
    "alarm on nothing, t3": "alarm on nothing, t3",
    "alarm on nothing, ar1": "alarm on nothing, ar1",
    "outside the catalogue: unknown, lambda 1-4.05": "outside the catalogue: unknown, lambda 1-4.05",
    "held-out rms over the floor after naming": "held-out rms over the floor after naming",
    "excess removed after naming": "excess removed after naming",
    "link error after gear or eccentricity, over no-effect's": "link error after gear or eccentricity, over "
    "no-effect's",
    "95 % interval of the amplitude covers": "95 % interval of the amplitude covers",
    "95 % interval of the gap covers": "95 % interval of the gap covers",
    "seconds a case": "seconds a case",
}


def read(path: Path) -> list[dict[str, Any]]:
    """Return the batches, in the order in which they were drawn."""
    batches: list[dict[str, Any]] = json.loads(path.read_text())
    return batches


def cells(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return what the page shows of a score: row -> group -> value, interval, number and bar."""
    named = {(row.what, row.data): row for row in rows if row.n}
    return {
        shown: {
            group: {k: getattr(row, k) for k in ("value", "low", "high", "n", "bar")}
            for group in GROUPS
            if (row := named.get((what, group))) is not None
        }
        for shown, what in SHOWN.items()
    }


def section(batches: Sequence[Mapping[str, Any]]) -> str:
    """Return the section of the page: the batches that were registered before they were drawn, seeds and results.

    Batches that were reported after they had been drawn stand in the record alone.
    """
    head = "| batch | registered | cases | nothing missing: gauss | t3 | ar1 | what |"
    lines = [BEGIN, "", head, "|---|---|---|---|---|---|---|"]
    registered = [batch for batch in batches if batch.get("rows") and str(batch["date"]).startswith("registered")]
    for batch in registered:
        drawn, date = batch["drawn"], str(batch["date"]).removeprefix("registered ")
        spans = [f"{drawn[k][0]}:{drawn[k][1]}" if k in drawn else "" for k in ("cases", "gauss", "t3", "ar1")]
        lines.append(f"| {batch['batch']} | {date} | {' | '.join(spans)} | {batch['what']} |")
    return "\n".join([*lines, "", *_table(registered), "", END])


def _table(batches: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [f"| bar | {' | '.join(str(batch['batch']) for batch in batches)} |", "|---" * (len(batches) + 1) + "|"]
    for what in SHOWN:
        of = [batch["rows"].get(what, {}) for batch in batches]
        bars = list(dict.fromkeys(cell["bar"] for groups in of for cell in groups.values() if cell["bar"]))
        shown = [_cell(groups["all"]) if "all" in groups else "" for groups in of]
        bar = f" ({' / '.join(bars)})" if bars else ""
        lines.append(f"| {what}{bar} | {' | '.join(shown)} |")
    return lines


def _cell(cell: Mapping[str, Any]) -> str:
    known = cell["low"] is not None
    interval = f" [{cell['low']:.3f}, {cell['high']:.3f}]" if known else ""
    outcome = verdict(cell["low"], cell["high"], cell["bar"])
    return f"{cell['value']:.3f}{interval} of {cell['n']}{f': {outcome}' if outcome else ''}"


def main(arguments: list[str] | None = None) -> None:
    """Enter a batch's result, if asked to, and write the section of the page anew."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.batches", description=__doc__)
    parser.add_argument("--record", type=int, metavar="BATCH")
    parser.add_argument("--reports", type=Path, help="lines of JSON, one a case")
    parser.add_argument("--sealed", type=Path, help="folder of the truths")
    asked = parser.parse_args(arguments)
    batches = read(BATCHES)
    if asked.record is not None:
        [batch] = [b for b in batches if b["batch"] == asked.record]
        pairs, unanswered = read_reports(asked.reports, asked.sealed)
        if unanswered or batch.get("rows"):
            raise SystemExit(f"batch {asked.record} has its result, or {len(unanswered)} cases have no report")
        batch["rows"] = cells(score(pairs))
        BATCHES.write_text(json.dumps(batches, indent=1) + "\n")
    page = PAGE.read_text()
    first, last = page.index(BEGIN), page.index(END) + len(END)
    PAGE.write_text(page[:first] + section(batches) + page[last:])


if __name__ == "__main__":
    main()
