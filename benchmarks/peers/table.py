"""Write the page of peers, ours and the sealed truths beside theirs: ``python -m benchmarks.peers.table``.

Excess removed is 1 - (after - 1) / (before - 1) on held-out rows, in squares of sigma, where `after - 1` counts as zero
below zero; cases whose excess before is under .1 have none to remove and are left out. A name is right where the first
one given is the true family and target, or its declared twin; nothing named is not right.
"""

from __future__ import annotations

import argparse
import json
from importlib.metadata import version
from pathlib import Path

import pandas as pd

from benchmarks.blind.claims import is_twin, name, true_names
from calibench.bench.provenance.environment import provenance

OURS = "this package"
MARK = "<!-- make peers writes from here to the end -->"  # what stands before it is written by hand
BINS = (0.4, 0.6, 1.0, 1.5, 2.5, 4.1)
_LEAST = 0.1  # of excess before, in sigma squared
_TWINS = ({"compliance", "proximal_bending"}, {"thermal_links", "thermal_base"})


def main() -> None:
    """Write the page and the rows it was made of."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers.table", description=__doc__)
    parser.add_argument("results", type=Path, help="folder with ours.jsonl and rivals.jsonl")
    parser.add_argument("--sealed", type=Path, required=True)
    parser.add_argument("--page", type=Path, default=Path("docs/peers.md"))
    parser.add_argument("--versions", default="", help="of the peers' packages")
    asked = parser.parse_args()
    rows = scored(asked.results, asked.sealed)
    rows.to_parquet(asked.results / "peers.parquet", index=False)
    kept, mark, _ = asked.page.read_text().partition(MARK)
    if not mark:
        raise SystemExit(f"{asked.page}: the line {MARK!r} is not there")
    asked.page.write_text(f"{kept}{mark}\n\n{page(rows, asked.versions)}")


def scored(results: Path, sealed: Path) -> pd.DataFrame:
    """Return a row a case and method: lambda, excess removed, whether the first name is right, CPU seconds."""
    lines = [json.loads(line) for file in ("ours", "rivals") for line in (results / f"{file}.jsonl").open()]
    before = {line["case"]: line["mean_square_before"] for line in lines if line["method"] == OURS}
    rows = []
    for line in lines:
        truth = json.loads((sealed / f"{line['case']}.json").read_text())
        excess = before[line["case"]] - 1
        effects = truth["effects"]
        rows.append(
            {
                "case": line["case"],
                "method": line["method"],
                "kind": truth["kind"],
                "data": "x, y" if truth["xy"] else "angles",
                "size": min((effect["lambda"] for effect in effects), default=0.0),
                "removed": 1 - max(line["mean_square_after"] - 1, 0.0) / excess if excess > _LEAST else None,
                "added": line["mean_square_after"] / before[line["case"]] - 1 if not effects else None,
                "named": bool(line["named"]),
                "right": _right(line["named"], truth) if truth["kind"] == "one" and not truth["withheld"] else None,
                "cpu_s": line["cpu_s"],
            }
        )
    return pd.DataFrame(rows)


def _right(named: list[str], truth: dict) -> bool:  # type: ignore[type-arg]
    if not named:
        return False
    first, (true,) = name(*named[0].split(" ", 1)), true_names(truth)
    if first == true:
        return True
    same = is_twin(true, truth["xy"]) and any({first[0], true[0]} <= twins for twins in _TWINS)
    return same and (first[1] == true[1] or true[0].startswith("thermal"))


def page(rows: pd.DataFrame, versions: str) -> str:
    """Return the page."""
    order = [OURS, *sorted(set(rows["method"]) - {OURS})]
    hidden = rows[rows["kind"] != "none"].dropna(subset=["removed"])
    made = provenance()
    parts = [
        "## Peers on the same sealed cases\n",
        "`make peers` makes cases with hidden effects, an environment of their own for the peers, and this page.\n"
        "What the peers get, and how they are set: `benchmarks/peers/`. The selectors are given our whole catalogue\n"
        "as their library, whitened and projected off the calibration; the Gaussian process all covariates.\n",
        f"{rows['case'].nunique()} cases, commit {made['git_commit'][:10]}, calibench {version('calibench')}"
        + (f"; {versions}" if versions else "")
        + ".\n",
        "### Excess removed on held-out readings, median (quartiles), by visible size of the smallest effect\n",
        _by_size(hidden, order),
        "### By what was hidden\n",
        _by_kind(hidden, order),
        "### Naming and time\n",
        _naming(rows, order),
    ]
    return "\n".join(parts)


def _by_size(hidden: pd.DataFrame, order: list[str]) -> str:
    cells = pd.cut(hidden["size"], BINS, right=False)
    bins = [(b, hidden[cells == b]) for b in cells.cat.categories if (cells == b).any()]
    heads = [f"{b.left:g}-{b.right:g} sigma (n={held['case'].nunique()})" for b, held in bins]
    lines = ["| method | " + " | ".join(heads) + " | all |", "|---" * (len(heads) + 2) + "|"]
    for method in order:
        texts = [_spread(held[held["method"] == method]["removed"]) for _, held in bins]
        texts.append(_spread(hidden[hidden["method"] == method]["removed"]))
        lines.append(f"| {method} | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def _by_kind(hidden: pd.DataFrame, order: list[str]) -> str:
    kinds = {"one": "one effect", "two": "two effects", "outside": "outside the catalogue"}
    lines = ["| method | " + " | ".join(kinds.values()) + " |", "|---" * (len(kinds) + 1) + "|"]
    for method in order:
        own = hidden[hidden["method"] == method]
        lines.append(f"| {method} | " + " | ".join(_spread(own[own["kind"] == k]["removed"]) for k in kinds) + " |")
    return "\n".join(lines) + "\n"


def _naming(rows: pd.DataFrame, order: list[str]) -> str:
    head = "first name right, one effect, .6 sigma and more | a name given where nothing is missing"
    lines = [f"| method | {head} | held-out error added there | CPU s a case |", "|---|---|---|---|---|"]
    for method in order:
        own = rows[rows["method"] == method]
        asked = own[(own["kind"] == "one") & (own["size"] >= 0.6)]["right"].dropna().astype(bool)
        empty = own[own["kind"] == "none"]
        names = method != "Gaussian process"
        right = f"{asked.sum()} of {len(asked)}" if names else "names nothing"
        false = f"{empty['named'].sum()} of {len(empty)}" if names else "names nothing"
        added = f"{empty['added'].astype(float).median():+.1%}"
        lines.append(f"| {method} | {right} | {false} | {added} | {own['cpu_s'].median():.2f} |")
    return "\n".join(lines) + "\n"


def _spread(values: pd.Series) -> str:  # type: ignore[type-arg]
    if not len(values):
        return "-"
    low, middle, high = values.astype(float).quantile([0.25, 0.5, 0.75])
    return f"{middle:.2f} ({low:.2f}..{high:.2f})"


if __name__ == "__main__":
    main()
