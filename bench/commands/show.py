"""``bench show``: one run."""

from __future__ import annotations

from pathlib import Path

from calibench.bench.commands.arguments import read_pairs, split_flags
from calibench.bench.commands.console import print_json
from calibench.bench.report.study.show import find_run, show_run


def run(argv: list[str]) -> int:
    """Print the run whose id begins with the word of `argv`."""
    flags, words = split_flags(argv, ("--json",))
    given = read_pairs("show", [word for word in words if "=" in word], {"results": "results"})
    ids = [word for word in words if "=" not in word]
    if len(ids) != 1:
        raise ValueError("show: one RUN_ID is needed, such as bench show 3f2a (the first digits suffice)")
    row = find_run(Path(given.get("results", "results")), ids[0])
    if "--json" in flags:
        print_json(row)
    else:
        print(show_run(row))
    return 0
