"""Two ledgers beside each other, what changed and why: `python -m calibench.bench.papers.compare BEFORE AFTER`.

BEFORE and AFTER are ``ledger.csv`` or ``ledger.parquet`` files of any schema. A row is matched by its key, an erratum
by its place and quantity, as its number depends on those before it. The reason of a change is read off the two rows:
what is computed, what is held to be right, the band, or the rule by which a verdict is given.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import pandas as pd

from calibench.bench.papers.row import KINDS, VERDICTS
from calibench.core.words import listed

_SAME = 1e-9
_SHOWN = 6  # keys of a group


def read_ledger(path: Path) -> pd.DataFrame:
    """Return a ledger by what its rows are: paper and key, of an erratum place and quantity."""
    table = pd.read_parquet(BytesIO(path.read_bytes())) if path.suffix == ".parquet" else pd.read_csv(path)
    place = table["place"] + ": " + table["quantity"]
    name = place.where(table["key"].str.startswith("erratum."), table["key"])
    return table.assign(name=table["paper"] + " " + name).set_index("name")


def tallies(before: pd.DataFrame, after: pd.DataFrame) -> list[str]:
    """Return lines of Markdown: rows of each verdict before and after, and after by kind."""
    kinds = [kind for kind in KINDS if "kind" in after]
    lines = [f"| verdict | before | after | {' | '.join(kinds)} |", "|" + "---|" * (3 + len(kinds))]
    for verdict in VERDICTS:
        mine = after[after["verdict"] == verdict]
        numbers = [int((before["verdict"] == verdict).sum()), len(mine)]
        numbers += [int((mine["kind"] == kind).sum()) for kind in kinds]
        lines.append(f"| {verdict} | {' | '.join(map(str, numbers))} |")
    totals = [len(before), len(after), *(int((after["kind"] == kind).sum()) for kind in kinds)]
    return [*lines, f"| all | {' | '.join(map(str, totals))} |"]


def changes(before: pd.DataFrame, after: pd.DataFrame) -> list[tuple[str, str, str, list[str]]]:
    """Return (verdict before, verdict after, why, names of the rows), the largest group first."""
    groups: dict[tuple[str, str, str], list[str]] = {}
    for name in dict.fromkeys([*before.index, *after.index]):
        if name not in after.index:
            change = (str(before.at[name, "verdict"]), "", "dropped")
        elif name not in before.index:
            change = ("", str(after.at[name, "verdict"]), "new")
        else:
            was, now = (str(table.at[name, "verdict"]) for table in (before, after))
            if was == now:
                continue
            change = (was, now, reason(before.loc[name], after.loc[name]))
        groups.setdefault(change, []).append(str(name))
    return sorted(((*change, names) for change, names in groups.items()), key=lambda group: -len(group[3]))


def reason(before: pd.Series, after: pd.Series) -> str:
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
    """Return the comparison in Markdown."""
    lines = [*tallies(before, after), "", "| rows | before | after | why | which |", "|---|---|---|---|---|"]
    for was, now, why, names in changes(before, after):
        keys = listed([name.partition(" ")[2] for name in names], _SHOWN)
        papers = ", ".join(dict.fromkeys(name.partition(" ")[0] for name in names))
        cells = [str(len(names)), was or "-", now or "-", why, f"{papers}: {keys}"]
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str]) -> int:
    """Print the comparison of two ledgers."""
    if len(arguments) != 2:
        usage = "python -m calibench.bench.papers.compare BEFORE AFTER: two files, ledger.csv or ledger.parquet"
        print(usage, file=sys.stderr)
        return 2
    print(page(*(read_ledger(Path(name)) for name in arguments)), end="")
    return 0


def _near(a: float, b: float) -> bool:
    if pd.isna(a) or pd.isna(b):
        return bool(pd.isna(a) and pd.isna(b))
    return abs(a - b) <= _SAME * max(abs(a), abs(b))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
