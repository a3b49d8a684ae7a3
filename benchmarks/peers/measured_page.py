"""The page of peers measured in one run: a table a benchmark, the command above it, where a peer is ahead below it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

_UNITS = ((1e9, "s"), (1e6, "ms"), (1e3, "µs"), (1.0, "ns"))
_HEAD = """# Peers, measured in one run

`make bench` makes an environment for each peer, with the pinned versions of `benchmarks/peers/tools/`, and keeps the
rows in `results/benchmarks/peers/*.parquet`. Lines of a table take turns. Ratios are of CPU time
within a round, to the first line: median and quartiles. Times are CPU times of one evaluation (run, report), medians.
One section:

```text
python -m benchmarks peers --only counting
```
"""
_ABOUT = {
    "counting": "The objective is the 12-parameter planar robot, compiled, the same object in every environment (COCO "
    "counts its sphere, in C). Its time is taken away: the lower deciles of calls with and without the counter are "
    "subtracted. Ours keeps budget, best and trace; ioh's Analyzer and COCO's observer a log on disk; MLflow a row. "
    "Of a compiled objective our gate calls the kernel past the Python around it, which hides its cost.",
    "optimisers": "The same objective. An evaluation is a candidate. Ours pass the gate: budget, best and trace "
    "included. Peers that take batches are given batches.",
    "quality": "What a search takes until its value is as low as the noise of the readings allows, on five "
    "[instances](instances.md) of the 12-parameter planar robot, at most 100 000 evaluations each; a Jacobian of ours "
    "counts as 12. A search that ends by itself begins again at random; all time counts. Peers are counted in Python, "
    "1 µs a call.",
    "sweep": "A sphere in 5 dimensions, 60 evaluations a run; a search at random where the tool takes an optimiser of "
    "a user's own, else its own method. A fresh process, from its start to a printed table.",
    "plot": "The sphere again, from an installed environment to a figure on disk, a fresh process. The first time "
    "ever, no compiled code and no list of fonts is kept.",
    "report": "Each tool on 10 000 runs of its own data.",
    "calibration": "Least squares from the nominal parameters, 12 unknowns, 300 poses without noise: the note says "
    "what is left of the sum of squares.",
    "arm": "Least squares on positions of the tool, 300 poses without noise, from the nominal parameters. SciPy and "
    "FIGAROH know where base and target stand; ours fits both, and leaves wild readings out.",
    "arms": "Three of the arms of [the gate](arm-rates.md), 120 noisy places (.03 mm) each: the base stands in the "
    "tracker's frame, the tool is known to 4 mm. The error is that of 300 fresh poses. Six files are odd beside the "
    "chain. GTSAM gets the arm's kinematics from the user.",
    "cameras": "One drawing. The board's pose has a noise of .3 mm and .1 degree on each axis (seed 44). "
    "The true error is that of the camera in the flange. "
    "Ours learns the noise, names wild pairs, leaves folds out and draws for intervals; "
    "GTSAM is told the noise, and has slopes by differences in Python. A user's lines are those of the function that "
    "turns the arrays into the camera.",
    "reading": "100 000 runs on disk to a DataFrame with a row a run, after the imports.",
}


def page(tables: Sequence[pd.DataFrame]) -> str:
    """Return the page of the tables, in their order."""
    parts, seen = [_HEAD], ""
    versions = dict.fromkeys(str(version) for rows in tables for version in rows["version"])
    parts.append(f"Versions: {'; '.join(versions)}.\n")
    there = {str(rows["table"].iloc[0]) for rows in tables}
    if missing := [name for name in _ABOUT if name not in there]:
        parts.append(f"Not measured yet: {', '.join(missing)}.\n")
    every = pd.concat([*tables])
    whole = _when(every) if len(every[["date", "machine"]].drop_duplicates()) == 1 else None
    parts += [] if whole is None else [f"All of it: {whole}\n"]
    for rows in tables:
        group = str(rows["table"].iloc[0])
        if group != seen:
            parts.append(f"## {group.capitalize()}\n\n{_ABOUT[group]}\n")
        seen = group
        if whole is None:
            parts.append(f"{_when(rows)}\n")
        notes: set[str] = set()  # a note that stands below one table of a benchmark is not repeated below the next
        for title, lines in rows.groupby("benchmark", sort=False):
            parts.append(_table(str(title), lines, notes))
            if ahead := _ahead(lines):
                parts.append(f"**Ahead of us here:** {ahead}.\n")
    return "\n".join(parts)


def _when(rows: pd.DataFrame) -> str:
    """Return when and where rows of one date were measured, and beside what load at most."""
    first, load = rows.iloc[0], rows[["load_before", "load_after"]].to_numpy().max()
    return f"{first['date']}, {first['machine']}; load average at most {load:.1f}."


def _table(title: str, lines: pd.DataFrame, above: set[str]) -> str:
    """Return a heading and the table; notes that do not stand `above` are its last column, and enter those that do."""
    rows = lines.to_dict("records")
    notes = [_cell(row["error"] or row["note"]) for row in rows]
    fresh = ["" if f"{row['line']}: {note}" in above else note for row, note in zip(rows, notes, strict=True)]
    above.update(f"{row['line']}: {note}" for row, note in zip(rows, notes, strict=True))
    shown = 4 if any(fresh) else 3
    cells = [["", "CPU", "ratio (quartiles)", "note"]]
    cells += [[*_line(row), note] for row, note in zip(rows, fresh, strict=True)]
    head, *drawn = (f"| {' | '.join(line[:shown])} |" for line in cells)
    return "\n".join([f"### {title[0].upper()}{title[1:]}\n", head, f"|{'---|' * shown}", *drawn, ""])


def _line(row: dict[Any, Any]) -> list[str]:
    if row["error"]:
        return [row["line"], "-", "-"]
    ratio = "-"
    if row["ratio"] == row["ratio"]:
        low, high = row["ratio_q1"], row["ratio_q3"]
        spread = f" ({_short(low)} .. {_short(high)})" if low < high else ""
        ratio = f"{_short(row['ratio'])}{spread}"
    return [row["line"], told(row["cpu_ns"]), ratio]


def _short(ratio: float) -> str:
    """Return three digits without an exponent: 4300, not 4.3e+03."""
    return f"{float(f'{ratio:.3g}'):.10g}"


def told(ns: float) -> str:
    """Return a time of three digits with its unit; a difference of times that is not above 0 is told in words."""
    if ns <= 0:
        return "below what can be measured"
    size, unit = next(((s, u) for s, u in _UNITS if abs(ns) >= s), _UNITS[-1])
    return f"{ns / size:.3g} {unit}"


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "/").split())


def _ahead(lines: pd.DataFrame) -> str:
    """Return the lines of peers that took less than our first line in at least three quarters of the rounds."""
    if not str(lines["line"].iloc[0]).startswith("ours"):
        return ""
    better = lines[(lines["ratio_q3"] < 1) & ~lines["line"].str.startswith("ours")]
    return "; ".join(better["line"])
