"""``bench show``: one run."""

from __future__ import annotations

from pathlib import Path

from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_json
from calibench.bench.report.one_run import find_run, show_run
from calibench.bench.sweep.words import read_pairs
from calibench.core.words import print_plain as print


def run(argv: list[str]) -> int:
    """Print the run whose id begins with the word of `argv`; a word that is a folder is where it is looked for."""
    flags, words = split_flags(argv, ("--json",))
    given = read_pairs("show", [word for word in words if "=" in word], {"results": "results"})
    plain = [word for word in words if "=" not in word]
    folders = [word for word in plain if len(plain) > 1 and Path(word).is_dir()]
    ids = [word for word in plain if word not in folders]
    if len(ids) != 1 or len(folders) + len(given) > 1:
        raise ValueError("show: one RUN_ID is needed, such as bench show 3f2a (the first digits suffice)")
    one = find_run(Path([*folders, *given.values(), "results"][0]), ids[0])
    if "--json" in flags:
        print_json(one.row)
    else:
        print(show_run(one))
    return 0
