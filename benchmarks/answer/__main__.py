"""``python -m benchmarks.answer [RESULTS]``: write docs/answer.md and its pictures from the table that is kept.

With the folder of the study `calibration24`, or of a part of it, the rows of its families are made anew from its runs
first; families that it has no run of stay as they are kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.answer.compact import STORED, compact, joined, store, stored
from benchmarks.answer.figure import PICTURE, RANKS, draw, draw_ranks
from benchmarks.answer.page import page
from calibench.bench import ResultStore


def main() -> None:
    """Write the table where a folder is named, then the page and the pictures."""
    parser = argparse.ArgumentParser(prog="benchmarks.answer", description="Answer which optimiser calibrates a robot.")
    parser.add_argument("results", type=Path, nargs="?", help="folder of the runs, such as results/calibration24")
    parser.add_argument("--table", type=Path, default=STORED, help="the compact table, written and read")
    parser.add_argument("--page", type=Path, default=Path("docs/answer.md"), help="page to write")
    parser.add_argument("--pictures", type=Path, default=PICTURE.parent, help="folder of the pictures")
    chosen = parser.parse_args()
    if chosen.results is not None:
        drawn = compact(ResultStore(chosen.results).runs())
        store(joined(stored(chosen.table), drawn) if chosen.table.exists() else drawn, chosen.table)
    table = stored(chosen.table)
    chosen.page.write_text(page(table), encoding="utf-8")
    chosen.pictures.mkdir(parents=True, exist_ok=True)
    draw(table)[0].savefig(chosen.pictures / PICTURE.name, dpi=160)
    draw_ranks(table)[0].savefig(chosen.pictures / RANKS.name, dpi=160)


if __name__ == "__main__":
    main()
