"""``python -m benchmarks.answer [RESULTS]``: write docs/answer.md and its picture from the table that is kept.

With the folder of the study `calibration24` the table is made anew from its runs first.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.answer.compact import STORED, compact, store, stored
from benchmarks.answer.figure import PICTURE, draw
from benchmarks.answer.page import page
from calibench.bench import ResultStore


def main() -> None:
    """Write the table where a folder is named, then the page and the picture."""
    parser = argparse.ArgumentParser(prog="benchmarks.answer", description="Answer which optimiser calibrates a robot.")
    parser.add_argument("results", type=Path, nargs="?", help="folder of the runs, such as results/calibration24")
    parser.add_argument("--table", type=Path, default=STORED, help="the compact table, written and read")
    parser.add_argument("--page", type=Path, default=Path("docs/answer.md"), help="page to write")
    parser.add_argument("--picture", type=Path, default=PICTURE, help="picture to write")
    chosen = parser.parse_args()
    if chosen.results is not None:
        store(compact(ResultStore(chosen.results).runs()), chosen.table)
    table = stored(chosen.table)
    chosen.page.write_text(page(table), encoding="utf-8")
    chosen.picture.parent.mkdir(parents=True, exist_ok=True)
    draw(table)[0].savefig(chosen.picture, dpi=160)


if __name__ == "__main__":
    main()
