"""Two ledgers beside each other, what changed and why: `python -m calibench.bench.papers.compare BEFORE AFTER`.

A row of these ``ledger.csv`` or ``ledger.parquet`` files is matched by its key, an erratum by its place and quantity,
as its number depends on those before it. The reason of a change is read off the two rows.
"""

import sys
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import pandas as pd

from calibench.bench.papers.ledger import KINDS, VERDICTS
from calibench.core.words import listed

_SAME = 1e-9
_SHOWN = 6  # keys of a group


def reason(before: Mapping[Any, Any], after: Mapping[Any, Any]) -> str:
    """Return what differs between two rows of one print, in the order in which it decides a verdict."""
    parts = []
    if not _near(before["read"], after["read"]):
        parts.append(f"to be read is {after['read']:.6g}: an erratum says so")
    if before["method"] != after["method"]:
        parts.append(f"computed by {after['method']}")
    elif not _near(before["ours_median"], after["ours_median"]):
        parts.append("the runs give another number")
    if before["why_tolerance"] != after["why_tolerance"]:
        parts.append(f"judged by: {after['why_tolerance']}")
    elif any(not _near(before[name], after[name]) for name in ("tolerance", "tolerance_in_kind")):
        parts.append("the band has another width")
    return "; ".join(parts) or "the rule of the verdict"


def page(before: pd.DataFrame, after: pd.DataFrame) -> str:
    """Return the comparison in Markdown: rows of each verdict before and after, and after by kind; then each change."""
    kinds = [kind for kind in KINDS if "kind" in after]
    lines = [f"| verdict | before | after | {' | '.join(kinds)} |", "|" + "---|" * (3 + len(kinds))]
    for verdict in (*VERDICTS, "all"):
        was, now = (table if verdict == "all" else table[table["verdict"] == verdict] for table in (before, after))
        numbers = [len(was), len(now), *(int((now["kind"] == kind).sum()) for kind in kinds)]
        lines.append(f"| {verdict} | {' | '.join(map(str, numbers))} |")
    groups: dict[tuple[str, str, str], list[str]] = {}  # verdict before, verdict after, and why: names of the rows
    rows, later = before.to_dict("index"), after.to_dict("index")
    for name in dict.fromkeys([*rows, *later]):
        old, new = (str(table[name]["verdict"]) if name in table else "-" for table in (rows, later))
        if old == new:
            continue
        why = "new" if old == "-" else "dropped" if new == "-" else reason(rows[name], later[name])
        groups.setdefault((old, new, why), []).append(str(name))
    lines += ["", "| rows | before | after | why | which |", "|---|---|---|---|---|"]
    for change, names in sorted(groups.items(), key=lambda group: -len(group[1])):
        keys = listed([name.partition(" ")[2] for name in names], _SHOWN)
        papers = ", ".join(dict.fromkeys(name.partition(" ")[0] for name in names))
        cells = [str(len(names)), *change, f"{papers}: {keys}"]
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str]) -> int:
    if len(arguments) != 2:
        usage = "python -m calibench.bench.papers.compare BEFORE AFTER: two files, ledger.csv or ledger.parquet"
        print(usage, file=sys.stderr)
        return 2
    ledgers = []
    for path in map(Path, arguments):
        table = pd.read_parquet(BytesIO(path.read_bytes())) if path.suffix == ".parquet" else pd.read_csv(path)
        place = table["place"] + ": " + table["quantity"]
        name = place.where(table["key"].str.startswith("erratum."), table["key"])
        ledgers.append(table.assign(name=table["paper"] + " " + name).set_index("name"))
    print(page(*ledgers), end="")
    return 0


def _near(a: float, b: float) -> bool:
    if pd.isna(a) or pd.isna(b):
        return bool(pd.isna(a) and pd.isna(b))
    return abs(a - b) <= _SAME * max(abs(a), abs(b))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
