"""``bench show``: one run."""

from __future__ import annotations

import json
from pathlib import Path

from bench.show import find_run, show_run
from bench.verbs.words import split_flags


def run(argv: list[str]) -> int:
    """Print the run whose id begins with the word of `argv`."""
    flags, words = split_flags(argv, ("--json",))
    ids = [w for w in words if not w.startswith("results=")]
    parent = Path(next((w.partition("=")[2] for w in words if w.startswith("results=")), "results"))
    if len(ids) != 1:
        raise ValueError("show: one RUN_ID is needed, such as bench show 3f2a (the first digits suffice)")
    row = find_run(parent, ids[0])
    print(json.dumps(row, indent=1, default=str) if "--json" in flags else show_run(row))
    return 0
